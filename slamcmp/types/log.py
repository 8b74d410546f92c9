"""What the sensors recorded, and the truth behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.types.arrays import BoolArray, FloatArray, IntArray
from slamcmp.types.checks import TANGENT_DIM, assign, frozen, require_finite, require_psd, require_unique
from slamcmp.types.sensor import SensorModel


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
        require_unique(ids, "GroundTruth.ids")
        assign(
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
        assign(
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
