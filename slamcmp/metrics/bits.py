"""What an estimate of the pose is worth, in bits: how sure it claims to be, and what its claim is worth.

========  ====================================================================================
symbol    meaning
========  ====================================================================================
P         claimed covariance of the pose in the body tangent, (p, p); with the truth's own added
e         error of the pose in the body tangent, (p,)
H         entropy of N(0, P): ½ log2 det(2 pi exp(1) P) (Cover and Thomas 2006, theorem 8.4.1)
S         logarithmic score (Good 1952): log2 of the density of N(0, P) at e
========  ====================================================================================

S = -½ log2 det(2 pi P) - e^T P^-1 e / (2 ln 2). Radians and metres enter both as they are, so that only
differences mean something: what one back end gains over another, or over the odometry alone, on the same
stream. Where the claim is honest, the expectation of S is -H; where P is too small, H falls (a gain that is
none) and S, a proper score, does not rise (Gneiting and Raftery 2007). "Visual SLAM: why
filter?" (Strasdat, Montiel, Davison 2012) measures accuracy as such a reduction of entropy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slamcmp.metrics.consistency import nees_series
from slamcmp.metrics.remembered import remembered
from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Trajectory

_BITS: dict[str, Any] = {
    "unit": "bit",
    "needs": frozenset({"truth", "covariance"}),
    "scope": "trajectory",
}


@metrics.register("pose_entropy_bits", header="pose entropy", lower_is_better=None, **_BITS)
def pose_entropy_bits(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Mean entropy of the claimed pose; the difference of two back ends is what one claims to know more."""
    log_det, _ = _by_frame(trajectory, truth, None)
    dimension = 0 if trajectory.P is None else trajectory.P.shape[-1]
    return _mean(0.5 * (log_det + dimension * math.log2(2.0 * math.pi * math.e)))


@metrics.register("pose_log_score_bits", header="pose log score", lower_is_better=False, **_BITS)
def pose_log_score_bits(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Mean logarithmic score of the claimed pose at the true one; differences between back ends count."""
    log_det, nees = _by_frame(trajectory, truth, None)
    dimension = 0 if trajectory.P is None else trajectory.P.shape[-1]
    return _mean(-0.5 * (log_det + dimension * math.log2(2.0 * math.pi) + nees / math.log(2.0)))


@remembered
def _by_frame(
    trajectory: Trajectory,
    truth: GroundTruth,
    how: None,  # noqa: ARG001
) -> tuple[FloatArray, FloatArray]:
    """log2 det P and NEES of the frames that have a NEES, (K,) each, in the truth's order."""
    nees = nees_series(trajectory, truth)
    used = ~np.isnan(nees)
    if trajectory.P is None or not used.any():
        return np.empty(0), np.empty(0)
    P = trajectory.P if truth.P is None else trajectory.P + truth.P[: len(nees)]
    sign, log_det = np.linalg.slogdet(P[used])
    assert (sign > 0).all()  # Where it is not, there is no NEES.
    return log_det / math.log(2.0), nees[used]


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan
