"""Hypotheses about a landmark that one measurement does not place, against closed forms and grids."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.frontend.landmark_hypotheses import Hypotheses, Measured

GATE = 15.0
BOTH: tuple[Measured, Measured] = ("range", "bearing")


def begun(measured: Measured, z: float, sigma: float, **changes: float) -> Hypotheses:
    ends = {"nearest_m": 0.5, "farthest_m": math.inf, "gate": GATE, **changes}
    return Hypotheses.begin(measured, z, sigma**2, count=36, **ends)


def measure(measured: Measured, T: np.ndarray, place: np.ndarray) -> float:
    q = g.transform(g.inverse(T), place)
    return float(np.hypot(*q) if measured == "range" else np.arctan2(q[1], q[0]))


def body_points(measured: Measured, y: np.ndarray) -> np.ndarray:
    r = y[..., 0] if measured == "range" else 1.0 / y[..., 0]
    return np.stack([r * np.cos(y[..., 1]), r * np.sin(y[..., 1])], axis=-1)


def coordinates(measured: Measured, q: np.ndarray) -> np.ndarray:
    r = np.hypot(q[..., 0], q[..., 1])
    return np.stack([r if measured == "range" else 1.0 / r, np.arctan2(q[..., 1], q[..., 0])], axis=-1)


@pytest.mark.parametrize("measured", BOTH)
def test_a_step_carries_mean_and_covariance_as_central_differences_say(measured: Measured) -> None:
    generator = np.random.default_rng(3)
    step, Q = g.exp(np.array([0.4, -0.1, 0.3])), np.diag([0.03, 0.01, 0.02]) ** 2
    tested = begun(measured, 4.0 if measured == "range" else 0.7, 0.1)
    # A correlated covariance, as it is after some steps; narrow enough not to be divided.
    A = generator.normal(size=(36, 2, 2)) * [[0.02], [0.02]] * np.diag([1.0, 1.0])[0]
    tested.P = A @ np.swapaxes(A, 1, 2) + 1e-5 * np.eye(2)
    before, P = tested.y.copy(), tested.P.copy()

    def moved(y: np.ndarray, xi: np.ndarray) -> np.ndarray:
        return coordinates(measured, g.transform(g.inverse(step @ g.exp(xi)), body_points(measured, y)))

    tested.move(step, Q)
    np.testing.assert_allclose(tested.y, moved(before, np.zeros(3)), rtol=0, atol=1e-12)
    h = 1e-6
    for i, y in enumerate(before):
        F = np.stack(
            [_slope(moved(y + d, np.zeros(3)), moved(y - d, np.zeros(3)), h) for d in h * np.eye(2)], -1
        )
        G = np.stack([_slope(moved(y, d), moved(y, -d), h) for d in h * np.eye(3)], -1)
        np.testing.assert_allclose(tested.P[i], F @ P[i] @ F.T + G @ Q @ G.T, rtol=1e-6, atol=1e-10)


def _slope(after: np.ndarray, before: np.ndarray, h: float) -> np.ndarray:
    difference = after - before
    difference[1] = g.wrap(difference[1])
    return difference / (2 * h)


@pytest.mark.parametrize("measured", BOTH)
def test_the_sum_of_gaussians_is_the_posterior_on_a_grid(measured: Measured) -> None:
    """Perfect odometry, a bent course: the one that is left has mean and covariance of a fine grid."""
    sigma = 0.15 if measured == "range" else 0.02
    place, T = np.array([1.5, 9.0]), np.eye(3)
    generator = np.random.default_rng(5)
    tested, seen, step = None, [], g.exp(np.array([0.5, 0.0, 0.15]))
    for _ in range(14):
        z = measure(measured, T, place) + sigma * generator.normal()
        seen.append((T, z))
        if tested is None:
            tested = begun(measured, z, sigma)
        else:
            tested.move(step, np.zeros((3, 3)))
            assert tested.observe(z, sigma**2)
        T = T @ step
    last = seen[-1][0]
    x, y = np.meshgrid(np.linspace(0.0, 3.0, 401), np.linspace(7.5, 10.5, 401), indexing="ij")
    grid = np.stack([x, y], axis=-1)
    log_density = np.zeros(grid.shape[:2])
    for pose, z in seen:
        q = g.transform(g.inverse(pose), grid)
        h = np.hypot(q[..., 0], q[..., 1]) if measured == "range" else np.arctan2(q[..., 1], q[..., 0])
        error = z - h
        log_density -= 0.5 * (error / sigma) ** 2
    if measured == "range":
        # The ring is even in the bearing, so the prior over the plane falls as the first range grows.
        log_density -= np.log(np.hypot(grid[..., 0], grid[..., 1]))
    else:
        log_density -= 3.0 * np.log(np.hypot(grid[..., 0], grid[..., 1]))
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    mean = np.einsum("xy,xyi->i", weight, grid)
    covariance = np.einsum("xy,xyi,xyj->ij", weight, grid - mean, grid - mean)

    winner = tested.winner()
    assert winner.probability > 0.999
    r, bearing = winner.z
    q = r * np.array([np.cos(bearing), np.sin(bearing)])
    J = last[:2, :2] @ np.array([[np.cos(bearing), -q[1]], [np.sin(bearing), q[0]]])
    own = J @ winner.R @ J.T
    scale = np.linalg.inv(np.linalg.cholesky(covariance))
    assert np.linalg.norm(scale @ (g.transform(last, q) - mean)) < 0.1
    np.testing.assert_allclose(scale @ own @ scale.T, np.eye(2), rtol=0, atol=0.12)


def test_before_one_wins_the_weights_of_both_sides_are_those_of_a_grid() -> None:
    """Ranges on a course that has bent a little: the two mirror images are not alike any more."""
    place, T, sigma = np.array([1.0, 5.0]), np.eye(3), 0.3
    generator = np.random.default_rng(2)
    tested, seen, step = None, [], g.exp(np.array([0.5, 0.0, 0.03]))
    for _ in range(8):
        z = measure("range", T, place) + sigma * generator.normal()
        seen.append((T, z))
        if tested is None:
            tested = begun("range", z, sigma)
        else:
            tested.move(step, np.zeros((3, 3)))
            tested.observe(z, sigma**2)
        T = T @ step
    x, y = np.meshgrid(np.linspace(-8, 8, 641), np.linspace(-8, 8, 641), indexing="ij")
    grid = np.stack([x, y], axis=-1)
    log_density = -np.log(np.maximum(np.hypot(x, y), 1e-3))
    for pose, z in seen:
        q = g.transform(g.inverse(pose), grid)
        log_density -= 0.5 * ((z - np.hypot(q[..., 0], q[..., 1])) / sigma) ** 2
    weight = np.exp(log_density - log_density.max())
    left = float(weight[y > 0].sum() / weight.sum())
    points = g.transform(seen[-1][0], body_points("range", tested.y))
    ours = float(tested.probabilities[points[:, 1] > 0].sum())
    assert 0.03 < left < 0.97, "the question must be open"
    assert abs(ours - left) < 0.03
    assert tested.winner().probability < 0.999


@pytest.mark.parametrize("measured", BOTH)
def test_dividing_and_merging_keep_the_sum_s_mean_and_covariance(measured: Measured) -> None:
    tested = begun(measured, 4.0 if measured == "range" else 0.7, 0.1)
    free = 0 if measured == "bearing" else 1
    wide = np.diag([0.02, 0.02])
    wide[free, free] = 0.35 if measured == "range" else 0.2
    L = np.array([[1.0, 0.0], [0.3, 1.0]]) if free == 0 else np.array([[1.0, 0.3], [0.0, 1.0]])
    P = L @ wide**2 @ L.T
    tested.y, tested.P, tested.w = np.array([[4.0, 0.7]]), P[None], np.zeros(1)
    if measured == "bearing":
        tested.y[0, 0] = 0.3
    mean = tested.y[0].copy()
    tested.move(np.eye(3), np.zeros((3, 3)))
    assert len(tested.w) > 3
    np.testing.assert_allclose(tested.probabilities.sum(), 1.0, rtol=1e-12)
    for _ in range(2):
        total = tested.probabilities @ tested.y
        apart = tested.y - total
        spread = np.einsum(
            "h,hij->ij", tested.probabilities, tested.P + apart[:, :, None] * apart[:, None, :]
        )
        np.testing.assert_allclose(total, mean, rtol=0, atol=1e-6)
        np.testing.assert_allclose(spread, P, rtol=0.02, atol=1e-5)
        # A measurement that says nothing leaves only the merging.
        tested.observe(mean[1 - free], 1e12)


@pytest.mark.parametrize("measured", BOTH)
def test_a_measurement_outside_every_gate_changes_no_place(measured: Measured) -> None:
    tested = begun(measured, 4.0 if measured == "range" else 0.7, 0.1)
    y, w = tested.y.copy(), tested.w.copy()
    assert not tested.observe(9.0 if measured == "range" else -2.0, 0.01)
    np.testing.assert_allclose(tested.y, y, rtol=0, atol=1e-15)
    np.testing.assert_allclose(tested.w, w, rtol=0, atol=1e-12)


def test_bearings_to_something_at_infinity_leave_it_there() -> None:
    tested = begun("bearing", 1.0, 0.01)
    for _ in range(40):
        tested.move(g.exp(np.array([0.2, 0.0, 0.0])), 1e-8 * np.eye(3))
        tested.observe(1.0, 1e-4)
    assert 1.0 / max(tested.y[np.argmax(tested.w), 0], 1e-9) > 50.0
    assert tested.winner().spread > 0.1


def test_right_over_a_hypothesis_nothing_breaks_and_its_bearing_is_open() -> None:
    tested = begun("range", 2.0, 0.1)
    for _ in range(8):
        tested.move(g.exp(np.array([0.5, 0.0, 0.0])), 1e-6 * np.eye(3))
    assert np.isfinite(tested.y).all()
    assert np.isfinite(tested.P).all()
    assert len(tested.w) <= 400
    assert tested.P[:, 1, 1].max() <= math.pi**2 / 3 + 1e-9
