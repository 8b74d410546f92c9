"""Motion models: derivatives, covariances and the relations between the models."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.errors import DataError
from slamcmp.models.motion import (
    Bicycle,
    StraightThenTurn,
    Unicycle,
    WheelEncoders,
    compose_increments,
)

MODELS = {
    "unicycle": (Unicycle(), [[2.0, 0.7], [2.0, 0.0], [0.5, -3.0], [1.0, 1e-6]]),
    "straight_then_turn": (StraightThenTurn(), [[2.0, 0.7], [0.3, -1.5]]),
    "bicycle": (Bicycle(wheelbase_m=2.5), [[3.0, 0.4], [3.0, 0.0], [1.0, -0.6]]),
    "encoders": (WheelEncoders(track_width_m=0.4), [[0.3, 0.35], [0.2, 0.2], [0.1, -0.1]]),
}
CASES = [(name, np.array(u)) for name, (_, controls) in MODELS.items() for u in controls]
DT = 0.3


@pytest.mark.parametrize(("name", "u"), CASES)
def test_jacobian_equals_central_differences_of_the_right_perturbation(name, u):
    model = MODELS[name][0]
    T = model.increment(u, DT)

    def slopes(h):
        return np.stack(
            [
                g.log(g.inverse(T) @ model.increment(u + h * e, DT))
                - g.log(g.inverse(T) @ model.increment(u - h * e, DT))
                for e in np.eye(2)
            ],
            axis=-1,
        ) / (2 * h)

    numeric = (4 * slopes(1e-4) - slopes(2e-4)) / 3
    np.testing.assert_allclose(model.jacobian(u, DT), numeric, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", MODELS)
def test_batches_give_what_single_controls_give(name):
    model, controls = MODELS[name]
    u = np.array(controls)
    T, G = model.increment(u, DT), model.jacobian(u, DT)
    for i in range(len(u)):
        np.testing.assert_allclose(T[i], model.increment(u[i], DT), rtol=0, atol=1e-14)
        np.testing.assert_allclose(G[i], model.jacobian(u[i], DT), rtol=0, atol=1e-14)


def test_increments_by_hand():
    # A quarter circle of radius 2 in one second.
    quarter = Unicycle().increment(np.array([math.pi, math.pi / 2]), 1.0)
    np.testing.assert_allclose(g.se2_coordinates(quarter), [2, 2, math.pi / 2], rtol=0, atol=1e-14)
    corner = StraightThenTurn().increment(np.array([2.0, math.pi / 2]), 1.0)
    np.testing.assert_allclose(g.se2_coordinates(corner), [2, 0, math.pi / 2], rtol=0, atol=1e-14)
    spin = WheelEncoders(track_width_m=0.5).increment(np.array([-0.25, 0.25]) * math.pi)
    np.testing.assert_allclose(g.se2_coordinates(spin), [0, 0, math.pi], rtol=0, atol=1e-14)


def test_bicycle_and_encoders_drive_the_unicycles_arc():
    speed, turn, dt = 2.0, 0.4, 0.5
    arc = Unicycle().increment(np.array([speed, turn]), dt)
    steer = math.atan(turn * 2.5 / speed)
    np.testing.assert_allclose(
        Bicycle(wheelbase_m=2.5).increment(np.array([speed, steer]), dt), arc, rtol=0, atol=1e-15
    )
    wheels = np.array([speed - 0.2 * turn, speed + 0.2 * turn]) * dt
    np.testing.assert_allclose(
        WheelEncoders(track_width_m=0.4).increment(wheels, dt), arc, rtol=0, atol=1e-15
    )


def test_encoder_covariance_equals_the_unicycles_in_other_controls():
    u, dt, width = np.array([1.0, 0.3]), 0.5, 0.4
    to_wheels = dt * np.array([[1.0, -width / 2], [1.0, width / 2]])
    M = np.array([[0.04, 0.003], [0.003, 0.01]])
    by_turn_rate = Unicycle().jacobian(u, dt)
    by_wheel = WheelEncoders(track_width_m=width).jacobian(to_wheels @ u, dt)
    by_unicycle = by_turn_rate @ M @ by_turn_rate.T
    by_wheels = by_wheel @ to_wheels @ M @ to_wheels.T @ by_wheel.T
    np.testing.assert_allclose(by_wheels, by_unicycle, rtol=0, atol=1e-15)


def test_the_jacobian_carries_the_noise_as_samples_do():
    # 200 000 samples: relative error of a variance is about sqrt(2/200000) = 0.3 %; the bound is 2 %.
    u, M, dt = np.array([1.0, 0.8]), np.diag([0.01, 0.02]) ** 2, 1.0
    generator = np.random.default_rng(3)
    noisy = u + generator.standard_normal((200_000, 2)) * np.sqrt(np.diag(M))
    model = Unicycle()
    errors = g.log(g.inverse(model.increment(u, dt)) @ model.increment(noisy, dt))
    G = model.jacobian(u, dt)
    Q = G @ M @ G.T
    np.testing.assert_allclose(np.cov(errors.T), Q, rtol=0, atol=0.02 * np.abs(Q).max())


def test_composed_covariance_equals_gtsam_between_jacobians():
    generator = np.random.default_rng(9)
    for _ in range(5):
        xi1, xi2 = generator.uniform(-1, 1, (2, 3))
        T1, T2 = g.exp(xi1), g.exp(xi2)
        A = generator.standard_normal((2, 3, 3))
        Q1, Q2 = A @ np.swapaxes(A, -1, -2)
        T, Q = compose_increments((T1, Q1), (T2, Q2))
        H1, H2 = np.zeros((3, 3), order="F"), np.zeros((3, 3), order="F")
        pose = gtsam.Pose2.Expmap(xi1).compose(gtsam.Pose2.Expmap(xi2), H1, H2)
        np.testing.assert_allclose(T, pose.matrix(), rtol=0, atol=1e-14)
        np.testing.assert_allclose(Q, H1 @ Q1 @ H1.T + H2 @ Q2 @ H2.T, rtol=0, atol=1e-12)


@pytest.mark.parametrize("p", [3, 6])
def test_between_factor_is_the_local_coordinates_with_adjoint_and_right_jacobian(p):
    """d log(Z^-1 T1^-1 T2) by T1 is -J_r^-1(e) Ad(T2^-1 T1) and by T2 is J_r^-1(e)."""
    generator = np.random.default_rng(4)
    for _ in range(10):
        xi = generator.uniform(-1, 1, (3, p))
        T1, T2, Z = (g.exp(x) for x in xi)
        kind = gtsam.Pose2 if p == 3 else gtsam.Pose3
        factor_type = gtsam.BetweenFactorPose2 if p == 3 else gtsam.BetweenFactorPose3
        values = gtsam.Values()
        values.insert(0, kind.Expmap(xi[0]))
        values.insert(1, kind.Expmap(xi[1]))
        factor = factor_type(0, 1, kind.Expmap(xi[2]), gtsam.noiseModel.Unit.Create(p))
        A, b = factor.linearize(values).jacobian()
        error = g.log(g.inverse(Z) @ g.inverse(T1) @ T2)
        J_inv = np.linalg.inv(g.right_jacobian(error))
        np.testing.assert_allclose(-b, error, rtol=0, atol=1e-10)
        np.testing.assert_allclose(A[:, p:], J_inv, rtol=0, atol=1e-9)
        np.testing.assert_allclose(A[:, :p], -J_inv @ g.adjoint(g.inverse(T2) @ T1), rtol=0, atol=1e-9)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan")])
def test_lengths_must_be_positive(bad):
    with pytest.raises(DataError, match="wheelbase_m"):
        Bicycle(wheelbase_m=bad)
    with pytest.raises(DataError, match="track_width_m"):
        WheelEncoders(track_width_m=bad)
