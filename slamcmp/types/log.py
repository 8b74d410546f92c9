"""What the sensors recorded, and the truth behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.types.arrays import BoolArray, FloatArray, IntArray
from slamcmp.types.checks import TANGENT_DIM, assign, frozen, require_finite, require_psd, require_unique
from slamcmp.types.columns import parts
from slamcmp.types.sensor import SensorModel

_SAME_STAMP_S = 1e-9
"""Within which two time stamps are one."""


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
        assign(
            self,
            T_world_body=frozen(self.T_world_body, "Problem.T_world_body", (n + 1, n + 1)),
            P=frozen(self.P, "Problem.P", (p, p)),
        )
        require_finite(self.T_world_body, "Problem.T_world_body")
        require_finite(self.P, "Problem.P")
        require_psd(self.P, "Problem.P", definite=False)


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
        assign(self, ids=ids, z=z, R=frozen(self.R, "Detections.R", (ids.size, z.shape[1], z.shape[1])))


def detections_of(sizes: IntArray, z: FloatArray, R: FloatArray, ids: IntArray) -> list[Detections]:
    """Detections of all instants, ``sizes`` (K,) of them each, z (M, d), R (M, d, d) and ids (M,) together.

    Raises:
        DataError: the shapes do not fit one another.
    """
    whole = Detections(z, R, ids)
    if sizes.sum() != whole.ids.size:
        raise DataError(f"Detections: {whole.ids.size} of all instants where {sizes.sum()} are needed")
    made = []
    columns = (parts(column, sizes) for column in (whole.z, whole.R, whole.ids))
    for own_z, own_R, own_ids in zip(*columns, strict=True):
        # Past the constructor: what it looks at was looked at in all of them.
        detections = object.__new__(Detections)
        detections.__dict__.update(z=own_z, R=own_R, ids=own_ids)
        made.append(detections)
    return made


@dataclass(frozen=True)
class RelativePoses:
    """What was measured of the pose of one instant relative to earlier ones: loop closures."""

    frames: IntArray
    """The earlier frames, (c,); one may stand more than once, each time a measurement of its own."""
    T_earlier_body: FloatArray
    """(c, n+1, n+1): maps points of this body to the earlier one."""
    P: FloatArray
    """Their covariances in the tangent of this body, (c, p, p)."""

    def __post_init__(self) -> None:
        frames = frozen(self.frames, "RelativePoses.frames", (None,), np.int64)
        size = np.shape(self.T_earlier_body)[-1]
        p = TANGENT_DIM.get(size - 1, 0)
        assign(
            self,
            frames=frames,
            T_earlier_body=frozen(
                self.T_earlier_body, "RelativePoses.T_earlier_body", (frames.size, size, size)
            ),
            P=frozen(self.P, "RelativePoses.P", (frames.size, p, p)),
        )
        require_finite(self.T_earlier_body, "RelativePoses.T_earlier_body")
        require_finite(self.P, "RelativePoses.P")
        require_psd(self.P, "RelativePoses.P", definite=True)


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
    """What the estimators never see.

    It may have gaps: a pose that is not finite is not known, and no score uses its frame.
    """

    t: FloatArray
    """(K,) [s], the time stamps of the log; :class:`Log` fills in those that are missing here."""
    T_world_body: FloatArray
    """(K, n+1, n+1); NaN where it is not known."""
    ids: IntArray
    """(L,)."""
    positions: FloatArray
    """(L, n) [m]."""
    outliers: tuple[BoolArray, ...] | None = None
    """Where the log's detections were spoilt on purpose: one mask a frame, over its detections."""
    P: FloatArray | None = None
    """Covariances of the poses, (K, p, p) in their body tangent; None: they are exact. NaN where a pose is
    not known."""

    def __post_init__(self) -> None:
        t = frozen(self.t, "GroundTruth.t", (None,))
        poses = np.asarray(self.T_world_body, dtype=np.float64)
        size = poses.shape[-1]
        if self.P is not None:
            p = TANGENT_DIM.get(size - 1, 0)
            P = frozen(self.P, "GroundTruth.P", (t.size, p, p))
            require_psd(P[np.isfinite(P).all(axis=(1, 2))], "GroundTruth.P", definite=False)
            assign(self, P=P)
        ids = frozen(self.ids, "GroundTruth.ids", (None,), np.int64)
        require_unique(ids, "GroundTruth.ids")
        assign(
            self,
            t=t,
            T_world_body=frozen(poses, "GroundTruth.T_world_body", (t.size, size, size)),
            ids=ids,
            positions=frozen(self.positions, "GroundTruth.positions", (ids.size, size - 1)),
        )

    def known(self) -> BoolArray:
        """Of which frames the pose is known, (K,)."""
        return np.asarray(np.isfinite(self.T_world_body).all(axis=(1, 2)))

    def at(self, t: FloatArray) -> GroundTruth:
        """The same at the stamps t (K,), with a gap at each one that is missing here.

        Raises:
            DataError: it has a stamp twice, or one that is not among them.
        """
        if self.t.shape == t.shape:
            return self
        rows = np.argmin(np.abs(t[None, :] - self.t[:, None]), axis=1) if t.size else np.empty(0, np.int64)
        strange = np.flatnonzero(np.abs(t[rows] - self.t) > _SAME_STAMP_S)
        if strange.size or not t.size:
            raise DataError(
                f"GroundTruth.t: {self.t[strange[0] if strange.size else 0]!r} s is none of the log's "
                f"{t.size} time stamps; give truth at them, with some left out where it is not known"
            )
        if np.unique(rows).size != rows.size:
            raise DataError("GroundTruth.t: two poses have one time stamp of the log")
        if self.outliers is not None:
            raise DataError(f"GroundTruth.outliers: {self.t.size} masks for {t.size} frames")
        poses = np.full((t.size, *self.T_world_body.shape[1:]), np.nan)
        poses[rows] = self.T_world_body
        P = None
        if self.P is not None:
            P = np.full((t.size, *self.P.shape[1:]), np.nan)
            P[rows] = self.P
        return GroundTruth(t, poses, self.ids, self.positions, P=P)


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
    relative_poses: tuple[RelativePoses | None, ...] | None = None
    """One entry a frame, None where nothing relates it to an earlier one; None for logs without any."""
    own_ids: IntArray | None = None
    """(L,): what the recording itself calls the landmarks 0 … L - 1, where it has other names for them."""

    def __post_init__(self) -> None:
        n = self.problem.sensor.space_dim
        p = TANGENT_DIM[n]
        t = frozen(self.t, "Log.t", (None,))
        assign(
            self,
            t=t,
            T_prev_body=frozen(self.T_prev_body, "Log.T_prev_body", (t.size, n + 1, n + 1)),
            Q=frozen(self.Q, "Log.Q", (t.size, p, p)),
        )
        if len(self.detections) != t.size:
            raise DataError(f"Log.detections: {len(self.detections)} entries for {t.size} frames")
        if self.truth is not None:
            assign(self, truth=self.truth.at(self.t))
        if self.relative_poses is not None and len(self.relative_poses) != t.size:
            raise DataError(f"Log.relative_poses: {len(self.relative_poses)} entries for {t.size} frames")
        if self.own_ids is not None:
            assign(self, own_ids=frozen(self.own_ids, "Log.own_ids", (None,), np.int64))
        if self.images is not None and len(self.images) != t.size:
            raise DataError(f"Log.images: {len(self.images)} images for {t.size} frames")
