"""The points of OC-EKF's Jacobians against the least squares that they are the solution of."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.filters.error_state.linearisation import ObservabilityConstrained


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("count", [0, 1, 4])
def test_the_shift_is_the_least_squares_solution(space: int, count: int) -> None:
    """min |s|² + sum |l* - l_hat|² under l* - (p + s) = l_N - p_N, as one stacked system for s."""
    rng = np.random.default_rng(count)

    def pose(position: np.ndarray) -> np.ndarray:
        T = np.eye(space + 1)
        T[:-1, -1] = position
        return T

    start = rng.normal(size=space)
    points = ObservabilityConstrained(pose(start))
    placed = rng.normal(size=(count, space))
    points.new(pose(start), np.arange(count), placed)
    seen = np.arange(count)
    null_position, null_landmarks = start, placed
    # Three frames, so that the solution of one is the next one's condition.
    for k in range(1, 4):
        p, after = rng.normal(size=(2, space))
        estimates = placed + 0.1 * rng.normal(size=(count, space))
        A = np.tile(np.eye(space), (count + 1, 1))
        b = np.concatenate([np.zeros((1, space)), estimates - null_landmarks + null_position - p]).ravel()
        shift = np.linalg.lstsq(A, b, rcond=None)[0]
        T_from, T_after = points.motion(k, pose(p), pose(after), seen, estimates)
        np.testing.assert_allclose(T_from[:-1, -1], p + shift, atol=1e-12)
        np.testing.assert_allclose(T_after[:-1, -1], after)
        null_position = null_position + after - (p + shift)
        # A known landmark is linearised where the null space has it, seen from the pose after.
        _, known = points.known(pose(after), seen, estimates)
        np.testing.assert_allclose(known - after, null_landmarks - null_position, atol=1e-12)


@pytest.mark.parametrize("shift_pose", [True, False])
def test_both_keep_the_unobservable_directions(shift_pose: bool) -> None:
    """An observation's points lie as the null space does, which the motion's points have carried there."""
    rng = np.random.default_rng(5)
    T = np.eye(4)
    points = ObservabilityConstrained(T, shift_pose=shift_pose)
    landmarks = rng.normal(size=(4, 3))
    points.new(T, np.arange(4), landmarks)
    N_position, N_landmarks = T[:-1, -1].copy(), landmarks.copy()
    for k in range(1, 6):
        before, after = np.eye(4), np.eye(4)
        before[:-1, -1], after[:-1, -1] = rng.normal(size=(2, 3))
        estimates = landmarks + 10.0 * rng.normal(size=(4, 3))
        T_from, T_to = points.motion(k, before, after, np.arange(4), estimates)
        assert np.array_equal(T_from, before) != shift_pose
        N_position += T_to[:-1, -1] - T_from[:-1, -1]
        T_at, at = points.known(after, np.arange(4), estimates)
        np.testing.assert_allclose(at - T_at[:-1, -1], N_landmarks - N_position, atol=1e-12)
