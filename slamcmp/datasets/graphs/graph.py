"""How a graph from a file becomes a log: one frame a pose, in the order of the pose ids.

The odometry is the chain of neighbours (:mod:`slamcmp.datasets.graphs.odometry_chain`). Edges between other
poses, loop closures, stay what they are (``factors``), relative poses that smoothers take in; filters, whose
state has no earlier poses, refuse them. ``places`` puts place landmarks in their stead for every back end
alike (:mod:`slamcmp.datasets.graphs.place_landmarks`), and the log says so.

w100 and w10000 state unit information although their noise is 0.04 m and rad: chi-squared per degree of
freedom is near 0.002 there.

Landmarks keep their ids where back ends can use them, 0 to 2^50; otherwise all are numbered anew in the order
of their names, and the log tells these (``own_ids``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.special import chdtri

from slamcmp.datasets.graphs.graph_types import Graph, PoseEdge, SensorName, name_of
from slamcmp.datasets.graphs.odometry_chain import CONTRADICTION, numbering_jump, split_edges, turned
from slamcmp.datasets.graphs.place_landmarks import Sight, place_sights
from slamcmp.errors import DataError
from slamcmp.models.sensors import make_sensor
from slamcmp.types import (
    TANGENT_DIM,
    Detections,
    FloatArray,
    GroundTruth,
    IntArray,
    Log,
    Problem,
    RelativePoses,
    SensorModel,
)

Closures = Literal["factors", "places"]
"""What becomes of loop closures between poses."""

LARGEST_ID = 1 << 50
"""Of a landmark, in every back end."""


def graph_log(
    graph: Graph,
    *,
    name: str,
    steps: int | None = None,
    time_step_s: float = 1.0,
    prior_position_sigma_m: float = 1e-6,
    prior_heading_sigma_rad: float = 1e-6,
    closures: Closures = "factors",
    place_sigma_m: float = 0.01,
    vertices_are_truth: bool = False,
) -> Log:
    """The graph as a log.

    ``steps`` keeps the first poses only. The prior is the file's own where it has one, else the first
    vertex (or the origin) with the given sigmas. Frames are ``time_step_s`` apart where the file has no
    time stamps. With ``vertices_are_truth`` the file's vertices are the truth, poses and landmarks without
    one are not known.

    Raises:
        DataError: no poses, no chain of odometry, two kinds of landmark edges, sights that contradict one
            another, time stamps that are missing or go back, or a prior on a later pose.
    """
    ids = graph.pose_ids()[:steps]
    if not ids:
        raise DataError(f"{graph.path}: has no poses; lines such as EDGE_SE2 or VERTEX_SE2 are needed")
    index = {pose: k for k, pose in enumerate(ids)}
    sensor_name = _sensor_name(graph)
    _require_vertices(graph)
    _refuse_landmark_vertices(graph)
    odometry, loops = split_edges(graph, ids)

    n = graph.space_dim
    p = TANGENT_DIM[n]
    increments, covariances = np.tile(np.eye(n + 1), (len(ids), 1, 1)), np.zeros((len(ids), p, p))
    for k, edge in odometry.items():
        increments[k], covariances[k] = edge.T, edge.covariance

    seen: dict[int, list[Sight]] = defaultdict(list)
    for sight in graph.landmark_edges:
        if sight.pose in index:
            seen[index[sight.pose]].append(
                Sight(sight.landmark, sight.measured, sight.covariance, sight.where)
            )
    warnings = list(graph.warnings)
    if (jump := numbering_jump(graph, ids)) is not None:
        warnings.append(jump)
    related: tuple[RelativePoses | None, ...] | None = None
    if loops and closures == "factors":
        related = _relative_poses(loops, index)
    elif loops:
        for k, found in place_sights(graph, index, loops, place_sigma_m):
            seen[k].append(found)
        warnings.append(
            f"{graph.path.name}: {len(loops)} loop closures between poses were turned into sights of places; "
            "their headings are lost"
        )
    numbers, own_ids = _numbering({sight.landmark for sights in seen.values() for sight in sights})
    if own_ids is not None:
        to = f" to {len(own_ids) - 1} = {name_of(int(own_ids[-1]))}" if len(own_ids) > 1 else ""
        warnings.append(
            f"{graph.path.name}: landmarks are numbered anew, from 0 = {name_of(int(own_ids[0]))}{to}; "
            "tables show their own names"
        )

    sensor = make_sensor(sensor_name, {"space_dim": n} if sensor_name == "relative_position" else {})
    mean, prior_covariance = _prior(graph, ids[0], prior_position_sigma_m, prior_heading_sigma_rad)
    times = _times(graph, ids, time_step_s)
    return Log(
        name,
        Problem(mean, prior_covariance, sensor),
        times,
        increments,
        covariances,
        tuple(_fused(seen.get(k, ()), numbers, sensor) for k in range(len(ids))),
        truth=_vertices(graph, ids, numbers, times) if vertices_are_truth else None,
        warnings=tuple(warnings),
        relative_poses=related,
        own_ids=own_ids,
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


def _require_vertices(graph: Graph) -> None:
    """Raise DataError if an edge is of a vertex that is missing where most others stand in the file.

    Vertices are starting values, and files without them are fine; one that is missing among many tells of an
    edge that names the wrong one.
    """
    of_poses = [(pose, edge.where) for edge in graph.pose_edges for pose in (edge.first, edge.second)]
    of_poses += [(edge.pose, edge.where) for edge in graph.landmark_edges]
    of_landmarks = [(edge.landmark, edge.where) for edge in graph.landmark_edges]
    for what, mentioned, stated in (
        ("pose", of_poses, graph.poses.keys()),
        ("landmark", of_landmarks, graph.landmarks.keys()),
    ):
        names = {name for name, _ in mentioned}
        missing = names - stated
        if missing and 2 * len(missing) < len(names):
            name, where = next(each for each in mentioned if each[0] in missing)
            raise DataError(
                f"{where}: {what} {name_of(name)} has no vertex in the file, where "
                f"{len(names) - len(missing)} of "
                f"the {len(names)} {what}s in edges have one: give it one, or correct the edge"
            )


def _refuse_landmark_vertices(graph: Graph) -> None:
    """Raise DataError if an edge between poses ends at what is a landmark only.

    Poses and landmarks may share numbers; this number stands for a landmark, and no line but the edge takes
    it for a pose, nor any for a landmark that is seen.
    """
    seen = {edge.landmark for edge in graph.landmark_edges}
    poses = graph.poses.keys() | {edge.pose for edge in graph.landmark_edges}
    for edge in graph.pose_edges:
        for name in (edge.first, edge.second):
            if name in graph.landmarks and name not in seen and name not in poses:
                raise DataError(
                    f"{edge.where}: an edge between poses, but {name_of(name)} is a landmark's vertex in the "
                    "file: give it the vertex of a pose, or the edge the kind of a sight (EDGE_SE2_XY, in "
                    "space EDGE_SE3_TRACKXYZ)"
                )


def _relative_poses(loops: Sequence[PoseEdge], index: dict[int, int]) -> tuple[RelativePoses | None, ...]:
    by_frame: dict[int, list[PoseEdge]] = defaultdict(list)
    for edge in loops:
        forward = edge if index[edge.first] < index[edge.second] else turned(edge)
        by_frame[index[forward.second]].append(forward)
    return tuple(
        RelativePoses(
            np.array([index[edge.first] for edge in by_frame[k]]),
            np.stack([edge.T for edge in by_frame[k]]),
            np.stack([edge.covariance for edge in by_frame[k]]),
        )
        if k in by_frame
        else None
        for k in range(len(index))
    )


def _numbering(names: set[int]) -> tuple[dict[int, int], IntArray | None]:
    """The number of each landmark, and where these are not the names themselves, the name of each number."""
    ordered = sorted(names)
    if not ordered or (ordered[0] >= 0 and ordered[-1] <= LARGEST_ID):
        return {name: name for name in ordered}, None
    return {name: number for number, name in enumerate(ordered)}, np.array(ordered, dtype=np.int64)


def _times(graph: Graph, ids: Sequence[int], time_step_s: float) -> FloatArray:
    unknown = sorted(graph.times.keys() - set(graph.pose_ids()))
    if unknown:
        raise DataError(
            f"{graph.time_lines[unknown[0]]}: a time stamp of pose {name_of(unknown[0])}, which the file "
            "does not have"
        )
    stamped = [pose for pose in ids if pose in graph.times]
    if not stamped:
        return np.asarray(np.arange(len(ids)) * time_step_s, dtype=np.float64)
    for pose in ids:
        if pose not in graph.times:
            raise DataError(
                f"{graph.path}: pose {name_of(pose)} has no time stamp where {len(stamped)} of "
                f"{len(ids)} poses "
                "have one: stamp all or none"
            )
    for earlier, later in pairwise(ids):
        if graph.times[later] <= graph.times[earlier]:
            raise DataError(
                f"{graph.time_lines[later]}: time {graph.times[later]!r} s of pose {name_of(later)} "
                "does not come "
                f"after {graph.times[earlier]!r} s of pose {name_of(earlier)} before it"
            )
    return np.array([graph.times[pose] for pose in ids])


def _vertices(graph: Graph, ids: Sequence[int], numbers: dict[int, int], times: FloatArray) -> GroundTruth:
    n = graph.space_dim
    unknown = np.full((n + 1, n + 1), np.nan)
    known = sorted((numbers[name], position) for name, position in graph.landmarks.items() if name in numbers)
    return GroundTruth(
        times,
        np.stack([graph.poses.get(pose, unknown) for pose in ids]),
        np.array([number for number, _ in known], dtype=np.int64),
        np.array([position for _, position in known]).reshape(-1, n),
    )


def _fused(seen: Iterable[Sight], numbers: dict[int, int], sensor: SensorModel) -> Detections:
    """Detections sorted by id; several of one landmark in one frame become their weighted mean."""
    by_id: dict[int, list[Sight]] = defaultdict(list)
    for sight in seen:
        by_id[numbers[sight.landmark]].append(sight)
    ids = sorted(by_id)
    measurements, covariances = np.empty((len(ids), sensor.dim)), np.empty((len(ids), sensor.dim, sensor.dim))
    for row, landmark in enumerate(ids):
        measurements[row], covariances[row] = by_id[landmark][0].z, by_id[landmark][0].R
        if len(by_id[landmark]) > 1:
            measurements[row], covariances[row] = _weighted_mean(by_id[landmark], sensor)
    return Detections(measurements, covariances, np.array(ids, dtype=np.int64))


def _weighted_mean(seen: list[Sight], sensor: SensorModel) -> tuple[FloatArray, FloatArray]:
    """One measurement that stands for several of the same landmark from the same pose (exact).

    Raises:
        DataError: they are farther apart than :data:`CONTRADICTION` allows.
    """
    reference = seen[0].z
    information = np.zeros((sensor.dim, sensor.dim))
    pull = np.zeros(sensor.dim)
    square = 0.0
    for sight in seen:
        weight = np.linalg.inv(sight.R)
        information += weight
        # Differences, not values, so that two bearings beside +-pi do not average to zero.
        offset = sensor.residual(sight.z, reference)
        pull += weight @ offset
        square += float(offset @ weight @ offset)
    total = np.linalg.inv(information)
    fused: FloatArray = 0.5 * (total + total.T)
    # The sum of squares about the mean.
    chi2 = square - float(pull @ fused @ pull)
    limit = float(chdtri(sensor.dim * (len(seen) - 1), CONTRADICTION))
    if chi2 > limit:
        others = ", ".join(sight.where.rpartition(":")[2] for sight in seen[1:])
        raise DataError(
            f"{seen[0].where}: this sight of landmark {name_of(seen[0].landmark)} and that of line "
            f"{others} are "
            f"from the same pose and contradict one another: chi-squared {chi2:.4g} where {limit:.4g} "
            "is as good "
            "as never passed; one of them is wrong, or another landmark"
        )
    return sensor.residual(reference + fused @ pull, np.zeros(sensor.dim)), fused


def _prior(
    graph: Graph, first: int, position_sigma_m: float, heading_sigma_rad: float
) -> tuple[FloatArray, FloatArray]:
    n = graph.space_dim
    if graph.prior is not None:
        if graph.prior.pose != first:
            raise DataError(
                f"{graph.prior.where}: a prior on pose {name_of(graph.prior.pose)}; "
                f"only the first pose ({name_of(first)}) can have one"
            )
        return graph.prior.T, graph.prior.covariance
    sigmas = [position_sigma_m] * 2 + [heading_sigma_rad]
    if n == 3:
        sigmas = [heading_sigma_rad] * 3 + [position_sigma_m] * 3
    return graph.poses.get(first, np.eye(n + 1)), np.diag(np.square(sigmas))
