"""How far one Gaussian answer lies from another, and how far an estimate has moved from its Jacobians.

Both Gaussians stand in one chart: errors of the second about the first's linearisation, in the body tangent
for poses and world axes for landmarks (see :func:`posterior_difference`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from slamcmp.errors import DataError
from slamcmp.geometry import heading, local, log, rotation, translation
from slamcmp.metrics.observability import last_value
from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, IntArray, Landmarks, Run

KL = "kl_from_batch"
"""Per-frame series of a run [nat]: its posterior's divergence from the batch solution's at the same frame."""

_RECORDED: dict[str, Any] = {
    "unit": "nat",
    "needs": frozenset({"diagnostics"}),
    "scope": "run",
    "lower_is_better": True,
}


@metrics.register(KL, header="KL from batch, last frame", **_RECORDED)
def last_kl(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """KL divergence of the last pose-and-map posterior from the batch solution's; 0 is the same belief."""
    return last_value(run, KL)


@metrics.register("kl_from_batch_median", header="KL from batch, median", **_RECORDED)
def median_kl(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Median over the compared frames of the KL divergence from the batch solution at the same frame."""
    values = run.diagnostics.get(KL, np.empty(0))
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else float("nan")


def kl_divergence(
    mean: FloatArray, covariance: FloatArray, other: FloatArray, reference: FloatArray
) -> float:
    """KL(N(mean, covariance) || N(other, reference)) [nat] of Gaussians in one chart.

    ½ (tr(B⁻¹A) - n - ln det(B⁻¹A) + d^T B⁻¹ d) with A the covariance and B the reference's (Kullback 1959,
    ch. 9.1). Through B's Cholesky factor: the trace and the determinant come from the same whitened matrix,
    so that equal Gaussians give zero to rounding whatever their units.

    Args:
        mean, other: (s,).
        covariance, reference: (s, s).

    Raises:
        DataError: a covariance is not positive definite.
    """
    factor, own = _factor(reference, "reference"), _factor(covariance, "covariance")
    relative = solve_triangular(factor, own, lower=True)
    offset = solve_triangular(factor, other - mean, lower=True)
    diagonal = np.diagonal(relative)
    off_diagonal = float((np.tril(relative, -1) ** 2).sum())
    # x² - 1 - ln x² summed term by term: no cancellation of a large trace against a large log-determinant.
    squares = diagonal**2
    spread = float((squares - 1.0 - np.log(squares)).sum()) + off_diagonal
    return 0.5 * (spread + float(offset @ offset))


def posterior_difference(
    T_estimate: FloatArray, estimate: Landmarks, T_reference: FloatArray, reference: Landmarks
) -> tuple[FloatArray, IntArray, IntArray]:
    """The reference's pose and map as an error of the estimate, on the landmarks that both have.

    Returns:
        the error (p + n M,): log(T_estimate^-1 T_reference) in the body tangent, then landmark differences
        in world axes; and the indices (p + n M,) of its components in the joint covariance of the estimate
        and in that of the reference.
    """
    common = sorted(set(estimate.ids.tolist()) & set(reference.ids.tolist()))
    in_estimate = {landmark: i for i, landmark in enumerate(estimate.ids.tolist())}
    in_reference = {landmark: i for i, landmark in enumerate(reference.ids.tolist())}
    mine = np.array([in_estimate[landmark] for landmark in common], dtype=np.int64)
    theirs = np.array([in_reference[landmark] for landmark in common], dtype=np.int64)
    xi = local(T_estimate, T_reference)
    moved = reference.positions[theirs] - estimate.positions[mine]
    p, n = xi.size, T_estimate.shape[0] - 1

    def states(indices: IntArray) -> IntArray:
        return np.concatenate([np.arange(p), (p + n * indices[:, None] + np.arange(n)).ravel()])

    return np.concatenate([xi, moved.ravel()]), states(mine), states(theirs)


def posterior_kl(
    T_estimate: FloatArray,
    estimate: Landmarks,
    joint: FloatArray,
    T_reference: FloatArray,
    reference: Landmarks,
    joint_reference: FloatArray,
) -> float:
    """KL divergence [nat] of an estimate's pose-and-map posterior from a reference's at the same frame.

    Landmarks that only one of them has are marginalised out. The charts of the two poses differ by the
    error itself, a second-order effect that is left out.

    Args:
        T_estimate, T_reference: (n+1, n+1).
        estimate, reference: the maps.
        joint, joint_reference: covariances of pose (body tangent) and map (world axes), in their orders.

    Raises:
        DataError: a covariance is not positive definite.
    """
    difference, mine, theirs = posterior_difference(T_estimate, estimate, T_reference, reference)
    return kl_divergence(
        np.zeros(difference.size),
        joint[np.ix_(mine, mine)],
        difference,
        joint_reference[np.ix_(theirs, theirs)],
    )


def pose_drift(T_linearised: FloatArray, T_current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far poses have moved from where their Jacobians were taken: metres (...,) and radians (...,).

    Args:
        T_linearised, T_current: (..., n+1, n+1).
    """
    shift: FloatArray = np.linalg.norm(translation(T_current) - translation(T_linearised), axis=-1)
    turn = np.swapaxes(rotation(T_linearised), -1, -2) @ rotation(T_current)
    if turn.shape[-1] == 2:
        return shift, np.abs(heading(turn))
    padded = np.zeros((*turn.shape[:-2], 4, 4))
    padded[..., :3, :3] = turn
    padded[..., 3, 3] = 1.0
    angle: FloatArray = np.linalg.norm(log(padded)[..., :3], axis=-1)
    return shift, angle


def landmark_drift(linearised: FloatArray, current: FloatArray) -> FloatArray:
    """The same for landmarks (..., n): metres (...,)."""
    distance: FloatArray = np.linalg.norm(np.asarray(current) - np.asarray(linearised), axis=-1)
    return distance


def _factor(covariance: FloatArray, name: str) -> FloatArray:
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise DataError(f"{name}: a covariance is not positive definite") from error
