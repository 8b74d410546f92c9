"""Odometry for recordings that have images and poses but no wheels.

``corrupted_truth`` adds stated noise to the true motion. ``constant_position`` claims that nothing moved,
with a covariance that grows with the time step, so that a gap in the recording weakens the claim.
``recorded`` takes the motion between poses that came with the recording. No kind invents motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.geometry import exp, inverse
from slamcmp.types import FloatArray

OdometryKind = Literal["corrupted_truth", "constant_position", "recorded"]


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations; those of a step are of one with the median duration, variance grows with time."""

    translation_sigma_m: float
    translation_sigma_per_m: float
    """Of the distance travelled in the step."""
    rotation_sigma_deg: float
    speed_sigma_m_s: float
    """Of what ``constant_position`` leaves out."""
    turn_sigma_deg_s: float

    def of_steps(self, t: FloatArray, increments: FloatArray) -> FloatArray:
        """Standard deviations (K, 6) of measured increments (K, 4, 4); the first is zero."""
        duration = np.diff(t)
        share = duration / np.median(duration)
        distance = np.linalg.norm(increments[1:, :3, 3], axis=1)
        sigmas = np.zeros((t.size, 6))
        sigmas[1:, :3] = (math.radians(self.rotation_sigma_deg) * np.sqrt(share))[:, None]
        variance = self.translation_sigma_m**2 * share + (self.translation_sigma_per_m * distance) ** 2
        sigmas[1:, 3:] = np.sqrt(variance)[:, None]
        return sigmas

    def of_standing(self, t: FloatArray) -> FloatArray:
        """Standard deviations (K, 6) of the claim that nothing moved; the first is zero."""
        sigmas = np.zeros((t.size, 6))
        duration = np.diff(t)[:, None]
        sigmas[1:, :3] = math.radians(self.turn_sigma_deg_s) * duration
        sigmas[1:, 3:] = self.speed_sigma_m_s * duration
        return sigmas


def increments_between(poses: FloatArray) -> FloatArray:
    """(K, 4, 4): each pose in the frame of the one before; the first is the identity."""
    increments = np.tile(np.eye(4), (len(poses), 1, 1))
    increments[1:] = inverse(poses[:-1]) @ poses[1:]
    return increments


def make_odometry(
    kind: OdometryKind,
    t: FloatArray,
    noise: OdometryNoise,
    generator: np.random.Generator,
    *,
    truth: FloatArray | None,
    recorded: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Increments (K, 4, 4) and their covariances (K, 6, 6), in the tangent of the later body.

    Args:
        kind: see the module's text.
        t: (K,) [s].
        noise: what is stated, and for ``corrupted_truth`` also drawn.
        generator: of the drawn noise.
        truth: poses (K, 4, 4), for ``corrupted_truth``.
        recorded: poses (K, 4, 4), for ``recorded``.

    Raises:
        UsageError: the poses that the kind needs are not there.
    """
    if kind == "constant_position":
        sigmas = noise.of_standing(t)
        increments = np.tile(np.eye(4), (t.size, 1, 1))
    elif kind == "corrupted_truth":
        if truth is None:
            raise UsageError(
                "odometry: corrupted_truth needs ground truth, which this recording lacks; "
                "constant_position needs none"
            )
        increments = increments_between(truth)
        sigmas = noise.of_steps(t, increments)
        increments[1:] = increments[1:] @ exp(sigmas[1:] * generator.standard_normal((t.size - 1, 6)))
    else:
        if recorded is None:
            raise UsageError(
                "odometry: recorded needs recorded odometry, which this recording lacks; "
                "corrupted_truth and constant_position need none"
            )
        increments = increments_between(recorded)
        sigmas = noise.of_steps(t, increments)
    covariances = sigmas[:, :, None] ** 2 * np.eye(6)
    return increments, covariances
