"""SE(2) and SE(3): group axioms, round trips, and derivatives against central differences and gtsam."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slamcmp import geometry as g

TINY_TO_LARGE = [0.0, 1e-12, 1e-8, 1e-5, 9.9e-5, 1.01e-4, 1e-3, 9.9e-3, 1.01e-2, 0.099, 0.101, 1.0, 2.5, 3.1]
"""Angles on both sides of every switch between a series and a closed form."""


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


planar = st.tuples(numbers(-50, 50), numbers(-50, 50), numbers(-3.1, 3.1)).map(np.array)


@st.composite
def spatial(draw: st.DrawFn) -> np.ndarray:
    axis = draw(arrays(float, 3, elements=numbers(-1, 1)).filter(lambda a: np.linalg.norm(a) > 1e-3))
    angle = draw(numbers(0, 3.1))
    v = draw(arrays(float, 3, elements=numbers(-50, 50)))
    return np.concatenate([angle * axis / np.linalg.norm(axis), v])


tangents = st.one_of(planar, spatial())
pairs = st.one_of(st.tuples(planar, planar, planar), st.tuples(spatial(), spatial(), spatial()))


def spatial_tangent(angle: float, seed: int = 3) -> np.ndarray:
    generator = np.random.default_rng(seed)
    axis = generator.standard_normal(3)
    return np.concatenate([angle * axis / np.linalg.norm(axis), generator.uniform(-5, 5, 3)])


def to_gtsam(T: np.ndarray) -> gtsam.Pose2 | gtsam.Pose3:
    if len(T) == 3:
        return gtsam.Pose2(T[0, 2], T[1, 2], math.atan2(T[1, 0], T[0, 0]))
    return gtsam.Pose3(T)


def ad(xi: np.ndarray) -> np.ndarray:
    """Derivative of the adjoint at the identity, by the Lie bracket of each axis: hat(xi) E - E hat(xi)."""
    generator, columns = lie_algebra(xi), []
    for axis in np.eye(len(xi)):
        bracket = generator @ lie_algebra(axis) - lie_algebra(axis) @ generator
        columns.append(coordinates(bracket))
    return np.stack(columns, axis=-1)


def lie_algebra(xi: np.ndarray) -> np.ndarray:
    """The matrix of a tangent vector: turn and velocity in homogeneous form."""
    if len(xi) == 3:
        return np.array([[0.0, -xi[2], xi[0]], [xi[2], 0.0, xi[1]], [0.0, 0.0, 0.0]])
    (a, b, c), X = xi[:3], np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = [[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]], xi[3:]
    return X


def coordinates(X: np.ndarray) -> np.ndarray:
    """The tangent vector of such a matrix."""
    if len(X) == 3:
        return np.array([X[0, 2], X[1, 2], X[1, 0]])
    return np.array([X[2, 1], X[0, 2], X[1, 0], *X[:3, 3]])


def central(function, xi: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Central differences with one Richardson step: error of order step^4."""

    def slopes(h: float) -> np.ndarray:
        eye = np.eye(len(xi)) * h
        return np.stack([(function(xi + e) - function(xi - e)) / (2 * h) for e in eye], axis=-1)

    return (4 * slopes(step) - slopes(2 * step)) / 3


