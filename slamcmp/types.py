"""The frozen dataclasses that flow from source to report.

n = 2 or 3 is the space, p = 3 or 6 the pose's tangent, m the observations of a frame, d their dimension,
K the frames, L the landmarks. Poses are homogeneous matrices ``T_world_body (n+1, n+1)`` in metres. Every
covariance of a pose is in the body tangent, ``T = T_hat exp(xi)``, in the order (x, y, theta) for SE(2) and
(omega, v) for SE(3). All arrays are float64 (ids: int64), checked for shape and made read-only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.protocols import SensorModel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Status = Literal["ok", "diverged", "crashed", "timed_out"]

TANGENT_DIM = {2: 3, 3: 6}
"""Dimension of the pose tangent for each dimension of space."""


def frozen(value: Any, name: str, shape: tuple[int | None, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """``value`` as a read-only array of the given shape (None: any length), copied unless it already is one.

    Raises:
        DataError: the shape differs; the message names the field and both shapes.
    """
    array: NDArray[Any] = np.asarray(value, dtype=dtype)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want is not None and want != have for want, have in zip(shape, array.shape, strict=True))
    ):
        wanted = tuple("any" if size is None else size for size in shape)
        raise DataError(f"{name}: shape {array.shape} where {wanted} is needed")
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def _set(instance: object, **fields: Any) -> None:
    for name, value in fields.items():
        object.__setattr__(instance, name, value)


def _require_finite(array: NDArray[Any], name: str) -> None:
    if not np.isfinite(array).all():
        raise DataError(f"{name}: has entries that are not finite")


def _require_unique(ids: NDArray[Any], name: str) -> None:
    if ids.size > 1 and np.unique(ids).size != ids.size:
        values, counts = np.unique(ids, return_counts=True)
        raise DataError(f"{name}: id {values[counts > 1][0]} stands twice; each landmark has one")


def _require_psd(covariances: FloatArray, name: str, *, definite: bool) -> None:
    """Check one covariance ``(d, d)`` or a batch of them for symmetry and sign."""
    if covariances.size == 0:
        return
    if not np.allclose(covariances, np.swapaxes(covariances, -1, -2), rtol=1e-9, atol=1e-15):
        raise DataError(f"{name}: a covariance is not symmetric")
    smallest = np.linalg.eigvalsh(covariances)[..., 0]
    scale = np.abs(covariances).max(axis=(-1, -2))
    bad = smallest <= 0 if definite else smallest < -1e-12 * scale
    if np.any(bad):
        kind = "positive definite" if definite else "positive semi-definite"
        raise DataError(f"{name}: a covariance is not {kind} (smallest eigenvalue {smallest.min():.3g})")


@dataclass(frozen=True)
class Problem:
    """What every back end is told at the start: the prior on the first pose, and the sensor."""

    T_world_body: FloatArray
    """Prior mean of the first pose, (n+1, n+1)."""
    P: FloatArray
    """Prior covariance in the body tangent, (p, p); may be singular (a start known exactly)."""
    sensor: SensorModel

    def __post_init__(self) -> None:
        n = self.sensor.space_dim
        p = TANGENT_DIM[n]
        _set(
            self,
            T_world_body=frozen(self.T_world_body, "Problem.T_world_body", (n + 1, n + 1)),
            P=frozen(self.P, "Problem.P", (p, p)),
        )
        _require_finite(self.T_world_body, "Problem.T_world_body")
        _require_finite(self.P, "Problem.P")
        _require_psd(self.P, "Problem.P", definite=False)


@dataclass(frozen=True)
class Detections:
    """Labelled measurements of one instant: what a landmark sensor delivered, or a frame's entries."""

    z: FloatArray
    """(m, d)."""
    R: FloatArray
    """(m, d, d)."""
    ids: IntArray
    """The sensor's own labels, (m,); -1 where it has none."""

    def __post_init__(self) -> None:
        ids = frozen(self.ids, "Detections.ids", (None,), np.int64)
        z = frozen(self.z, "Detections.z", (ids.size, None))
        _set(self, ids=ids, z=z, R=frozen(self.R, "Detections.R", (ids.size, z.shape[1], z.shape[1])))


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

    def __post_init__(self) -> None:
        increment = np.asarray(self.T_prev_body)
        n = increment.shape[-1] - 1
        if n not in TANGENT_DIM:
            raise DataError(f"Frame.T_prev_body: shape {increment.shape} where (3, 3) or (4, 4) is needed")
        p = TANGENT_DIM[n]
        ids = frozen(self.ids, "Frame.ids", (None,), np.int64)
        z = frozen(self.z, "Frame.z", (ids.size, None))
        _set(
            self,
            T_prev_body=frozen(increment, "Frame.T_prev_body", (n + 1, n + 1)),
            Q=frozen(self.Q, "Frame.Q", (p, p)),
            ids=ids,
            z=z,
            R=frozen(self.R, "Frame.R", (ids.size, z.shape[1], z.shape[1])),
        )


