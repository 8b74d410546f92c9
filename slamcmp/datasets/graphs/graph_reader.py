"""Reader for SLAM graphs as text: TORO's ``.graph``, g2o's ``.g2o`` and their relatives, with landmarks.

What the numbers after a measurement mean differs from kind to kind:

* ``EDGE2`` (TORO): information in the order I11 I12 I22 I33 I13 I23; where that cannot be (a zero falls on
  the diagonal, as in the wheel's ``w100_30.g2o``) the upper triangle row by row;
* ``EDGE_SE2``, ``EDGE_SE2_XY``, ``EDGE_SE3:QUAT``, ``EDGE_SE3_TRACKXYZ`` (g2o): the upper triangle of the
  information, row by row. In space g2o puts translation before rotation; the rotation's part is taken per
  rotation vector, as GTSAM takes it, although g2o itself optimises over half of it;
* ``LANDMARK2`` (and then ``EDGE_SE2`` beside it): the upper triangle of the *square root* of the
  information, 1/sigma: in the wheel's ``victoriaPark_reduced_1k.g2o`` it is 1.5811 = 1/sqrt(0.4) where
  ``victoria_park.txt`` has the variance 0.4;
* ``ODOMETRY`` and ``LANDMARK``: covariances or square roots of information, depending on the author: the
  caller must say;
* ``BR``: the standard deviations of bearing and range themselves;
* ``EDGE_BEARING_RANGE_SE2_XY i l bearing range I11 I12 I22``: this package's own kind (g2o has none).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from slamcmp.datasets.graphs.graph_types import Graph, LandmarkEdge, PoseEdge, Prior, SensorName, name_of
from slamcmp.datasets.graphs.information import inverse_of_definite
from slamcmp.datasets.text import ends_in_a_line, fields_of, number, text_lines, whole
from slamcmp.errors import DataError, MissingDataError
from slamcmp.geometry import pose, rotation_from_quaternion, se2, wrap
from slamcmp.support.files.paths import is_file
from slamcmp.types import FloatArray

Noise = Literal["auto", "information", "square_root_information", "covariance"]
Value = TypeVar("Value")

TIME_COMMENT = "#slamcmp-time"
"""Start of a comment line ``#slamcmp-time ID SECONDS`` that gives a pose its time stamp."""

SENSOR_COMMENT = "#slamcmp-sensor"
"""Start of a comment line ``#slamcmp-sensor NAME``, for graphs that may hold no observation at all."""

_TORO_ORDER = (0, 1, 4, 2, 5, 3)
"""Where the upper triangle, row by row, stands in TORO's I11 I12 I22 I33 I13 I23."""


def read_graph(path: Path | str, *, noise: Noise = "auto") -> Graph:
    """Read a planar or spatial graph file.

    ``noise`` overrides what the noise numbers of every kind but ``BR`` mean; ``auto`` follows the table
    above. Kinds of lines that are not understood are left out; the graph's ``warnings`` count them.

    Raises:
        MissingDataError: there is no such file.
        DataError: a line cannot be read; the message starts with file:line.
    """
    path = Path(path)
    if not is_file(path):
        raise MissingDataError(f"{path}: there is no such graph file")
    graph = _Reader(path, noise, text_lines(path)).read()
    if not ends_in_a_line(path):
        graph.warnings.append(
            f"{path.name}: the last line is not ended by a line break: was the file cut short, and "
            "with it the "
            "last number?"
        )
    return graph


class _Line:
    """One line's fields, taken from the left, with errors that say where."""

    def __init__(self, where: str, tag: str, fields: list[str], layout: str, numbers: int) -> None:
        self.where, self.tag, self._fields, self._next = where, tag, fields, 0
        wanted = str(numbers) if numbers > 0 else f"at least {-numbers}"
        # So many at least, where the number is not given.
        if len(fields) != numbers if numbers > 0 else len(fields) < -numbers:
            raise DataError(
                f"{where}: {tag} is followed by {len(fields)} numbers where {wanted} are needed: {layout}"
            )

    def id(self) -> int:
        return whole(self.where, self._take())

    def ids(self) -> list[int]:
        return [self.id() for _ in range(len(self._fields) - self._next)]

    def floats(self, count: int) -> FloatArray:
        return np.array([self._float() for _ in range(count)])

    def numbers(self, count: int) -> tuple[float, ...]:
        return tuple(self._float() for _ in range(count))

    def _float(self) -> float:
        return number(self.where, self._take())

    def _take(self) -> str:
        self._next += 1
        return self._fields[self._next - 1]


