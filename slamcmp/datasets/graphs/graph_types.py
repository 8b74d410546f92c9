"""A SLAM graph as a file holds it.

Ids are names: any whole numbers of 64 bits, such as the keys of gtsam's Symbols.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from slamcmp.types import FloatArray

SensorName = Literal["range_bearing", "relative_position"]


@dataclass(frozen=True)
class PoseEdge:
    """A measured relative pose: ``T`` maps points of body ``second`` to body ``first``."""

    first: int
    second: int
    T: FloatArray
    """(n+1, n+1)."""
    covariance: FloatArray
    """(p, p), in the tangent of body ``second``."""
    where: str
    """file:line."""


@dataclass(frozen=True)
class LandmarkEdge:
    """A landmark seen from a pose."""

    pose: int
    landmark: int
    sensor: SensorName
    measured: FloatArray
    covariance: FloatArray
    where: str
    """file:line."""


@dataclass(frozen=True)
class Prior:
    """What a file says about one pose in the world."""

    pose: int
    T: FloatArray
    covariance: FloatArray
    where: str


@dataclass
class Graph:
    """The content of a graph file; pose and landmark ids are two separate sets of numbers."""

    path: Path
    space_dim: int = 2
    poses: dict[int, FloatArray] = field(default_factory=dict)
    """Initial or estimated poses where the file has them, (n+1, n+1)."""
    pose_lines: dict[int, str] = field(default_factory=dict)
    """file:line of each of them."""
    landmarks: dict[int, FloatArray] = field(default_factory=dict)
    """Positions where the file has them, (n,)."""
    pose_edges: list[PoseEdge] = field(default_factory=list)
    landmark_edges: list[LandmarkEdge] = field(default_factory=list)
    prior: Prior | None = None
    times: dict[int, float] = field(default_factory=dict)
    """Time stamps of poses [s], where the file has them."""
    time_lines: dict[int, str] = field(default_factory=dict)
    """file:line of each of them."""
    sensor: SensorName | None = None
    """Where the file names it; else the landmark edges tell."""
    equivalent: list[tuple[int, int]] = field(default_factory=list)
    """Pairs of poses declared to be at the same place."""
    warnings: list[str] = field(default_factory=list)
    """What was left out of it."""

    def pose_ids(self) -> list[int]:
        """Every pose that stands anywhere in the file, sorted."""
        ids = set(self.poses)
        for edge in self.pose_edges:
            ids.update((edge.first, edge.second))
        ids.update(edge.pose for edge in self.landmark_edges)
        return sorted(ids)


def name_of(name: int) -> str:
    """An id for a message; a key of gtsam's with the symbol it stands for, ``8646911284551352321 (x1)``."""
    letter, index = name >> 56, name & ((1 << 56) - 1)
    return f"{name} ({chr(letter)}{index})" if chr(max(letter, 0)).isalpha() and letter < 128 else str(name)
