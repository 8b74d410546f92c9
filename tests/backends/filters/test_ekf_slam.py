"""EKF-SLAM against textbook algebra, Gauss–Newton, and the symmetries every estimator must have."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.kalman import KnownHeadingKalmanFilter
from slamcmp.errors import DivergedError
from slamcmp.types import Frame, Landmarks, MeasurementStream, Problem
from tests.toy_stream import toy_stream


def run(stream: MeasurementStream, **parameters: object) -> EkfSlam:
    ekf = EkfSlam(stream.problem, **parameters)  # type: ignore[arg-type]
    for frame in stream.frames:
        ekf.update(frame)
    return ekf


def numerical_jacobian(function, size: int) -> np.ndarray:  # type: ignore[no-untyped-def]
    h = 1e-6
    return np.stack([(function(h * unit) - function(-h * unit)) / (2 * h) for unit in np.eye(size)], axis=-1)


class DenseEkf:
    """The textbook filter: one vector (x, y, heading, landmarks), full matrices, numerical Jacobians."""

    def __init__(self, problem: Problem) -> None:
        self.sensor = problem.sensor
        self.x = geometry.se2_coordinates(problem.T_world_body)
        turn = self.turn()
        self.P = turn @ problem.P @ turn.T
        self.ids: list[int] = []

    def turn(self) -> np.ndarray:
        """From the body axes of the pose's position to the world's."""
        turn = np.eye(self.x.size)
        turn[:2, :2] = geometry.se2(*self.x[:3])[:2, :2]
        return turn

    def update(self, frame: Frame) -> None:
        if frame.k:
            increment = frame.T_prev_body

            def moved(error: np.ndarray, noise: np.ndarray) -> np.ndarray:
                T = geometry.se2(*(self.x + error)[:3]) @ geometry.retract(increment, noise)
                return np.concatenate([geometry.se2_coordinates(T), (self.x + error)[3:]])

            none = np.zeros(self.x.size)
            F = numerical_jacobian(lambda error: moved(error, np.zeros(3)), self.x.size)
            G = numerical_jacobian(lambda noise: moved(none, noise), 3)
            self.P = F @ self.P @ F.T + G @ frame.Q @ G.T
            self.x = moved(none, np.zeros(3))
        known = len(self.ids)
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            if landmark not in self.ids:
                self.augment(landmark, z, R)
        old = [i for i, landmark in enumerate(frame.ids.tolist()) if landmark in self.ids[:known]]
        if old:
            self.correct(frame, old)

    def augment(self, landmark: int, z: np.ndarray, R: np.ndarray) -> None:
        def seen(error: np.ndarray, noise: np.ndarray) -> np.ndarray:
            return self.sensor.invert(geometry.se2(*(self.x + error)[:3]), z + noise)

        none = np.zeros(self.x.size)
        G = numerical_jacobian(lambda error: seen(error, np.zeros(2)), self.x.size)
        Gz = numerical_jacobian(lambda noise: seen(none, noise), 2)
        F = np.vstack([np.eye(self.x.size), G])
        self.P = F @ self.P @ F.T
        self.P[-2:, -2:] += Gz @ R @ Gz.T
        self.x = np.concatenate([self.x, seen(none, np.zeros(2))])
        self.ids.append(landmark)

    def correct(self, frame: Frame, rows: list[int]) -> None:
        numbers = [self.ids.index(int(frame.ids[row])) for row in rows]

        def h(error: np.ndarray) -> np.ndarray:
            x = self.x + error
            return self.sensor.predict(geometry.se2(*x[:3]), x[3:].reshape(-1, 2)[numbers])

        H = numerical_jacobian(lambda error: h(error).ravel(), self.x.size)
        y = self.sensor.residual(frame.z[rows], h(np.zeros(self.x.size))).ravel()
        R = np.zeros((y.size, y.size))
        for i, row in enumerate(rows):
            R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = frame.R[row]
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.x = self.x + K @ y
        self.P = (np.eye(self.x.size) - K @ H) @ self.P

    def body_covariance(self) -> np.ndarray:
        turn = self.turn()
        return turn.T @ self.P @ turn


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_matches_a_dense_filter_with_numerical_jacobians(sensor_name: str) -> None:
    stream, _, _ = toy_stream(frames=40, sensor_name=sensor_name, seed=3)
    ekf, dense = EkfSlam(stream.problem), DenseEkf(stream.problem)
    for frame in stream.frames:
        ekf.update(frame)
        dense.update(frame)
        # Central differences with h = 1e-6 are good to about 1e-9.
        np.testing.assert_allclose(ekf.estimate().T_world_body, geometry.se2(*dense.x[:3]), atol=1e-7)
    np.testing.assert_array_equal(ekf.landmarks().ids, dense.ids)
    np.testing.assert_allclose(ekf.landmarks().positions.ravel(), dense.x[3:], atol=1e-7)
    np.testing.assert_allclose(
        ekf.joint_covariance(), dense.body_covariance(), atol=1e-7 * np.abs(dense.P).max()
    )


def test_update_is_one_gauss_newton_step_from_the_prediction() -> None:
    """min |x - x_pred|²_P + |z - h(x)|²_R, one step, normal equations; also the covariance."""
    stream, _, _ = toy_stream(frames=30, seed=5)
    ekf = EkfSlam(stream.problem)
    for frame in stream.frames[:-1]:
        ekf.update(frame)
    frame = stream.frames[-1]
    ekf.update(Frame(frame.k, frame.t, frame.T_prev_body, frame.Q, [], np.empty((0, 2)), np.empty((0, 2, 2))))
    T, P, before = ekf.estimate().T_world_body, ekf.joint_covariance(), ekf.landmarks()
    numbers = [int(np.flatnonzero(before.ids == i)[0]) for i in frame.ids]
    H_pose, H_land = stream.problem.sensor.jacobians(T, before.positions[numbers])
    information = np.linalg.inv(P)
    gradient = np.zeros(len(P))
    y = stream.problem.sensor.residual(frame.z, stream.problem.sensor.predict(T, before.positions[numbers]))
    for i, number in enumerate(numbers):
        H = np.zeros((2, len(P)))
        H[:, :3], H[:, 3 + 2 * number : 5 + 2 * number] = H_pose[i], H_land[i]
        weight = np.linalg.inv(frame.R[i])
        information += H.T @ weight @ H
        gradient += H.T @ weight @ y[i]
    step = np.linalg.solve(information, gradient)
    ekf.update(Frame(frame.k, frame.t, np.eye(3), np.zeros((3, 3)), frame.ids, frame.z, frame.R))
    moved, turn = geometry.retract_in_world_axes(T, step[:3])
    np.testing.assert_allclose(ekf.estimate().T_world_body, moved, atol=1e-10)
    np.testing.assert_allclose(
        ekf.landmarks().positions, before.positions + step[3:].reshape(-1, 2), atol=1e-10
    )
    posterior = np.linalg.inv(information)
    posterior[:3] = turn @ posterior[:3]
    posterior[:, :3] = posterior[:, :3] @ turn.T
    np.testing.assert_allclose(ekf.joint_covariance(), posterior, atol=1e-9 * np.abs(P).max())


@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
def test_equals_the_kalman_filter_when_the_heading_is_known(new_landmarks: str) -> None:
    stream, _, _ = toy_stream(sensor_name="relative_position", heading_sigma=1e-9, seed=2)
    linear = KnownHeadingKalmanFilter(stream.problem)
    ekf = EkfSlam(stream.problem, new_landmarks=new_landmarks)  # type: ignore[arg-type]
    for frame in stream.frames:
        linear.update(frame)
        ekf.update(frame)
        np.testing.assert_allclose(ekf.estimate().T_world_body, linear.estimate().T_world_body, atol=1e-8)
        assert ekf.diagnostics()["nis"] == pytest.approx(linear.diagnostics()["nis"], rel=1e-6, nan_ok=True)
    assert_same_map(ekf.landmarks(), linear.landmarks(), atol=1e-8)
    P, P_linear = ekf.joint_covariance(), linear.joint_covariance()
    without_heading = np.delete(np.arange(len(P)), 2)
    grid = np.ix_(without_heading, without_heading)
    np.testing.assert_allclose(P[grid], P_linear[grid], atol=1e-10)


def test_joining_first_and_updating_first_differ_when_nonlinear() -> None:
    stream, _, _ = toy_stream(seed=2, noise=3.0)
    first = run(stream, new_landmarks="join_first").estimate().T_world_body
    second = run(stream, new_landmarks="update_first").estimate().T_world_body
    assert np.abs(first - second).max() > 1e-6


def assert_same_map(one: Landmarks, other: Landmarks, atol: float) -> None:
    order = [int(np.flatnonzero(other.ids == i)[0]) for i in one.ids]
    np.testing.assert_allclose(one.positions, other.positions[order], atol=atol)
    np.testing.assert_allclose(one.covariances, other.covariances[order], atol=atol)


def test_order_of_observations_does_not_matter() -> None:
    stream, _, _ = toy_stream(seed=7)
    rng = np.random.default_rng(1)
    frames = []
    for frame in stream.frames:
        order = rng.permutation(frame.ids.size)
        frames.append(
            Frame(
                frame.k,
                frame.t,
                frame.T_prev_body,
                frame.Q,
                1000 - frame.ids[order],
                frame.z[order],
                frame.R[order],
            )
        )
    shuffled = MeasurementStream(stream.problem, tuple(frames))
    one, other = run(stream), run(shuffled)
    np.testing.assert_allclose(one.estimate().T_world_body, other.estimate().T_world_body, atol=1e-11)
    np.testing.assert_allclose(one.estimate().P, other.estimate().P, atol=1e-13)
    renamed = Landmarks(
        1000 - other.landmarks().ids, other.landmarks().positions, other.landmarks().covariances
    )
    assert_same_map(one.landmarks(), renamed, atol=1e-10)


def test_moving_the_whole_world_moves_the_estimate_with_it() -> None:
    stream, _, _ = toy_stream(seed=8)
    move = geometry.se2(-30.0, 12.0, 2.2)
    moved = MeasurementStream(
        Problem(move @ stream.problem.T_world_body, stream.problem.P, stream.problem.sensor), stream.frames
    )
    here, there = run(stream), run(moved)
    np.testing.assert_allclose(there.estimate().T_world_body, move @ here.estimate().T_world_body, atol=1e-11)
    # The body tangent does not know where the world's origin is.
    np.testing.assert_allclose(there.estimate().P, here.estimate().P, atol=1e-13)
    R = move[:2, :2]
    np.testing.assert_allclose(
        there.landmarks().positions, geometry.transform(move, here.landmarks().positions), atol=1e-10
    )
    np.testing.assert_allclose(
        there.landmarks().covariances, R @ here.landmarks().covariances @ R.T, atol=1e-12
    )


def test_odometry_alone_is_dead_reckoning_with_adjoint_covariance() -> None:
    stream, _, _ = toy_stream(seed=1)
    T, P = stream.problem.T_world_body, stream.problem.P
    ekf = EkfSlam(stream.problem)
    for frame in stream.frames:
        blind = Frame(frame.k, frame.t, frame.T_prev_body, frame.Q, [], np.empty((0, 2)), np.empty((0, 2, 2)))
        ekf.update(blind)
        if frame.k:
            A = geometry.adjoint(geometry.inverse(frame.T_prev_body))
            T, P = T @ frame.T_prev_body, A @ P @ A.T + frame.Q
    np.testing.assert_allclose(ekf.estimate().T_world_body, T, atol=1e-13)
    np.testing.assert_allclose(ekf.estimate().P, P, atol=1e-14)


def test_a_large_map_gives_the_same_numbers_as_a_small_one() -> None:
    """The layout of P changes above 256 states; landmarks seen once at the start only pad it."""
    stream, _, _ = toy_stream(seed=4)
    extra = np.arange(500, 700)
    first = stream.frames[0]
    z = np.column_stack([np.linspace(1, 20, extra.size), np.linspace(-3, 3, extra.size)])
    padded = Frame(
        0,
        first.t,
        first.T_prev_body,
        first.Q,
        np.concatenate([first.ids, extra]),
        np.concatenate([first.z, z]),
        np.concatenate([first.R, np.broadcast_to(first.R[0], (extra.size, 2, 2))]),
    )
    big = run(MeasurementStream(stream.problem, (padded, *stream.frames[1:])))
    small = run(stream)
    np.testing.assert_allclose(big.estimate().T_world_body, small.estimate().T_world_body, atol=1e-11)
    np.testing.assert_allclose(big.estimate().P, small.estimate().P, atol=1e-13)


def test_a_spoilt_measurement_is_reported_as_divergence() -> None:
    stream, _, _ = toy_stream(seed=4)
    ekf = run(stream)
    frame = stream.frames[-1]
    hopeless = Frame(
        frame.k + 1, 9.9, frame.T_prev_body, frame.Q, frame.ids, frame.z, np.full_like(frame.R, np.nan)
    )
    with pytest.raises(DivergedError, match="frame 60: the innovation covariance"):
        ekf.update(hopeless)
