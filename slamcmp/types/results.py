"""What a back end answers, and all that it did with a stream."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from slamcmp.types.arrays import BoolArray, FloatArray, IntArray
from slamcmp.types.checks import TANGENT_DIM, assign, frozen, require_unique
from slamcmp.types.html import facts_html

Status = Literal["ok", "diverged", "crashed", "timed_out", "killed", "missing"]


@dataclass(frozen=True)
class Estimate:
    """A back end's causal answer at the current frame."""

    T_world_body: FloatArray
    """(n+1, n+1)."""
    P: FloatArray
    """Covariance in the body tangent, (p, p)."""

    def __post_init__(self) -> None:
        size = np.shape(self.T_world_body)[-1]
        p = TANGENT_DIM.get(size - 1, 0)
        # Once a frame and timed with the back end: no detour through _set.
        put = object.__setattr__
        put(self, "T_world_body", frozen(self.T_world_body, "Estimate.T_world_body", (size, size)))
        put(self, "P", frozen(self.P, "Estimate.P", (p, p)))


@dataclass(frozen=True)
class Landmarks:
    """A map: positions in the world with their covariance blocks."""

    ids: IntArray
    """(L,)."""
    positions: FloatArray
    """(L, n) [m]."""
    covariances: FloatArray
    """(L, n, n) [m²], in world axes."""

    def __post_init__(self) -> None:
        ids = frozen(self.ids, "Landmarks.ids", (None,), np.int64)
        require_unique(ids, "Landmarks.ids")
        positions = frozen(self.positions, "Landmarks.positions", (ids.size, None))
        n = positions.shape[1]
        assign(
            self,
            ids=ids,
            positions=positions,
            covariances=frozen(self.covariances, "Landmarks.covariances", (ids.size, n, n)),
        )


@dataclass(frozen=True)
class Trajectory:
    """Poses over time, with or without their covariances."""

    t: FloatArray
    """(K,) [s]."""
    T_world_body: FloatArray
    """(K, n+1, n+1)."""
    P: FloatArray | None = None
    """(K, p, p) in the body tangent, or None."""

    def __post_init__(self) -> None:
        t = frozen(self.t, "Trajectory.t", (None,))
        size = np.shape(self.T_world_body)[-1]
        p = TANGENT_DIM.get(size - 1, 0)
        assign(
            self,
            t=t,
            T_world_body=frozen(self.T_world_body, "Trajectory.T_world_body", (t.size, size, size)),
            P=None if self.P is None else frozen(self.P, "Trajectory.P", (t.size, p, p)),
        )


@dataclass(frozen=True)
class Run:
    """Everything one back end did with one stream.

    A run that ended early holds the frames it finished: ``completion`` is their share.
    """

    back_end: str
    """Label in tables; unique within an experiment."""
    parameters: Mapping[str, Any]
    digest: str
    seed: int | None
    frames: int
    """Frames of the stream, finished or not."""
    status: Status
    message: str
    online: Trajectory
    """Causal estimates of the finished frames."""
    update_s: FloatArray
    """Wall time of each ``update`` [s], one entry a finished frame."""
    estimate_s: FloatArray
    """Wall time of each ``estimate`` [s]."""
    final: Trajectory | None = None
    """With hindsight, over all frames; None for a pure filter or a failed run."""
    final_s: float = 0.0
    """Wall time of the last ``trajectory()`` call [s]."""
    landmarks: Landmarks | None = None
    """The map after the last frame."""
    joint_covariance: FloatArray | None = None
    """Of the last pose and the map, (p + n L, p + n L)."""
    diagnostics: Mapping[str, FloatArray] = field(default_factory=dict)
    """Per-frame scalars, each (finished frames,), NaN where a frame has none."""
    kept_observations: tuple[BoolArray, ...] | None = None
    """Of a back end that leaves out some of the stream's observations: the masks of those it used, one a
    finished frame; None: it used them all."""
    final_diagnostics: Mapping[str, float] = field(default_factory=dict)
    peak_memory_mb: float = float("nan")
    """Growth of the process's peak resident memory over the run [MB]."""
    wall_s: float = float("nan")
    """Wall time of all that the back end did, from its construction to its last answer [s]."""
    processor_s: float = float("nan")
    """Processor time of its process meanwhile, all threads [s]: where the wall time is longer, it waited."""
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def completion(self) -> float:
        """Share of the stream's frames that were finished, 0 to 1."""
        return self.online.t.size / self.frames

    def __repr__(self) -> str:
        about = f"{self.status}, {self.online.t.size} of {self.frames} frames"
        return f"<Run {self.back_end!r}: {about}{f': {self.message}' if self.message else ''}>"

    def _repr_html_(self) -> str:
        """How it went, for notebooks."""
        facts = [
            ("status", f"{self.status}: {self.message}" if self.message else self.status),
            ("frames", f"{self.online.t.size} of {self.frames}"),
            ("final trajectory", "none" if self.final is None else f"yes, in {self.final_s:.3g} s"),
            ("landmarks", "none" if self.landmarks is None else str(self.landmarks.ids.size)),
        ]
        for name, seconds in (("update", self.update_s), ("estimate", self.estimate_s)):
            if np.isfinite(seconds).any():
                facts.append((f"{name}, median", f"{1e3 * float(np.nanmedian(seconds)):.3g} ms"))
        if np.isfinite(self.peak_memory_mb):
            facts.append(("memory, growth of the peak", f"{self.peak_memory_mb:.3g} MB"))
        facts += [(name, f"{value:.4g}") for name, value in self.final_diagnostics.items()]
        facts.append(
            ("stream", f"digest {self.digest[:12]}{'' if self.seed is None else f', seed {self.seed}'}")
        )
        return facts_html(f"Run of {self.back_end}", facts)
