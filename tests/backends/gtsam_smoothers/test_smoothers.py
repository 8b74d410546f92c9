"""What iSAM2, batch and fixed lag must have in common, and with closed forms and the Kalman filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.errors import DivergedError, UsageError
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, MeasurementStream, Problem
from tests.backends.graph_streams import odometry_only, run, spatial_stream, with_frame, without_observations
from tests.toy_stream import toy_stream


def feed(back_end: Any, frames: list[Frame]) -> None:
    for frame in frames:
        back_end.update(frame)
        back_end.estimate()
    back_end.trajectory()


EXACT = {"relinearize_threshold": 0.0, "relinearize_skip": 1}

SMOOTHERS = [
    pytest.param(Isam2, {}, id="isam2"),
    pytest.param(Isam2, {"factorization": "qr", "optimizer": "dogleg"}, id="isam2-qr-dogleg"),
    pytest.param(Batch, {}, id="batch"),
    pytest.param(Batch, {"optimizer": "gauss_newton"}, id="batch-gauss-newton"),
    pytest.param(Batch, {"optimizer": "dogleg"}, id="batch-dogleg"),
    pytest.param(Batch, {"warm_start": "dead_reckoning"}, id="batch-dead-reckoning"),
    pytest.param(Batch, {"every": 4}, id="batch-every-4"),
    pytest.param(FixedLag, {"lag_frames": 5}, id="fixed-lag"),
    pytest.param(FixedLag, {"lag_frames": 1, "factorization": "cholesky"}, id="fixed-lag-1"),
    pytest.param(FixedLag, {"lag_frames": 5, "mode": "batch"}, id="fixed-lag-batch"),
]


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize(("kind", "parameters"), SMOOTHERS)
def test_odometry_alone_is_dead_reckoning_with_its_covariance(kind: Any, parameters: Any, n: int) -> None:
    stream = without_observations((toy_stream(frames=40) if n == 2 else spatial_stream(frames=40))[0])
    poses, covariances = odometry_only(stream)
    back_end = kind(stream.problem, **parameters)
    for frame in stream.frames:
        back_end.update(frame)
        estimate = back_end.estimate()
        np.testing.assert_allclose(estimate.T_world_body, poses[frame.k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(estimate.P, covariances[frame.k], rtol=0, atol=1e-9)
    final = back_end.trajectory()
    np.testing.assert_allclose(final.T_world_body, poses, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(final.t, [frame.t for frame in stream.frames])
    if final.P is not None:
        np.testing.assert_allclose(final.P, covariances, rtol=0, atol=1e-9)
    assert back_end.landmarks().ids.size == 0


@pytest.mark.parametrize("make", [toy_stream, spatial_stream], ids=["planar", "spatial"])
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        (Isam2, {**EXACT, "extra_updates": 8}),
        (FixedLag, {"lag_frames": 1000, **EXACT, "extra_updates": 8}),
        (FixedLag, {"lag_frames": 1000, "mode": "batch"}),
        (Batch, {"optimizer": "lm"}),
        (Batch, {"optimizer": "dogleg"}),
        (Batch, {"every": 1}),
    ],
    ids=["isam2", "lag", "lag-batch", "lm", "dogleg", "every"],
)
def test_everything_converged_is_the_batch_optimum(kind: Any, parameters: Any, make: Any) -> None:
    """Lag infinity = iSAM2 = batch."""
    stream, _, _ = make(frames=30)
    best = run(Batch(stream.problem, optimizer="gauss_newton"), stream)
    other = run(kind(stream.problem, **parameters), stream)
    tolerance = 1e-7
    reference, final = best.trajectory(), other.trajectory()
    np.testing.assert_allclose(final.T_world_body, reference.T_world_body, rtol=0, atol=tolerance)
    assert reference.P is not None
    if final.P is not None:
        np.testing.assert_allclose(final.P, reference.P, rtol=0, atol=tolerance)
    expected, landmarks = best.landmarks(), other.landmarks()
    np.testing.assert_array_equal(landmarks.ids, expected.ids)
    np.testing.assert_allclose(landmarks.positions, expected.positions, rtol=0, atol=tolerance)
    np.testing.assert_allclose(landmarks.covariances, expected.covariances, rtol=0, atol=tolerance)
    if parameters.get("every") == 1:
        online = other.estimate()
        np.testing.assert_allclose(online.T_world_body, reference.T_world_body[-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(online.P, reference.P[-1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("make", [toy_stream, spatial_stream], ids=["planar", "spatial"])
@pytest.mark.parametrize("kind", [Isam2, Batch])
def test_joint_covariance_holds_the_marginals_in_the_order_of_the_map(kind: Any, make: Any) -> None:
    stream, _, _ = make(frames=15)
    back_end = run(kind(stream.problem), stream)
    final, landmarks, joint = back_end.trajectory(), back_end.landmarks(), back_end.joint_covariance()
    p, n = final.P.shape[1], landmarks.positions.shape[1]
    np.testing.assert_allclose(joint[:p, :p], final.P[-1], atol=1e-12)
    for i, block in enumerate(landmarks.covariances):
        here = slice(p + n * i, p + n * (i + 1))
        np.testing.assert_allclose(joint[here, here], block, atol=1e-12)
    assert joint.shape == (p + n * landmarks.ids.size,) * 2
    assert np.linalg.eigvalsh(joint)[0] > 0
    assert sorted(landmarks.ids.tolist()) == landmarks.ids.tolist()


@pytest.mark.parametrize("kind", [Isam2, Batch])
def test_joint_covariance_is_the_inverse_information_of_the_whole_cost(kind: Any) -> None:
    """Against dense algebra: Jacobians of every residual stacked, (J^T J)^-1, last pose and map cut out."""
    stream, _, _ = toy_stream(frames=8, landmarks=4, seen_at_once=3, sensor_name="relative_position")
    parameters = {**EXACT, "extra_updates": 8} if kind is Isam2 else {"optimizer": "gauss_newton"}
    back_end = run(kind(stream.problem, **parameters), stream)
    poses, landmarks = back_end.trajectory().T_world_body, back_end.landmarks()
    column = {int(i): 3 * len(poses) + 2 * j for j, i in enumerate(landmarks.ids)}
    size = 3 * len(poses) + 2 * landmarks.ids.size
    information = np.zeros((size, size))

    def add(blocks: list[tuple[int, np.ndarray]], covariance: np.ndarray) -> None:
        J = np.zeros((len(covariance), size))
        for start, block in blocks:
            J[:, start : start + block.shape[1]] = block
        information[:] += J.T @ np.linalg.solve(covariance, J)

    prior_error = geometry.local(stream.problem.T_world_body, poses[0])
    add([(0, np.linalg.inv(geometry.right_jacobian(prior_error)))], stream.problem.P)
    for frame in stream.frames:
        k = frame.k
        if k:
            between = geometry.inverse(poses[k - 1]) @ poses[k]
            J = np.linalg.inv(geometry.right_jacobian(geometry.local(frame.T_prev_body, between)))
            previous = -J @ geometry.adjoint(geometry.inverse(between))
            add([(3 * k - 3, previous), (3 * k, J)], frame.Q)
        for landmark, R in zip(frame.ids.tolist(), frame.R, strict=True):
            point = landmarks.positions[landmarks.ids.tolist().index(landmark)]
            H_pose, H_point = stream.problem.sensor.jacobians(poses[k], point)
            add([(3 * k, H_pose), (column[landmark], H_point)], R)
    kept = np.r_[3 * len(poses) - 3 : size]
    expected = np.linalg.inv(information)[np.ix_(kept, kept)]
    np.testing.assert_allclose(back_end.joint_covariance(), expected, rtol=0, atol=1e-10)


def linear_stream(frames: int = 40, seed: int = 0) -> MeasurementStream:
    """Heading known to 1e-7 rad and never turning: a linear problem, solved below by a Kalman filter."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-5, 5, size=(4, 2))
    Q, R = np.diag([0.02, 0.03, 1e-7]) ** 2, np.array([[0.02, 0.005], [0.005, 0.03]])
    made, position = [], np.zeros(2)
    for k in range(frames):
        if k:
            position = position + [0.5, 0.1] + rng.normal(size=2) * [0.02, 0.03]
        ids = rng.permutation(4)[:2]
        z = world[ids] - position + rng.multivariate_normal(np.zeros(2), R, size=2)
        increment = geometry.se2(0.5, 0.1, 0.0) if k else np.eye(3)
        made.append(Frame(k, k, increment, Q if k else 0 * Q, ids, z, np.broadcast_to(R, (2, 2, 2))))
    return MeasurementStream(
        Problem(np.eye(3), np.diag([0.1, 0.1, 1e-7]) ** 2, RelativePosition()), tuple(made)
    )


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        (Isam2, EXACT),
        (Batch, {}),
        (FixedLag, {"lag_frames": 3}),
        (FixedLag, {"lag_frames": 3, "mode": "batch"}),
    ],
    ids=["isam2", "batch", "fixed-lag", "fixed-lag-batch"],
)
def test_on_a_linear_problem_the_newest_marginal_is_the_kalman_filter(kind: Any, parameters: Any) -> None:
    """At every frame; positions to 1e-6 m, since the heading is only nearly known."""
    stream = linear_stream()
    back_end = kind(stream.problem, **parameters)
    x, P = np.zeros(10), np.diag([0.01, 0.01] + [1e8] * 8)
    for frame in stream.frames:
        if frame.k:
            x[:2] += frame.T_prev_body[:2, 2]
            P[:2, :2] += frame.Q[:2, :2]
        H, R = np.zeros((4, 10)), np.kron(np.eye(2), frame.R[0])
        for row, landmark in enumerate(frame.ids.tolist()):
            H[2 * row : 2 * row + 2, :2] = -np.eye(2)
            H[2 * row : 2 * row + 2, 2 + 2 * landmark : 4 + 2 * landmark] = np.eye(2)
        S = H @ P @ H.T + R
        K = np.linalg.solve(S, H @ P).T
        x = x + K @ (frame.z.ravel() - H @ x)
        P = (np.eye(10) - K @ H) @ P @ (np.eye(10) - K @ H).T + K @ R @ K.T
        back_end.update(frame)
        estimate = back_end.estimate()
        np.testing.assert_allclose(estimate.T_world_body[:2, 2], x[:2], rtol=0, atol=1e-6)
        np.testing.assert_allclose(estimate.P[:2, :2], P[:2, :2], rtol=0, atol=1e-7)
    landmarks = back_end.landmarks()
    np.testing.assert_allclose(landmarks.positions[landmarks.ids.argsort()].ravel(), x[2:], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", [Isam2, Batch, FixedLag])
def test_singular_odometry_is_a_usage_error(kind: Any) -> None:
    stream, _, _ = toy_stream(frames=4)
    back_end = kind(stream.problem)
    frames = with_frame(stream, 2, Q=np.diag([0.01, 0.0, 0.01]))
    back_end.update(frames[0])
    back_end.update(frames[1])
    with pytest.raises(UsageError, match="frame 2 is singular, and graph back ends need a positive definite"):
        back_end.update(frames[2])


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
@pytest.mark.parametrize(("kind", "parameters"), SMOOTHERS)
def test_a_measurement_that_is_not_a_number_is_divergence(
    kind: Any, parameters: Any, sensor_name: str
) -> None:
    stream, _, _ = toy_stream(frames=6, sensor_name=sensor_name)
    spoilt = stream.frames[3].z.copy()
    spoilt[1, 0] = np.nan
    back_end = kind(stream.problem, **parameters)
    with pytest.raises(DivergedError, match=r"frame [345]|not finite"):
        feed(back_end, with_frame(stream, 3, z=spoilt))


@pytest.mark.parametrize("robust", ["huber", "cauchy", "tukey"])
@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
@pytest.mark.parametrize("kind", [Isam2, Batch, FixedLag])
def test_robust_kernel_takes_an_outliers_effect(kind: Any, sensor_name: str, robust: str) -> None:
    """One sighting of a well-known landmark is put 3 m off; the kernel brings back over 80 % of the error."""
    stream, _, _ = toy_stream(frames=25, landmarks=8, sensor_name=sensor_name, seed=2)
    spoilt = stream.frames[24].z.copy()
    spoilt[0, 0] += 3.0
    clean = run(kind(stream.problem), stream).estimate().T_world_body

    def error(**parameters: Any) -> float:
        back_end = kind(stream.problem, **parameters)
        for frame in with_frame(stream, 24, z=spoilt):
            back_end.update(frame)
        return float(np.linalg.norm(back_end.estimate().T_world_body - clean))

    plain = error()
    assert plain > 0.05
    assert error(robust=robust) < 0.2 * plain


def test_isam2_with_default_thresholds_stays_near_the_optimum_and_counts_its_work() -> None:
    stream, _, _ = toy_stream(frames=60)
    isam2, batch = run(Isam2(stream.problem), stream), run(Batch(stream.problem), stream)
    work = isam2.diagnostics()
    assert work["landmarks"] == 12
    assert work["reeliminated"] >= 3
    gap = isam2.trajectory().T_world_body - batch.trajectory().T_world_body
    assert np.abs(gap).max() < 0.05
    fit, best = isam2.diagnostics(), batch.diagnostics()
    assert fit["dof"] == best["dof"] == 60 * 5 * 2 - 12 * 2
    assert best["chi2"] <= fit["chi2"] < 1.001 * best["chi2"]


def test_failure_names_frame_and_likely_cause() -> None:
    """Information 1e40 apart defeats Cholesky."""
    stream, _, _ = toy_stream(frames=4)
    frames = with_frame(stream, 2, Q=np.diag([1e-40, 1e-40, 1e-40]))
    isam2 = Isam2(stream.problem)
    with pytest.raises(DivergedError, match=r"isam2: GTSAM gave up at frame [23]: the linear system is not"):
        feed(isam2, frames)