class _Reader:
    def __init__(self, path: Path, noise: Noise, lines: list[str]) -> None:
        self._path, self._lines = path, lines
        self._graph = Graph(path)
        self._dims: dict[int, str] = {}
        self._fixed: dict[int, str] = {}
        self._offsets: dict[int, FloatArray] = {}
        self._spatial: list[tuple[LandmarkEdge, int]] = []
        tags = {fields[0] for line in lines if (fields := fields_of(line.split("#", 1)[0]))}
        if noise == "auto" and tags & {"ODOMETRY", "LANDMARK"}:
            raise DataError(
                f"{path}: some authors write covariances on ODOMETRY and LANDMARK lines, others square roots "
                "of information; set noise to 'covariance' or 'square_root_information'"
            )
        if noise == "auto":
            noise = "square_root_information" if "LANDMARK2" in tags else "information"
        self._noise: Noise = noise
        # tag: (reader, what follows it, how many numbers that is, dimension of space or 0)
        self._kinds: dict[str, tuple[Callable[[_Line], None], str, int, int]] = {
            **dict.fromkeys(("VERTEX2", "VERTEX_SE2"), (self._vertex_2d, "id x y theta", 4, 2)),
            "VERTEX_XY": (self._vertex_xy, "id x y", 3, 2),
            "VERTEX_SE3:QUAT": (self._vertex_3d, "id x y z qx qy qz qw", 8, 3),
            "VERTEX_TRACKXYZ": (self._vertex_xyz, "id x y z", 4, 3),
            **dict.fromkeys(
                ("EDGE2", "EDGE_SE2", "ODOMETRY"),
                (self._edge_2d, "i j dx dy dtheta and 6 of the noise", 11, 2),
            ),
            **dict.fromkeys(
                ("EDGE_SE2_XY", "LANDMARK2", "LANDMARK"),
                (self._edge_xy, "pose landmark x y and 3 of the noise", 7, 2),
            ),
            "EDGE_BEARING_RANGE_SE2_XY": (
                self._edge_bearing_range,
                "pose landmark bearing range and 3 of the noise",
                7,
                2,
            ),
            "BR": (self._br, "pose landmark bearing range sigma_bearing sigma_range", 6, 2),
            "EDGE_SE3:QUAT": (self._edge_3d, "i j dx dy dz qx qy qz qw and 21 of the noise", 30, 3),
            "EDGE_SE3_TRACKXYZ": (self._edge_xyz, "pose landmark offset x y z and 6 of the noise", 12, 3),
            "PARAMS_SE3OFFSET": (self._offset, "id x y z qx qy qz qw", 8, 3),
            "EDGE_PRIOR_SE2": (self._prior_2d, "id x y theta and 6 of the noise", 10, 2),
            "EDGE_SE3_PRIOR": (self._prior_3d, "id offset x y z qx qy qz qw and 21 of the noise", 30, 3),
            "EQUIV": (self._equivalent, "pose pose", 2, 0),
            "FIX": (self._fix, "ids", -1, 0),
        }

    def read(self) -> Graph:
        unknown: Counter[str] = Counter()
        first_unknown: dict[str, int] = {}
        for row, text in enumerate(self._lines, start=1):
            if text.startswith(TIME_COMMENT):
                self._time(f"{self._path}:{row}", text)
                continue
            if text.startswith(SENSOR_COMMENT):
                self._sensor(f"{self._path}:{row}", text)
                continue
            tag, *fields = fields_of(text.split("#", 1)[0]) or [""]
            if not tag:
                continue
            if tag not in self._kinds:
                unknown[tag] += 1
                first_unknown.setdefault(tag, row)
                continue
            read_line, layout, numbers, dim = self._kinds[tag]
            line = _Line(f"{self._path}:{row}", tag, fields, layout, numbers)
            if dim:
                self._dims.setdefault(dim, line.where)
            read_line(line)
        self._finish()
        if unknown:
            listed = ", ".join(
                f"{count} x {tag} (first at line {first_unknown[tag]})" for tag, count in unknown.items()
            )
            message = f"left out lines of kinds this reader does not know: {listed}"
            if not self._dims:
                raise DataError(f"{self._path}: {message}; it knows {', '.join(sorted(self._kinds))}")
            self._graph.warnings.append(f"{self._path.name}: {message}")
        return self._graph

    def _finish(self) -> None:
        graph = self._graph
        if len(self._dims) > 1:
            raise DataError(
                f"{self._dims[2]} is planar and {self._dims[3]} spatial; a graph is one or the other"
            )
        graph.space_dim = next(iter(self._dims), 2)
        for edge, offset_id in self._spatial:
            if offset_id not in self._offsets:
                raise DataError(f"{edge.where}: there is no PARAMS_SE3OFFSET {offset_id} in the file")
            T = self._offsets[offset_id]
            rotation = T[:3, :3]
            graph.landmark_edges.append(
                LandmarkEdge(
                    edge.pose,
                    edge.landmark,
                    edge.sensor,
                    rotation @ edge.measured + T[:3, 3],
                    rotation @ edge.covariance @ rotation.T,
                    edge.where,
                )
            )
        first = graph.pose_ids()[:1]
        for fixed, where in self._fixed.items():
            if [fixed] != first:
                raise DataError(f"{where}: FIX {name_of(fixed)}; only the first pose can be held")

    def _time(self, where: str, text: str) -> None:
        line = _Line(where, TIME_COMMENT, fields_of(text[len(TIME_COMMENT) :]), "id seconds", 2)
        pose_id, t = line.id(), line.numbers(1)[0]
        _insert(self._graph.times, pose_id, t, line)
        self._graph.time_lines[pose_id] = where

    def _sensor(self, where: str, text: str) -> None:
        name = text[len(SENSOR_COMMENT) :].strip()
        known: dict[str, SensorName] = {
            "range_bearing": "range_bearing",
            "relative_position": "relative_position",
        }
        if name not in known:
            raise DataError(f"{where}: sensor {name!r}; range_bearing or relative_position is needed")
        self._graph.sensor = known[name]

    def _vertex_2d(self, line: _Line) -> None:
        self._insert_pose(line.id(), se2(*line.floats(3)), line)

    def _insert_pose(self, pose_id: int, T: FloatArray, line: _Line) -> None:
        _insert(self._graph.poses, pose_id, T, line)
        self._graph.pose_lines[pose_id] = line.where

    def _vertex_xy(self, line: _Line) -> None:
        _insert(self._graph.landmarks, line.id(), line.floats(2), line)

    def _vertex_3d(self, line: _Line) -> None:
        self._insert_pose(line.id(), _pose_3d(line), line)

    def _vertex_xyz(self, line: _Line) -> None:
        _insert(self._graph.landmarks, line.id(), line.floats(3), line)

    def _edge_2d(self, line: _Line) -> None:
        first, second, T = line.id(), line.id(), se2(*line.floats(3))
        numbers = line.numbers(6)
        if line.tag == "EDGE2" and numbers[2] > 0 and numbers[3] > 0:
            numbers = tuple(numbers[place] for place in _TORO_ORDER)
        covariance = self._covariance(numbers, 3, line)
        self._graph.pose_edges.append(PoseEdge(first, second, T, covariance, line.where))

    def _edge_xy(self, line: _Line) -> None:
        edge = LandmarkEdge(
            line.id(),
            line.id(),
            "relative_position",
            line.floats(2),
            self._covariance(line.numbers(3), 2, line),
            line.where,
        )
        self._graph.landmark_edges.append(edge)

    def _edge_bearing_range(self, line: _Line) -> None:
        pose_id, landmark, measured = line.id(), line.id(), line.floats(2)
        covariance = self._covariance(line.numbers(3), 2, line)
        self._add_bearing_range(pose_id, landmark, measured, covariance, line)

    def _br(self, line: _Line) -> None:
        pose_id, landmark, measured, sigmas = line.id(), line.id(), line.floats(2), line.floats(2)
        if not (sigmas > 0).all():
            raise DataError(
                f"{line.where}: BR has sigmas {sigmas[0]} and {sigmas[1]}; positive ones are needed"
            )
        self._add_bearing_range(pose_id, landmark, measured, np.diag(sigmas**2), line)

    def _add_bearing_range(
        self, pose_id: int, landmark: int, measured: FloatArray, covariance: FloatArray, line: _Line
    ) -> None:
        if not measured[1] > 0:
            raise DataError(f"{line.where}: the range is {measured[1]}; a positive one is needed")
        # example.graph in the wheel has bearings beyond half a turn.
        if abs(measured[0]) > np.pi:
            measured[0] = wrap(measured[0])
        edge = LandmarkEdge(
            pose_id,
            landmark,
            "range_bearing",
            measured[::-1].copy(),
            covariance[::-1, ::-1].copy(),
            line.where,
        )
        self._graph.landmark_edges.append(edge)

    def _edge_3d(self, line: _Line) -> None:
        edge = PoseEdge(
            line.id(), line.id(), _pose_3d(line), self._covariance(line.numbers(21), 6, line), line.where
        )
        self._graph.pose_edges.append(edge)

    def _edge_xyz(self, line: _Line) -> None:
        pose_id, landmark, offset = line.id(), line.id(), line.id()
        measured, covariance = line.floats(3), self._covariance(line.numbers(6), 3, line)
        edge = LandmarkEdge(pose_id, landmark, "relative_position", measured, covariance, line.where)
        self._spatial.append((edge, offset))

    def _offset(self, line: _Line) -> None:
        _insert(self._offsets, line.id(), _pose_3d(line), line)

    def _prior_2d(self, line: _Line) -> None:
        pose_id, T = line.id(), se2(*line.floats(3))
        self._set_prior(Prior(pose_id, T, self._covariance(line.numbers(6), 3, line), line.where))

    def _prior_3d(self, line: _Line) -> None:
        pose_id, offset, T = line.id(), line.id(), _pose_3d(line)
        if offset not in self._offsets or not np.array_equal(self._offsets[offset], np.eye(4)):
            raise DataError(
                f"{line.where}: EDGE_SE3_PRIOR uses offset {offset}; a PARAMS_SE3OFFSET {offset} that is the "
                "identity must stand before it"
            )
        self._set_prior(Prior(pose_id, T, self._covariance(line.numbers(21), 6, line), line.where))

    def _set_prior(self, prior: Prior) -> None:
        if self._graph.prior is not None:
            raise DataError(f"{prior.where}: a second prior; the first is at {self._graph.prior.where}")
        self._graph.prior = prior

    def _equivalent(self, line: _Line) -> None:
        self._graph.equivalent.append((line.id(), line.id()))

    def _fix(self, line: _Line) -> None:
        self._fixed.update(dict.fromkeys(line.ids(), line.where))

    def _covariance(self, upper: tuple[float, ...], size: int, line: _Line) -> FloatArray:
        covariance = _covariance(upper, size, self._noise)
        if covariance is None:
            hint = " (EDGE2 goes in TORO's order, I11 I12 I22 I33 I13 I23)" if line.tag == "EDGE2" else ""
            raise DataError(
                f"{line.where}: the noise numbers are not a positive definite {self._noise} matrix{hint}"
            )
        return covariance


def _insert(into: dict[int, Value], key: int, value: Value, line: _Line) -> None:
    if key in into:
        raise DataError(f"{line.where}: {line.tag} {name_of(key)} stands twice in the file")
    into[key] = value


def _pose_3d(line: _Line) -> FloatArray:
    t, q = line.floats(3), line.floats(4)
    if not 0.99 < float(q @ q) < 1.01:
        raise DataError(f"{line.where}: the quaternion has norm {float(q @ q) ** 0.5:.4g}; 1 is needed")
    return pose(rotation_from_quaternion(q), t)


# Most files repeat one noise model on every line.
@lru_cache(maxsize=4096)
def _covariance(upper: tuple[float, ...], size: int, noise: Noise) -> FloatArray | None:
    """Covariance from an upper triangle, in this package's tangent order; None if it is not definite."""
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    matrix = matrix.T @ matrix if noise == "square_root_information" else matrix + np.triu(matrix, 1).T
    covariance = matrix if noise == "covariance" else inverse_of_definite(matrix)
    if covariance is None or (noise == "covariance" and inverse_of_definite(matrix) is None):
        return None
    covariance = 0.5 * (covariance + covariance.T)
    if size == 6:
        order = [3, 4, 5, 0, 1, 2]
        covariance = covariance[np.ix_(order, order)]
    covariance.flags.writeable = False
    return covariance
