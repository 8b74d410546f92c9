"""From a recording in the plane to a log: the first pose, the steps between frames, and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from slamcmp.datasets.plain.plain_motion import Motion
from slamcmp.datasets.trajectories import poses_at
from slamcmp.errors import DataError
from slamcmp.geometry import se2
from slamcmp.types import Detections, FloatArray, GroundTruth, IntArray, Log, Problem, SensorModel


@dataclass(frozen=True)
class PlanarTruth:
    """True poses at a log's frames."""

    T_world_body: FloatArray
    """(K, 3, 3), NaN where it is not known."""
    P: FloatArray | None = None
    """Their covariances in the body tangent, (K, 3, 3)."""

    def after(self, first: int) -> PlanarTruth:
        """Without the frames before the ``first``."""
        return PlanarTruth(self.T_world_body[first:], None if self.P is None else self.P[first:])


@dataclass(frozen=True)
class PlanarStart:
    """Where a log starts, and how well that is known."""

    at: Literal["truth", "origin"]
    position_sigma_m: float
    heading_sigma_rad: float
    pose: tuple[float, float, float] | None = None
    """x [m], y [m], theta [rad]; instead of ``at``, where it is told."""


def planar_log(
    name: str,
    motion: Motion,
    densities: FloatArray,
    t: FloatArray,
    detections: Sequence[Detections],
    sensor: SensorModel,
    *,
    start: PlanarStart,
    truth: PlanarTruth | None,
    landmarks: tuple[IntArray, FloatArray],
    warnings: Sequence[str] = (),
    own_ids: Any = None,
) -> Log:
    """The log with frames at t (K,) and what was detected at each.

    ``densities`` (3,) are the odometry's noise (plain_motion.py); ``landmarks`` are true names (L,) and
    positions (L, 2). A log that starts at the truth starts with the first frame whose pose is known.

    Raises:
        DataError: it should start at a truth that knows no frame.
    """
    told = list(warnings)
    first = np.eye(3)
    if start.pose is not None:
        first = se2(*start.pose)
    elif truth is not None and start.at == "truth":
        known = np.flatnonzero(np.isfinite(truth.T_world_body).all(axis=(1, 2)))
        if not known.size:
            raise DataError(
                f"{name}: the truth knows no pose at any of the log's {t.size} frames, {t[0]:.9g} to "
                f"{t[-1]:.9g} s"
            )
        if known[0]:
            told.append(
                f"the first {known[0]} frames, before the truth begins, are left out (start: origin keeps)"
            )
            t, detections, truth = t[known[0] :], detections[known[0] :], truth.after(int(known[0]))
        first = truth.T_world_body[0]
    steps = [motion.between(a, b, densities) for a, b in pairwise(t)]
    sigmas = np.array([start.position_sigma_m, start.position_sigma_m, start.heading_sigma_rad])
    return Log(
        name,
        Problem(first, np.diag(np.square(sigmas)), sensor),
        t,
        np.stack([np.eye(3), *(step for step, _ in steps)]),
        np.stack([np.zeros((3, 3)), *(Q for _, Q in steps)]),
        tuple(detections),
        None if truth is None else GroundTruth(t, truth.T_world_body, *landmarks, P=truth.P),
        warnings=tuple(told),
        own_ids=own_ids,
    )


def planar_poses_at(t: FloatArray, stamps: FloatArray, poses: FloatArray, *, max_gap_s: float) -> FloatArray:
    """(K, 3, 3) at times t (K,), between x, y, theta (rows, 3) at ``stamps``; NaN where nothing is known."""
    x, y, theta = poses.T
    spatial = np.tile(np.eye(4), (stamps.size, 1, 1))
    spatial[:, :2, :2] = se2(x, y, theta)[:, :2, :2]
    spatial[:, 0, 3], spatial[:, 1, 3] = x, y
    return as_planar(poses_at(t, stamps, spatial, max_gap_s=max_gap_s))


def as_planar(poses: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) in space, seen from above: (K, 3, 3)."""
    return se2(poses[:, 0, 3], poses[:, 1, 3], np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
