"""Loop closures between poses as sights of places: a substitute for back ends that know landmarks only.

Each earlier pose that is seen again becomes a *place landmark*: its own frame observes it at zero offset with
``place_sigma_m``, and the edge becomes an observation of it, with the translation part of the edge's
covariance. What is lost: the relative heading that the edge measured and its correlation with the position;
what is added: the slack ``place_sigma_m``. Poses that the file declares to be at one place (EQUIV) share one
landmark; in w100 and w10000 such pairs are noise apart (median 0.02 m, at most 0.1 m at the optimum of all
edges) and each has an edge of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slamcmp.datasets.graphs.graph_types import Graph, PoseEdge
from slamcmp.datasets.graphs.odometry_chain import turned
from slamcmp.errors import DataError
from slamcmp.types import FloatArray


@dataclass(frozen=True)
class Sight:
    """A landmark as one frame saw it."""

    landmark: int
    """Its name in the file; of a place, above all of them."""
    z: FloatArray
    R: FloatArray
    where: str
    """file:line."""


def place_sights(
    graph: Graph, index: Mapping[int, int], closures: Sequence[PoseEdge], place_sigma_m: float
) -> list[tuple[int, Sight]]:
    """(frame, sight) of every place: what each closure saw, and the place's own frame.

    Args:
        graph: its landmarks' ids are taken.
        index: frame of each pose that is used.
        closures: edges between poses that are not neighbours.
        place_sigma_m: of a place as its own frame sees it.

    Raises:
        DataError: the file's landmarks are seen by bearing and range.
    """
    if not closures:
        return []
    if any(edge.sensor != "relative_position" for edge in graph.landmark_edges):
        raise DataError(
            f"{closures[0].where}: a loop closure between poses beside bearing-range edges; a place is "
            "seen from "
            "itself, which a bearing cannot describe: set closures to 'factors', or leave the edge out"
        )
    n = graph.space_dim
    landmarks = {edge.landmark for edge in graph.landmark_edges}
    offset = max(landmarks) + 1 if landmarks else 0
    found: list[tuple[int, Sight]] = []
    known: set[int] = set()
    place_of = _places(graph.equivalent)
    for edge in closures:
        loop = edge if index[edge.first] > index[edge.second] else turned(edge)
        place = place_of.get(loop.second, loop.second)
        if place not in index:
            place = loop.second
        # The edge's noise lives in the axes of the earlier body, the observation's in the later one's.
        rotation = loop.T[:n, :n]
        spread = loop.covariance[-n:, -n:] if n == 3 else loop.covariance[:n, :n]
        name = place + offset
        found.append(
            (index[loop.first], Sight(name, loop.T[:n, n], rotation @ spread @ rotation.T, loop.where))
        )
        if name not in known:
            known.add(name)
            own = Sight(name, np.zeros(n), place_sigma_m**2 * np.eye(n), loop.where)
            found.append((index[place], own))
    return found


def _places(pairs: Iterable[tuple[int, int]]) -> dict[int, int]:
    """The smallest pose id of each class of equivalent poses."""
    parent: dict[int, int] = {}

    def root(pose: int) -> int:
        while parent.setdefault(pose, pose) != pose:
            parent[pose] = parent[parent[pose]]
            pose = parent[pose]
        return pose

    for a, b in pairs:
        low, high = sorted((root(a), root(b)))
        parent[high] = low
    return {pose: root(pose) for pose in list(parent)}
