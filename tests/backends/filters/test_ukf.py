"""The unscented filter: exact moments where theory knows them, the Kalman filter where all is linear."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.error_state.charts import LeftInvariantChart, RightInvariantChart, WorldChart
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf
from slamcmp.backends.filters.kalman import KnownHeadingKalmanFilter
from slamcmp.backends.filters.ukf import UkfSlam
from tests.oracles.filters import run, world_of

RETRACTIONS = {
    "additive": WorldChart,
    "right_invariant": RightInvariantChart,
    "left_invariant": LeftInvariantChart,
}


@pytest.mark.parametrize("alpha", [1e-2, 0.5, 1.0])
def test_regression_of_a_square_has_the_moments_of_chi_square(alpha: float) -> None:
    """x ~ N(0, s²): x² has mean s² and variance 2 s⁴, and no linear part."""
    stream, _ = world_of(2)
    ukf = UkfSlam(stream.problem, alpha=alpha)
    mean, H, Omega = ukf._regression(lambda errors: errors**2, np.array([[0.3**2]]))
    assert mean == pytest.approx([0.3**2], rel=1e-9)
    assert Omega == pytest.approx(np.array([[2 * 0.3**4]]), rel=1e-7)
    assert np.abs(H).max() < 1e-12


@pytest.mark.parametrize("rank", [4, 2])
def test_regression_of_a_linear_map_is_the_map(rank: int) -> None:
    """H recovers the map on the states that vary, whatever their units, and nothing is left over."""
    rng = np.random.default_rng(0)
    stream, _ = world_of(2)
    ukf = UkfSlam(stream.problem, alpha=0.7, kappa=1.0)
    root = np.diag([1.0, 1e-3, 1.0, 100.0]) @ rng.normal(size=(4, rank))
    P, J = root @ root.T, rng.normal(size=(3, 4))
    mean, H, Omega = ukf._regression(lambda errors: errors @ J.T, P)
    np.testing.assert_allclose(mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(H @ root, J @ root, atol=1e-9)
    np.testing.assert_allclose(Omega, 0.0, atol=1e-9)


def test_on_a_linear_problem_the_ukf_is_the_kalman_filter() -> None:
    stream, _ = world_of(2, sensor_name="relative_position", heading_sigma=0.0, frames=30)
    linear = run(KnownHeadingKalmanFilter(stream.problem), stream)
    for retraction in RETRACTIONS:
        ukf = run(UkfSlam(stream.problem, retraction=retraction, alpha=0.5), stream)  # type: ignore[arg-type]
        np.testing.assert_allclose(
            ukf.estimate().T_world_body, linear.estimate().T_world_body, atol=1e-9, err_msg=retraction
        )
        np.testing.assert_allclose(ukf.estimate().P, linear.estimate().P, atol=1e-11)
        np.testing.assert_allclose(ukf.landmarks().positions, linear.landmarks().positions, atol=1e-9)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("retraction", sorted(RETRACTIONS))
def test_differs_from_the_ekf_of_its_chart_by_second_order_only(retraction: Any, space_dim: int) -> None:
    """Noise ten times smaller, difference a hundred times smaller."""
    gaps = []
    for noise in (0.1, 0.01):
        stream, _ = world_of(space_dim, noise=noise)
        ukf = run(UkfSlam(stream.problem, retraction=retraction), stream)
        chart = RETRACTIONS[retraction](space_dim)
        ekf = run(
            ErrorStateEkf(stream.problem, chart, LatestEstimate(), new_landmarks="join_first", smooth=False),
            stream,
        )
        gaps.append(np.abs(ukf.estimate().T_world_body - ekf.estimate().T_world_body).max())
    assert gaps[0] < 1e-4
    assert gaps[0] / gaps[1] > 50


def test_corrects_the_mean_of_a_nonlinear_landmark_where_the_ekf_cannot() -> None:
    """A direction 30 degrees unsure: its mean is shorter than one by exp(-s²/2), which the UKF sees."""
    stream, _ = world_of(2)
    ukf = UkfSlam(stream.problem, alpha=1.0)
    s = np.radians(30)
    mean, _, _ = ukf._regression(
        lambda errors: np.stack([np.cos(errors[:, 0]) - 1, np.sin(errors[:, 0])], axis=-1), np.array([[s**2]])
    )
    # Three points match the Gaussian's moments up to the fourth in part: within 2 % of the exact shrink.
    assert mean[0] + 1 == pytest.approx(np.exp(-(s**2) / 2), rel=0.02)
    assert mean[1] == pytest.approx(0.0, abs=1e-15)