@dataclass(frozen=True)
class CameraFrame:
    """What the robot's cameras delivered at one instant; all images have the size of the left one."""

    image: NDArray[np.uint8] | None
    """Grey values (height, width) of the left or only camera; None where there is no usable image."""
    right: NDArray[np.uint8] | None = None
    """The right camera's, rectified with the left one."""
    depth_m: NDArray[np.float32] | None = None
    """Depth along the optical axis [m], 0 where it is not known."""
    problem: str = ""
    """Why there is no usable image, as a phrase to count skipped frames by."""


@dataclass(frozen=True)
class GroundTruth:
    """What the estimators never see."""

    t: FloatArray
    """(K,) [s], the time stamps of the log."""
    T_world_body: FloatArray
    """(K, n+1, n+1)."""
    ids: IntArray
    """(L,)."""
    positions: FloatArray
    """(L, n) [m]."""
    outliers: tuple[BoolArray, ...] | None = None
    """Where the log's detections were spoilt on purpose: one mask a frame, over its detections."""

    def __post_init__(self) -> None:
        t = frozen(self.t, "GroundTruth.t", (None,))
        poses = np.asarray(self.T_world_body, dtype=np.float64)
        size = poses.shape[-1]
        ids = frozen(self.ids, "GroundTruth.ids", (None,), np.int64)
        _require_unique(ids, "GroundTruth.ids")
        _set(
            self,
            t=t,
            T_world_body=frozen(poses, "GroundTruth.T_world_body", (t.size, size, size)),
            ids=ids,
            positions=frozen(self.positions, "GroundTruth.positions", (ids.size, size - 1)),
        )


@dataclass(frozen=True)
class Log:
    """What the sensors recorded, as a source delivers it."""

    name: str
    problem: Problem
    t: FloatArray
    """(K,) [s], strictly increasing."""
    T_prev_body: FloatArray
    """Odometry increments, (K, n+1, n+1); the first is the identity."""
    Q: FloatArray
    """Their covariances in the body tangent, (K, p, p); the first is zero."""
    detections: tuple[Detections, ...]
    """One entry a frame."""
    truth: GroundTruth | None = None
    images: Sequence[CameraFrame] | None = None
    """One entry a frame, read or rendered when it is asked for; None for sensors without images."""
    warnings: tuple[str, ...] = ()
    """What a reader of the results must know about the recording, such as lines that were left out."""

    def __post_init__(self) -> None:
        n = self.problem.sensor.space_dim
        p = TANGENT_DIM[n]
        t = frozen(self.t, "Log.t", (None,))
        _set(
            self,
            t=t,
            T_prev_body=frozen(self.T_prev_body, "Log.T_prev_body", (t.size, n + 1, n + 1)),
            Q=frozen(self.Q, "Log.Q", (t.size, p, p)),
        )
        if len(self.detections) != t.size:
            raise DataError(f"Log.detections: {len(self.detections)} entries for {t.size} frames")
        if self.truth is not None and self.truth.t.size != t.size:
            raise DataError(f"Log.truth: {self.truth.t.size} poses for {t.size} frames")
        if self.images is not None and len(self.images) != t.size:
            raise DataError(f"Log.images: {len(self.images)} images for {t.size} frames")


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

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns of ``counts``."""
        return ("raw", *self.stages, "kept")

    def totals(self) -> dict[str, int]:
        """Sum of each column over the frames, then the frames with each event."""
        columns = dict(zip(self.columns, (int(total) for total in self.counts.sum(axis=0)), strict=True))
        return columns | {f"frames: {event}": count for event, count in self.events.items()}


@dataclass(frozen=True)
class MeasurementStream:
    """The front end's frozen output: the same bytes for every back end, named by its digest."""

    problem: Problem
    frames: tuple[Frame, ...]
    report: FrontEndReport | None = field(default=None, compare=False)
    """Not part of the digest: it describes the stream's making, not its content."""

    def __post_init__(self) -> None:
        sensor = self.problem.sensor
        size = sensor.space_dim + 1
        entered: set[int] = set()
        if not self.frames:
            raise DataError("MeasurementStream.frames: needs at least one frame")
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
            _check_entries(sensor, frame, entered, where)
        first = self.frames[0]
        if not np.array_equal(first.T_prev_body, np.eye(size)) or first.Q.any():
            raise DataError("MeasurementStream.frames[0]: must carry the identity and Q = 0")
        for name in ("T_prev_body", "Q", "z", "R"):
            stacked = np.concatenate([np.ravel(getattr(frame, name)) for frame in self.frames])
            _require_finite(stacked, f"MeasurementStream.frames[*].{name}")
        _require_psd(np.stack([frame.Q for frame in self.frames]), "Frame.Q", definite=False)
        _require_psd(np.concatenate([frame.R for frame in self.frames]), "Frame.R", definite=True)
        entries = [frame.entries for frame in self.frames if frame.entries is not None]
        if entries:
            _require_finite(np.concatenate([each.z.ravel() for each in entries]), "Frame.entries.z")
            _require_psd(np.concatenate([each.R for each in entries]), "Frame.entries.R", definite=True)

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
        _require_unique(ids, "Landmarks.ids")
        positions = frozen(self.positions, "Landmarks.positions", (ids.size, None))
        n = positions.shape[1]
        _set(
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
        _set(
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
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def completion(self) -> float:
        """Share of the stream's frames that were finished, 0 to 1."""
        return self.online.t.size / self.frames
