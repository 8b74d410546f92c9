"""Square roots of information matrices: what turns a residual into a sum of unit squares."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.errors import UsageError
from slamcmp.types import FloatArray


def require_definite(covariance: FloatArray, what: str) -> None:
    """Check that a covariance can be whitened, whatever its units.

    Args:
        covariance: (p, p).
        what: names the covariance in the error message.

    Raises:
        UsageError: it is singular, or its correlations are within 1e-12 of singular.
    """
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    if deviations.all():
        correlation = covariance / np.outer(deviations, deviations)
        if np.linalg.eigvalsh(correlation)[0] > 1e-12:
            return
    raise UsageError(
        f"{what} is singular, and graph back ends need a positive definite one: give every direction of the "
        "pose some noise (sideways too; several odometry sub-steps summed do), or use ekf_slam"
    )


def whitener(covariance: FloatArray, what: str) -> FloatArray:
    """Lower-triangular W (p, p) with ``W^T W = covariance^-1``.

    Raises:
        UsageError: as :func:`require_definite`, which names it ``what``.
    """
    require_definite(covariance, what)
    deviations = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(deviations, deviations)
    W: FloatArray = np.linalg.inv(np.linalg.cholesky(correlation)) / deviations
    return W


def whiteners(covariances: FloatArray) -> FloatArray:
    """W (m, d, d) of covariances (m, d, d) that are already known to be positive definite."""
    W: FloatArray = np.linalg.inv(np.linalg.cholesky(covariances))
    return W


def whitened_update(
    S: FloatArray, PHt_t: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """A measurement update in units of its innovation's standard deviations, S = L L^T.

    Args:
        S: innovation covariance, (k, k); may be overwritten.
        PHt_t: (P H^T)^T, (k, states); may be overwritten.
        y: innovation, (k,).

    Returns:
        L (k, k), of which only the lower triangle counts; W^T = L^-1 (P H^T)^T (k, states), where P loses
        W W^T; e = L^-1 y (k,), by which the mean moves W e; and the NIS |e|², NaN where S is not positive
        definite or y not finite.
    """
    L, failed = dpotrf(S, lower=1, clean=0, overwrite_a=1)
    W_t, _ = dtrtrs(L, PHt_t, lower=1, overwrite_b=1)
    e, _ = dtrtrs(L, y, lower=1)
    # dpotrf lets NaN through; it always reaches the NIS.
    return L, W_t, e, (math.nan if failed else float(e @ e))
