"""What the front end makes of a log, for every back end alike."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count

import numpy as np

from slamcmp.errors import DataError
from slamcmp.types.arrays import BoolArray, FloatArray, IntArray
from slamcmp.types.association import Association
from slamcmp.types.checks import TANGENT_DIM, assign, frozen, require_finite, require_psd
from slamcmp.types.columns import Columns, columns_of, own_parts, own_rows
from slamcmp.types.log import Detections, Problem, RelativePoses
from slamcmp.types.sensor import SensorModel

EVENT = "frames: "
"""Before an event in the totals of a report."""
JUDGED, RIGHT = "matches with known truth", "right matches"
PASSED, PASSED_RIGHT = "matches that passed", "right matches that passed"
"""In the totals: precision is PASSED_RIGHT of PASSED, recall PASSED_RIGHT of RIGHT."""


@dataclass(frozen=True)
class Frame:
    """One time step: how the robot moved since the last one, and what it saw on arrival.

    Frame 0 carries the identity and zero Q: the prior is the pose at frame 0. An id stands at most once in
    a frame.
    """

    k: int
    t: float
    """Time stamp [s]."""
    T_prev_body: FloatArray
    """Odometry increment, (n+1, n+1): maps points of this body frame to the previous one."""
    Q: FloatArray
    """Covariance of the increment in the tangent of this body frame, (p, p)."""
    ids: IntArray
    """Landmark ids, (m,)."""
    z: FloatArray
    """Measurements, (m, d)."""
    R: FloatArray
    """Covariances of the measurements, (m, d, d)."""
    entries: Detections | None = None
    """Landmarks that enter the map here, measured by ``entry_sensor`` (models/sensors.py); only where one
    measurement of the stream's own sensor does not place a landmark, as a single camera's does not."""
    relative_poses: RelativePoses | None = None
    """What was measured of this pose relative to earlier ones; None in most streams."""

    def __post_init__(self) -> None:
        increment = np.asarray(self.T_prev_body)
        n = increment.shape[-1] - 1
        if n not in TANGENT_DIM:
            raise DataError(f"Frame.T_prev_body: shape {increment.shape} where (3, 3) or (4, 4) is needed")
        p = TANGENT_DIM[n]
        ids = frozen(self.ids, "Frame.ids", (None,), np.int64)
        z = frozen(self.z, "Frame.z", (ids.size, None))
        assign(
            self,
            T_prev_body=frozen(increment, "Frame.T_prev_body", (n + 1, n + 1)),
            Q=frozen(self.Q, "Frame.Q", (p, p)),
            ids=ids,
            z=z,
            R=frozen(self.R, "Frame.R", (ids.size, z.shape[1], z.shape[1])),
        )


def frames_of(
    columns: Columns,
    entries: Mapping[int, Detections] | None = None,
    relative_poses: Mapping[int, RelativePoses] | None = None,
) -> tuple[Frame, ...]:
    """The frames of columns, each with arrays of its own; entries and relative poses by frame.

    Raises:
        ValueError: the columns do not fit one another.
    """
    K, M = columns.sizes.size, int(columns.sizes.sum())
    n = columns.T_prev_body.shape[-1] - 1
    p, d = TANGENT_DIM.get(n, 0), columns.z.shape[-1]
    wanted = {
        "k": (K,),
        "t": (K,),
        "T_prev_body": (K, n + 1, n + 1),
        "Q": (K, p, p),
        "ids": (M,),
        "z": (M, d),
        "R": (M, d, d),
    }
    for name, shape in wanted.items():
        have = getattr(columns, name).shape
        if have != shape:
            raise ValueError(f"Frame.{name}: shape {have} of all frames together where {shape} is needed")
    entries, relative_poses = entries or {}, relative_poses or {}
    made = []
    for k, t, T, Q, ids, z, R in zip(
        columns.k.tolist(),
        columns.t.tolist(),
        own_rows(np.asarray(columns.T_prev_body, dtype=np.float64)),
        own_rows(np.asarray(columns.Q, dtype=np.float64)),
        own_parts(np.asarray(columns.ids, dtype=np.int64), columns.sizes),
        own_parts(np.asarray(columns.z, dtype=np.float64), columns.sizes),
        own_parts(np.asarray(columns.R, dtype=np.float64), columns.sizes),
        strict=True,
    ):
        # Past the constructor: what it looks at in each frame was looked at in all.
        frame = object.__new__(Frame)
        frame.__dict__.update(
            k=k,
            t=t,
            T_prev_body=T,
            Q=Q,
            ids=ids,
            z=z,
            R=R,
            entries=entries.get(k),
            relative_poses=relative_poses.get(k),
        )
        made.append(frame)
    return tuple(made)


@dataclass(frozen=True)
class FrontEndReport:
    """What each stage of the front end let through, frame by frame."""

    stages: tuple[str, ...]
    """Names of the reasons, in the order they are checked, after the first column ``raw``."""
    counts: IntArray
    """(K, 1 + stages + 1): raw detections, how many each stage removed, how many were kept."""
    kept: tuple[BoolArray, ...]
    """One mask a frame over the raw detections."""
    events: Mapping[str, int] = field(default_factory=dict)
    """Frames with something out of the ordinary, by what it was: why an image was skipped, for instance."""
    times_ms: Mapping[str, FloatArray] = field(default_factory=dict)
    """Wall time of each stage, one entry a frame that was used; empty for a stored stream."""
    warnings: tuple[str, ...] = ()
    """What a user must know about the sensor's data, each with its likely cause."""
    judged: Mapping[str, int] = field(default_factory=dict)
    """Matches by the truth, under the four names above, where the images know it; not stored."""
    association: Association | None = None
    """What a front end decided that was told no labels; not stored with the stream."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns of ``counts``."""
        return ("raw", *self.stages, "kept")

    def totals(self) -> dict[str, int]:
        """Sum of each column over the frames, frames with each event, and the matches by the truth."""
        columns = dict(zip(self.columns, (int(total) for total in self.counts.sum(axis=0)), strict=True))
        return (
            columns | {f"{EVENT}{event}": count for event, count in self.events.items()} | dict(self.judged)
        )


