"""Write a log or a measurement stream as g2o text that keeps landmarks and bearing-range edges.

Vertices share one numbering in g2o: landmarks keep their ids, poses follow after the largest of them.
Lines stand in the order in which the robot lived them: each pose's odometry, then what it saw. Bearing-range
edges are lines ``EDGE_BEARING_RANGE_SE2_XY i l bearing range I11 I12 I22``, a kind g2o itself lacks; the
sensor's name and the time stamps are comments, all at the end, since gtsam's reader can lose every edge that
follows a comment. :func:`~slamcmp.datasets.graphs.graph_reader.read_graph` reads all of it back.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from slamcmp.datasets.graphs.graph_reader import SENSOR_COMMENT, TIME_COMMENT
from slamcmp.datasets.graphs.information import inverse_of_definite
from slamcmp.errors import DataError
from slamcmp.geometry import dead_reckoning, quaternion, se2_coordinates
from slamcmp.types import FloatArray, Frame, IntArray, Landmarks, Log, MeasurementStream, SensorModel


def write_g2o(
    path: Path | str,
    data: Log | MeasurementStream,
    *,
    poses: FloatArray | None = None,
    landmarks: Landmarks | None = None,
    own_ids: IntArray | None = None,
) -> None:
    """Write ``data`` to ``path``; vertices hold ``poses`` (K, n+1, n+1) and ``landmarks`` where given.

    Landmarks are written by their own names, ``own_ids`` (L,) or those of a log, loop closures as edges
    between their poses. Without estimates the poses are those of dead reckoning, and a landmark stands where
    it was first seen from there.

    Raises:
        DataError: a covariance without inverse, which information matrices cannot hold, a negative id, or a
            sensor that has no edge in g2o.
    """
    _require_edges(data.problem.sensor)
    frames = _frames(data)
    sensor = data.problem.sensor
    seen = np.concatenate([frame.ids for frame in frames])
    if seen.size and seen.min() < 0:
        raise DataError(f"{path}: landmark id {seen.min()}; g2o needs ids from 0 on (unlabelled detections?)")
    if poses is None:
        increments = np.stack([frame.T_prev_body for frame in frames])
        poses = dead_reckoning(data.problem.T_world_body, increments)
    if len(poses) != len(frames):
        raise DataError(f"{path}: {len(poses)} poses for {len(frames)} frames")
    places: dict[int, FloatArray] = {}
    for frame, T in zip(frames, poses, strict=True):
        positions = sensor.invert(T, frame.z)
        for landmark, position in zip(frame.ids.tolist(), positions, strict=True):
            places.setdefault(landmark, position)
    if landmarks is not None:
        places |= dict(zip(landmarks.ids.tolist(), landmarks.positions, strict=True))
    own = data.own_ids if own_ids is None and isinstance(data, Log) else own_ids
    names = {landmark: landmark if own is None else int(own[landmark]) for landmark in places}
    writer = _Writer(sensor.space_dim, sensor.name, names)
    lines = writer.lines(frames, data.problem.T_world_body, data.problem.P, poses, places)
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _frames(data: Log | MeasurementStream) -> tuple[Frame, ...]:
    if isinstance(data, MeasurementStream):
        return data.frames
    return tuple(
        Frame(
            k,
            float(data.t[k]),
            data.T_prev_body[k],
            data.Q[k],
            seen.ids,
            seen.z,
            seen.R,
            relative_poses=None if data.relative_poses is None else data.relative_poses[k],
        )
        for k, seen in enumerate(data.detections)
    )


def _require_edges(sensor: SensorModel) -> None:
    if (sensor.space_dim, sensor.name) not in {
        (2, "range_bearing"),
        (2, "relative_position"),
        (3, "relative_position"),
    }:
        raise DataError(f"sensor {sensor.name!r} in {sensor.space_dim}-D has no edge in a g2o file")


class _Writer:
    def __init__(self, space_dim: int, sensor_name: str, names: Mapping[int, int]) -> None:
        self._flat = space_dim == 2
        self._bearing = sensor_name == "range_bearing"
        self._sensor = sensor_name
        self._names = names
        self._offset = 1 + max(names.values(), default=-1)

    def lines(
        self,
        frames: tuple[Frame, ...],
        prior: FloatArray,
        prior_covariance: FloatArray,
        poses: FloatArray,
        places: dict[int, FloatArray],
    ) -> Iterator[str]:
        if not self._flat:
            yield "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
        vertex = "VERTEX_SE2" if self._flat else "VERTEX_SE3:QUAT"
        for frame, T in zip(frames, poses, strict=True):
            yield _line(vertex, [self._offset + frame.k], self._pose(T))
        for landmark, position in sorted(places.items()):
            yield _line("VERTEX_XY" if self._flat else "VERTEX_TRACKXYZ", [self._names[landmark]], position)
        information = self._pose_information(prior_covariance, "the prior's P")
        if self._flat:
            yield _line("EDGE_PRIOR_SE2", [self._offset], self._pose(prior), information)
        else:
            yield _line("EDGE_SE3_PRIOR", [self._offset, 0], self._pose(prior), information)
        for frame in frames:
            yield from self._frame(frame)
        yield f"{SENSOR_COMMENT} {self._sensor}"
        for frame in frames:
            yield _line(TIME_COMMENT, [self._offset + frame.k], [frame.t])

    def _frame(self, frame: Frame) -> Iterator[str]:
        here = self._offset + frame.k
        edge = "EDGE_SE2" if self._flat else "EDGE_SE3:QUAT"
        if frame.k:
            information = self._pose_information(frame.Q, f"Q of frame {frame.k}")
            yield _line(edge, [here - 1, here], self._pose(frame.T_prev_body), information)
        related = frame.relative_poses
        if related is not None:
            for earlier, T, P in zip(related.frames.tolist(), related.T_earlier_body, related.P, strict=True):
                information = self._pose_information(P, f"P of frame {frame.k} relative to frame {earlier}")
                yield _line(edge, [self._offset + earlier, here], self._pose(T), information)
        for landmark, measured, covariance in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            yield self._observation(frame.k, here, landmark, measured, covariance)

    def _observation(
        self, k: int, here: int, landmark: int, measured: FloatArray, covariance: FloatArray
    ) -> str:
        what = f"R of landmark {landmark} in frame {k}"
        if self._bearing:
            information = _information(covariance[::-1, ::-1], what)
            return _line(
                "EDGE_BEARING_RANGE_SE2_XY",
                [here, self._names[landmark]],
                measured[::-1],
                _upper(information),
            )
        information = _information(covariance, what)
        if self._flat:
            return _line("EDGE_SE2_XY", [here, self._names[landmark]], measured, _upper(information))
        return _line("EDGE_SE3_TRACKXYZ", [here, self._names[landmark], 0], measured, _upper(information))

    def _pose(self, T: FloatArray) -> FloatArray:
        if self._flat:
            return se2_coordinates(T)
        return np.concatenate([T[:3, 3], quaternion(T[:3, :3])])

    def _pose_information(self, covariance: FloatArray, what: str) -> FloatArray:
        information = _information(covariance, what)
        if not self._flat:
            # g2o has translation before rotation.
            order = [3, 4, 5, 0, 1, 2]
            information = information[np.ix_(order, order)]
        return _upper(information)


def _information(covariance: FloatArray, what: str) -> FloatArray:
    inverse = inverse_of_definite(covariance)
    if inverse is None:
        raise DataError(f"{what} is singular: a g2o file holds its inverse, so no direction may be exact")
    information: FloatArray = 0.5 * (inverse + inverse.T)
    return information


def _upper(matrix: FloatArray) -> FloatArray:
    upper: FloatArray = matrix[np.triu_indices(len(matrix))]
    return upper


def _line(tag: str, ids: Iterable[int] | IntArray, *numbers: Iterable[float]) -> str:
    # repr is the shortest text that reads back to the same bits.
    values = [repr(float(value)) for group in numbers for value in group]
    return " ".join([tag, *map(str, ids), *values])