@given(pairs)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_group_axioms(xis):
    A, B, C = (g.exp(xi) for xi in xis)
    identity = np.eye(len(A))
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), rtol=0, atol=1e-11)
    np.testing.assert_allclose(A @ g.inverse(A), identity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(g.inverse(A) @ A, identity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(g.inverse(A @ B), g.inverse(B) @ g.inverse(A), rtol=0, atol=1e-11)
    R = g.rotation(A)
    np.testing.assert_allclose(R @ R.T, np.eye(len(R)), rtol=0, atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-13)


@given(tangents)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_log_undoes_exp(xi):
    np.testing.assert_allclose(g.log(g.exp(xi)), xi, rtol=0, atol=1e-10)


@pytest.mark.parametrize("angle", [*TINY_TO_LARGE, math.pi - 1e-4, math.pi - 1e-7, math.pi - 1e-9])
def test_log_undoes_exp_at_small_and_at_half_turns(angle):
    xi = np.array([1.5, -2.0, angle])
    np.testing.assert_allclose(g.log(g.exp(xi)), xi, rtol=0, atol=2e-15 / max(math.pi - angle, 1e-3) + 1e-14)
    xi = spatial_tangent(angle)
    # Near half a turn the rotation vector itself loses nothing, the translation's solve is well conditioned.
    np.testing.assert_allclose(g.log(g.exp(xi)), xi, rtol=0, atol=2e-14)


def test_half_turn_keeps_the_angle_in_the_half_open_interval():
    assert g.wrap(math.pi) == math.pi
    assert g.wrap(-math.pi) == math.pi
    assert g.wrap(3 * math.pi) == pytest.approx(math.pi)
    np.testing.assert_allclose(g.wrap(np.array([7.0, -7.0])), [7 - 2 * math.pi, 2 * math.pi - 7])
    for axis in np.eye(3):
        xi = np.concatenate([math.pi * axis, np.zeros(3)])
        np.testing.assert_allclose(np.abs(g.log(g.exp(xi))), xi, rtol=0, atol=1e-14)


@given(tangents)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_exp_and_log_agree_with_gtsam(xi):
    # gtsam's planar maps divide 1 - cos by the angle: below 1e-3 they lose digits, and the series decides.
    assume(len(xi) == 6 or abs(xi[2]) > 1e-3)
    pose = gtsam.Pose2.Expmap(xi) if len(xi) == 3 else gtsam.Pose3.Expmap(xi)
    np.testing.assert_allclose(g.exp(xi), pose.matrix(), rtol=0, atol=1e-11)
    np.testing.assert_allclose(g.log(pose.matrix()), type(pose).Logmap(pose), rtol=0, atol=1e-11)


@pytest.mark.parametrize("angle", TINY_TO_LARGE)
@pytest.mark.parametrize("p", [3, 6])
def test_exp_equals_the_power_series_of_its_generator(p, angle):
    xi = np.array([3.0, -4.0, angle]) if p == 3 else spatial_tangent(angle)
    n = 2 if p == 3 else 3
    generator = np.zeros((n + 1, n + 1))
    generator[:n, :n] = [[0, -angle], [angle, 0]] if p == 3 else g.hat(xi[:3])
    generator[:n, n] = xi[:2] if p == 3 else xi[3:]
    term, series = np.eye(n + 1), np.eye(n + 1)
    for k in range(1, 60):
        term = term @ generator / k
        series = series + term
    np.testing.assert_allclose(g.exp(xi), series, rtol=0, atol=2e-14)


@given(st.one_of(st.tuples(planar, planar), st.tuples(spatial(), spatial())))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_adjoint_moves_a_perturbation_to_the_other_side(xis):
    T, xi = g.exp(xis[0]), 0.1 * xis[1] / 50
    np.testing.assert_allclose(T @ g.exp(xi) @ g.inverse(T), g.exp(g.adjoint(T) @ xi), rtol=0, atol=1e-10)
    np.testing.assert_allclose(g.adjoint(T), to_gtsam(T).AdjointMap(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("p", [3, 6])
def test_the_adjoint_is_the_exponential_of_the_lie_bracket(p, angle):
    xi = np.array([0.4, -0.7, angle]) if p == 3 else spatial_tangent(angle)
    power, series = np.eye(p), np.eye(p)
    for k in range(1, 60):
        power = power @ ad(xi) / k
        series = series + power
    np.testing.assert_allclose(g.adjoint(g.exp(xi)), series, rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", TINY_TO_LARGE)
@pytest.mark.parametrize("p", [3, 6])
def test_right_jacobian_equals_its_power_series(p, angle):
    # J_r(xi) = sum (-ad)^k / (k+1)!, which has no switch anywhere (Solà 2018, eq. 40 and Chirikjian).
    xi = np.array([3.0, -4.0, angle]) if p == 3 else spatial_tangent(angle)
    term, series = np.eye(p), np.eye(p)
    for k in range(1, 70):
        term = -term @ ad(xi) / (k + 1)
        series = series + term
    np.testing.assert_allclose(g.right_jacobian(xi), series, rtol=0, atol=2e-11)


@pytest.mark.parametrize("angle", TINY_TO_LARGE)
@pytest.mark.parametrize("p", [3, 6])
def test_jacobians_equal_central_differences(p, angle):
    xi = np.array([3.0, -4.0, angle]) if p == 3 else spatial_tangent(angle)
    T = g.exp(xi)
    right = central(lambda x: g.log(g.inverse(T) @ g.exp(x)), xi)
    left = central(lambda x: g.log(g.exp(x) @ g.inverse(T)), xi)
    np.testing.assert_allclose(g.right_jacobian(xi), right, rtol=0, atol=2e-9)
    np.testing.assert_allclose(g.right_jacobian(-xi), left, rtol=0, atol=2e-9)
    np.testing.assert_allclose(g.right_jacobian(-xi), g.adjoint(T) @ g.right_jacobian(xi), rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.05, 0.3, 1.0, 2.5])
def test_right_jacobian_agrees_with_gtsam_away_from_its_series(angle):
    xi = np.array([3.0, -4.0, angle])
    np.testing.assert_allclose(g.right_jacobian(xi), gtsam.Pose2.ExpmapDerivative(xi), rtol=0, atol=1e-10)
    xi = spatial_tangent(angle)
    np.testing.assert_allclose(g.right_jacobian(xi), gtsam.Pose3.ExpmapDerivative(xi), rtol=0, atol=1e-10)


def test_batch_axes_give_what_single_calls_give():
    generator = np.random.default_rng(5)
    for p in (3, 6):
        xi = generator.uniform(-1, 1, (2, 4, p))
        T = g.exp(xi)
        n = T.shape[-1] - 1
        points = generator.uniform(-5, 5, (2, 4, n))
        moved, J = g.retract_in_world_axes(T, xi)
        np.testing.assert_allclose(g.change_of_axes(T, moved), J, rtol=0, atol=1e-14)
        for i in range(2):
            for j in range(4):
                one = T[i, j]
                np.testing.assert_allclose(one, g.exp(xi[i, j]), rtol=0, atol=1e-14)
                np.testing.assert_allclose(g.log(T)[i, j], g.log(one), rtol=0, atol=1e-14)
                np.testing.assert_allclose(g.inverse(T)[i, j], g.inverse(one), rtol=0, atol=1e-14)
                np.testing.assert_allclose(g.adjoint(T)[i, j], g.adjoint(one), rtol=0, atol=1e-14)
                one_moved, one_J = g.retract_in_world_axes(one, xi[i, j])
                np.testing.assert_allclose(moved[i, j], one_moved, rtol=0, atol=1e-14)
                np.testing.assert_allclose(J[i, j], one_J, rtol=0, atol=1e-14)
                np.testing.assert_allclose(
                    g.right_jacobian(xi)[i, j], g.right_jacobian(xi[i, j]), rtol=0, atol=1e-14
                )
                np.testing.assert_allclose(
                    g.transform(T, points)[i, j], one[:n, :n] @ points[i, j] + one[:n, n], rtol=0, atol=1e-14
                )


@given(spatial())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_quaternions_round_trip(xi):
    R = g.so3_exp(xi[:3])
    q = g.quaternion(R)
    assert q[3] >= 0
    np.testing.assert_allclose(g.rotation_from_quaternion(q), R, rtol=0, atol=1e-14)
    np.testing.assert_allclose(g.rotation_from_quaternion(-3 * q), R, rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", np.eye(3))
def test_quaternions_of_half_turns_by_hand(axis):
    np.testing.assert_allclose(
        np.abs(g.quaternion(g.so3_exp(math.pi * axis))), [*axis, 0], rtol=0, atol=1e-15
    )


def test_coordinates_and_dead_reckoning_by_hand():
    T = g.se2(1.0, 2.0, 0.5)
    np.testing.assert_allclose(g.se2_coordinates(T), [1, 2, 0.5])
    square = np.stack([np.eye(3)] + [g.se2(1.0, 0.0, math.pi / 2)] * 4)
    path = g.dead_reckoning(np.eye(3), square)
    np.testing.assert_allclose(path[:, :2, 2], [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(g.local(T, g.retract(T, np.array([0.1, 0.2, 0.3]))), [0.1, 0.2, 0.3])


@pytest.mark.parametrize("p", [3, 6])
def test_world_axes_retraction_adds_the_position_and_turns_the_error_with_the_body(p: int) -> None:
    """Position p + R v, rotation R exp(omega); the world components R omega and R v of an error stay."""
    rng = np.random.default_rng(4)
    T, xi, error = g.exp(rng.normal(size=p)), rng.normal(size=p), rng.normal(size=p)
    moved, J = g.retract_in_world_axes(T, xi)
    n = T.shape[0] - 1
    R, R_moved = T[:n, :n], moved[:n, :n]
    v, omega = (xi[:2], xi[2:]) if p == 3 else (xi[3:], xi[:3])
    np.testing.assert_allclose(moved[:n, n], T[:n, n] + R @ v, atol=1e-14)
    rotation_only = np.concatenate([np.zeros(2), omega]) if p == 3 else np.concatenate([omega, np.zeros(3)])
    np.testing.assert_allclose(R_moved, R @ g.exp(rotation_only)[:n, :n], atol=1e-14)
    seen = J @ error
    vectors = [slice(0, 2)] if p == 3 else [slice(0, 3), slice(3, 6)]
    for part in vectors:
        np.testing.assert_allclose(R_moved @ seen[part], R @ error[part], atol=1e-14)
    if p == 3:
        assert seen[2] == error[2]