@dataclass(frozen=True)
class MeasurementStream:
    """The front end's frozen output: the same bytes for every back end, named by its digest."""

    problem: Problem
    frames: tuple[Frame, ...]
    report: FrontEndReport | None = field(default=None, compare=False)
    """Not part of the digest: it describes the stream's making, not its content."""

    def __post_init__(self) -> None:
        if not self.frames:
            raise DataError("MeasurementStream.frames: needs at least one frame")
        size, d = self.problem.sensor.space_dim + 1, self.problem.sensor.dim
        fit = all(
            frame.T_prev_body.shape == (size, size) and frame.z.shape[1] == d and frame.k == k
            for k, frame in zip(count(), self.frames)
        )
        if not fit:
            self._refuse()
        columns = columns_of(self.frames)
        if (np.diff(columns.t) <= 0).any() or columns.sees_one_twice():
            self._refuse()
        self._check_what_is_rare()
        if not np.array_equal(columns.T_prev_body[0], np.eye(size)) or columns.Q[0].any():
            raise DataError("MeasurementStream.frames[0]: must carry the identity and Q = 0")
        for name in ("T_prev_body", "Q", "z", "R"):
            require_finite(getattr(columns, name), f"MeasurementStream.frames[*].{name}")
        require_psd(columns.Q, "Frame.Q", definite=False)
        require_psd(columns.R, "Frame.R", definite=True)

    def _refuse(self) -> None:
        """Raise DataError for the first frame that is not the next one of this sensor's."""
        sensor = self.problem.sensor
        size = sensor.space_dim + 1
        for index, frame in enumerate(self.frames):
            where = f"MeasurementStream.frames[{index}]"
            if frame.k != index:
                raise DataError(f"{where}: k is {frame.k}; frames are numbered from 0 without gaps")
            if frame.T_prev_body.shape != (size, size) or frame.z.shape[1] != sensor.dim:
                raise DataError(
                    f"{where}: poses {frame.T_prev_body.shape} and measurements of dimension "
                    f"{frame.z.shape[1]} do not fit sensor {sensor.name!r}"
                )
            if index and frame.t <= self.frames[index - 1].t:
                raise DataError(f"{where}: time {frame.t} s does not come after the previous frame's")
            if frame.ids.size > 1 and np.unique(frame.ids).size != frame.ids.size:
                raise DataError(f"{where}: a landmark id stands twice")

    def _check_what_is_rare(self) -> None:
        """Entries and relative poses, which most streams do not have."""
        sensor = self.problem.sensor
        size = sensor.space_dim + 1
        enter = getattr(sensor, "entry_sensor", None) is not None
        entered: set[int] = set()
        for frame in self.frames:
            if enter or frame.entries is not None:
                _check_entries(sensor, frame, entered, f"MeasurementStream.frames[{frame.k}]")
            if frame.relative_poses is not None:
                _check_relative_poses(frame, size, f"MeasurementStream.frames[{frame.k}]")
        entries = [frame.entries for frame in self.frames if frame.entries is not None]
        if entries:
            require_finite(np.concatenate([each.z.ravel() for each in entries]), "Frame.entries.z")
            require_psd(np.concatenate([each.R for each in entries]), "Frame.entries.R", definite=True)

    @cached_property
    def digest(self) -> str:
        """sha256 (hex) of the problem and every frame, independent of byte order and memory layout."""
        sensor = self.problem.sensor
        header = {
            "format": 1,
            "sensor": sensor.name,
            "parameters": dict(sensor.parameters()),
            "frames": len(self.frames),
        }
        hasher = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
        hasher.update(self.problem.T_world_body.astype("<f8").tobytes())
        hasher.update(self.problem.P.astype("<f8").tobytes())
        plain = all(frame.entries is None and frame.relative_poses is None for frame in self.frames)
        if plain:
            hasher.update(columns_of(self.frames).content())
            return hasher.hexdigest()
        for frame in self.frames:
            hasher.update(np.array([frame.k, frame.ids.size], dtype="<i8").tobytes())
            hasher.update(np.float64(frame.t).astype("<f8").tobytes())
            for array, kind in (
                (frame.T_prev_body, "<f8"),
                (frame.Q, "<f8"),
                (frame.ids, "<i8"),
                (frame.z, "<f8"),
                (frame.R, "<f8"),
            ):
                hasher.update(array.astype(kind).tobytes())
            if frame.entries is not None:
                hasher.update(b"entries" + np.array([frame.entries.ids.size], dtype="<i8").tobytes())
                hasher.update(frame.entries.ids.astype("<i8").tobytes())
                hasher.update(frame.entries.z.astype("<f8").tobytes())
                hasher.update(frame.entries.R.astype("<f8").tobytes())
            if frame.relative_poses is not None:
                related = frame.relative_poses
                hasher.update(b"relative_poses" + np.array([related.frames.size], dtype="<i8").tobytes())
                hasher.update(related.frames.astype("<i8").tobytes())
                hasher.update(related.T_earlier_body.astype("<f8").tobytes())
                hasher.update(related.P.astype("<f8").tobytes())
        return hasher.hexdigest()


