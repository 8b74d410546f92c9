"""A SLAM graph as a file holds it, and how it becomes a log.

The chain of poses in the order of their ids is the odometry. An edge stored from the later pose to the
earlier one is turned round exactly: ``Z exp(e)`` becomes ``Z^-1 exp(-Ad(Z) e)``, so Q = Ad C Ad^T keeps the
cost as it was.

Edges between poses that are not neighbours (loop closures) have no place in a frame-by-frame stream of
landmark observations. Each earlier pose that is seen again becomes a *place landmark*: its own frame
observes it at zero offset with ``place_sigma_m``, and the edge becomes an observation of it, with the
translation part of the edge's covariance. What is lost: the relative heading that the edge measured and its
correlation with the position; what is added: the slack ``place_sigma_m``. Poses that the file declares to be
at one place (EQUIV) share one landmark; in w100 and w10000 such pairs are noise apart (median 0.02 m, at
most 0.1 m at the optimum of all edges) and each has an edge of its own. Those two files state unit
information although their noise is 0.04 m and rad: chi-squared per degree of freedom is near 0.002 there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from slamcmp.errors import DataError
from slamcmp.geometry import adjoint, inverse
from slamcmp.models.sensors import make_sensor
from slamcmp.types import TANGENT_DIM, Detections, FloatArray, Log, Problem, SensorModel

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
    landmarks: dict[int, FloatArray] = field(default_factory=dict)
    """Positions where the file has them, (n,)."""
    pose_edges: list[PoseEdge] = field(default_factory=list)
    landmark_edges: list[LandmarkEdge] = field(default_factory=list)
    prior: Prior | None = None
    times: dict[int, float] = field(default_factory=dict)
    """Time stamps of poses [s], where the file has them."""
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


def graph_log(
    graph: Graph,
    *,
    name: str,
    steps: int | None = None,
    time_step_s: float = 1.0,
    prior_position_sigma_m: float = 1e-6,
    prior_heading_sigma_rad: float = 1e-6,
    place_sigma_m: float = 0.01,
) -> Log:
    """The graph as a log: one frame a pose, in the order of the pose ids.

    ``steps`` keeps the first poses only. The prior is the file's own where it has one, else the first
    vertex (or the origin) with the given sigmas. Frames are ``time_step_s`` apart where the file has no
    time stamps.

    Raises:
        DataError: no poses, a gap in the odometry, two kinds of landmark edges, or a prior on a later pose.
    """
    ids = graph.pose_ids()[:steps]
    if not ids:
        raise DataError(f"{graph.path}: has no poses; lines such as EDGE_SE2 or VERTEX_SE2 are needed")
    index = {pose: k for k, pose in enumerate(ids)}
    sensor_name = _sensor_name(graph)
    odometry, loops = _split(graph, ids, index)

    n = graph.space_dim
    p = TANGENT_DIM[n]
    increments, covariances = np.tile(np.eye(n + 1), (len(ids), 1, 1)), np.zeros((len(ids), p, p))
    for k, edge in odometry.items():
        increments[k], covariances[k] = edge.T, edge.covariance

    seen = _observations(graph, index, loops, sensor_name, place_sigma_m)
    sensor = make_sensor(sensor_name, {"space_dim": n} if sensor_name == "relative_position" else {})
    mean, prior_covariance = _prior(graph, ids[0], prior_position_sigma_m, prior_heading_sigma_rad)
    times = np.array([graph.times.get(pose, k * time_step_s) for k, pose in enumerate(ids)])
    detections = tuple(_fused(seen.get(k, ()), sensor) for k in range(len(ids)))
    return Log(
        name,
        Problem(mean, prior_covariance, sensor),
        times,
        increments,
        covariances,
        detections,
        warnings=tuple(graph.warnings),
    )


def _sensor_name(graph: Graph) -> SensorName:
    names = {edge.sensor: edge for edge in graph.landmark_edges}
    if len(names) > 1:
        places = " and ".join(f"{edge.sensor} ({edge.where})" for edge in names.values())
        raise DataError(f"{graph.path}: mixes landmark edges of two kinds, {places}; one kind is needed")
    found = next(iter(names), None)
    if graph.sensor and found and graph.sensor != found:
        raise DataError(f"{names[found].where}: a {found} edge in a file that names {graph.sensor}")
    return found or graph.sensor or "relative_position"


def _split(graph: Graph, ids: list[int], index: dict[int, int]) -> tuple[dict[int, PoseEdge], list[PoseEdge]]:
    """The odometry edge into each frame but the first, and the rest turned so that ``first`` is later."""
    odometry: dict[int, PoseEdge] = {}
    loops: list[PoseEdge] = []
    for edge in graph.pose_edges:
        if edge.first not in index or edge.second not in index:
            continue
        a, b = index[edge.first], index[edge.second]
        if a == b:
            raise DataError(f"{edge.where}: an edge from pose {edge.first} to itself; two poses are needed")
        later = max(a, b)
        if abs(a - b) == 1 and later not in odometry:
            odometry[later] = edge if a < b else turned(edge)
        else:
            loops.append(edge if a > b else turned(edge))
    for k in range(1, len(ids)):
        if k not in odometry:
            raise DataError(
                f"{graph.path}: no edge joins pose {ids[k - 1]} and pose {ids[k]}; "
                "the odometry needs one between each pose and the next"
            )
    return odometry, loops


def turned(edge: PoseEdge) -> PoseEdge:
    """The same measurement from the other end."""
    transport = adjoint(edge.T)
    return PoseEdge(
        edge.second, edge.first, inverse(edge.T), transport @ edge.covariance @ transport.T, edge.where
    )


def _observations(
    graph: Graph,
    index: dict[int, int],
    loops: list[PoseEdge],
    sensor_name: SensorName,
    place_sigma_m: float,
) -> dict[int, list[tuple[int, FloatArray, FloatArray]]]:
    """Per frame: (landmark id, z, R), places included."""
    seen: dict[int, list[tuple[int, FloatArray, FloatArray]]] = defaultdict(list)
    for edge in graph.landmark_edges:
        if edge.pose in index:
            seen[index[edge.pose]].append((edge.landmark, edge.measured, edge.covariance))
    if not loops:
        return seen
    if sensor_name != "relative_position":
        raise DataError(
            f"{loops[0].where}: a loop closure between poses beside bearing-range edges; a place is "
            "seen from itself, which a bearing cannot describe: use relative positions or leave the edge out"
        )
    n = graph.space_dim
    taken = {edge.landmark for edge in graph.landmark_edges}
    offset = max(taken) + 1 if taken else 0
    place_of = _places(graph.equivalent)
    for loop in loops:
        place = place_of.get(loop.second, loop.second)
        if place not in index:
            place = loop.second
        # The edge's noise lives in the axes of the earlier body, the observation's in the later one's.
        rotation = loop.T[:n, :n]
        spread = loop.covariance[-n:, -n:] if n == 3 else loop.covariance[:n, :n]
        landmark = place + offset
        seen[index[loop.first]].append((landmark, loop.T[:n, n], rotation @ spread @ rotation.T))
        if landmark not in taken:
            taken.add(landmark)
            seen[index[place]].append((landmark, np.zeros(n), place_sigma_m**2 * np.eye(n)))
    return seen


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


def _fused(seen: Iterable[tuple[int, FloatArray, FloatArray]], sensor: SensorModel) -> Detections:
    """Detections sorted by id; several of one landmark in one frame become their weighted mean."""
    by_id: dict[int, list[tuple[FloatArray, FloatArray]]] = defaultdict(list)
    for landmark, measured, covariance in seen:
        by_id[landmark].append((measured, covariance))
    ids = sorted(by_id)
    measurements, covariances = np.empty((len(ids), sensor.dim)), np.empty((len(ids), sensor.dim, sensor.dim))
    for row, landmark in enumerate(ids):
        measurements[row], covariances[row] = by_id[landmark][0]
        if len(by_id[landmark]) > 1:
            measurements[row], covariances[row] = _weighted_mean(by_id[landmark], sensor)
    return Detections(measurements, covariances, np.array(ids, dtype=np.int64))


def _weighted_mean(
    seen: list[tuple[FloatArray, FloatArray]], sensor: SensorModel
) -> tuple[FloatArray, FloatArray]:
    """One measurement that stands for several of the same landmark from the same pose (exact)."""
    reference = seen[0][0]
    information = np.zeros((sensor.dim, sensor.dim))
    pull = np.zeros(sensor.dim)
    for measured, covariance in seen:
        weight = np.linalg.inv(covariance)
        information += weight
        # Differences, not values, so that two bearings beside +-pi do not average to zero.
        pull += weight @ sensor.residual(measured, reference)
    total = np.linalg.inv(information)
    fused: FloatArray = 0.5 * (total + total.T)
    return sensor.residual(reference + fused @ pull, np.zeros(sensor.dim)), fused


def _prior(
    graph: Graph, first: int, position_sigma_m: float, heading_sigma_rad: float
) -> tuple[FloatArray, FloatArray]:
    n = graph.space_dim
    if graph.prior is not None:
        if graph.prior.pose != first:
            raise DataError(
                f"{graph.prior.where}: a prior on pose {graph.prior.pose}; "
                f"only the first pose ({first}) can have one"
            )
        return graph.prior.T, graph.prior.covariance
    sigmas = [position_sigma_m] * 2 + [heading_sigma_rad]
    if n == 3:
        sigmas = [heading_sigma_rad] * 3 + [position_sigma_m] * 3
    return graph.poses.get(first, np.eye(n + 1)), np.diag(np.square(sigmas))