def _check_entries(sensor: SensorModel, frame: Frame, entered: set[int], where: str) -> None:
    """Each landmark enters once, and a sensor that cannot place one sees only those that have entered."""
    by: SensorModel | None = getattr(sensor, "entry_sensor", None)
    if frame.entries is not None:
        if by is None:
            raise DataError(
                f"{where}: has entries, but sensor {sensor.name!r} places a landmark by itself: make them "
                "measurements"
            )
        if frame.entries.z.shape[1] != by.dim:
            raise DataError(
                f"{where}: entries of dimension {frame.entries.z.shape[1]} where {by.dim} is needed"
            )
        new = frame.entries.ids.tolist()
        known = sorted(entered.intersection(new))
        if known or len(set(new)) != len(new):
            raise DataError(f"{where}: landmark {known[0] if known else new} enters twice")
    if by is not None:
        strangers = set(frame.ids.tolist()) - entered
        if strangers:
            raise DataError(
                f"{where}: landmark {min(strangers)} is measured before it entered; sensor {sensor.name!r} "
                "cannot place it"
            )
        if frame.entries is not None:
            entered.update(frame.entries.ids.tolist())


def _check_relative_poses(frame: Frame, size: int, where: str) -> None:
    """They are of the stream's space, and to frames before their own."""
    related = frame.relative_poses
    if related is None:
        return
    if not related.frames.size:
        raise DataError(f"{where}: relative_poses without an entry; None is needed")
    if related.T_earlier_body.shape[1] != size:
        raise DataError(
            f"{where}: relative poses {related.T_earlier_body.shape[1:]} where {(size, size)} is needed"
        )
    if related.frames.min() < 0 or related.frames.max() >= frame.k:
        raise DataError(
            f"{where}: a pose relative to frame {related.frames.max()}; one of an earlier frame is needed"
        )
