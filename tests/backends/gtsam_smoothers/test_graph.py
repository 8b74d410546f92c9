"""Factors against the sensor models, and what the graph builder refuses."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.gtsam_smoothers.factors import landmark_key, observation_factors, pose_key
from slamcmp.backends.gtsam_smoothers.graph import GraphBuilder, poses_in, require_definite
from slamcmp.errors import UsageError
from slamcmp.models.sensors import RangeBearing, RelativePosition
from slamcmp.types import TANGENT_DIM, Frame
from tests.backends.graph_streams import spatial_stream, with_frame
from tests.toy_stream import toy_stream


def pose(sensor: Any, rng: np.random.Generator) -> Any:
    xi = rng.normal(size=TANGENT_DIM[sensor.space_dim])
    return gtsam.Pose2.Expmap(xi) if sensor.space_dim == 2 else gtsam.Pose3.Expmap(xi)


@pytest.mark.parametrize(
    "sensor", [RangeBearing(), RelativePosition(), RelativePosition(space_dim=3)], ids=["rb", "rp2", "rp3"]
)
@pytest.mark.parametrize("foreign", [False, True])
def test_observation_factor_is_the_whitened_residual_of_the_sensor_model(sensor: Any, foreign: bool) -> None:
    """Error and both Jacobians, full R: chi-square, gradient and Gauss-Newton Hessian agree to rounding."""
    rng = np.random.default_rng(1)
    n, d = sensor.space_dim, sensor.dim
    p = TANGENT_DIM[n]
    how = observation_factors(_Wrapped(sensor) if foreign else sensor, lambda model: model)
    for _ in range(20):
        T, point, z = pose(sensor, rng), rng.normal(size=n) * 4, rng.normal(size=d) * 2
        A = rng.normal(size=(d, d))
        R = A @ A.T + 0.1 * np.eye(d)
        frame = Frame(0, 0.0, np.eye(n + 1), np.zeros((p, p)), [7], z[None], R[None])
        (factor,) = how.factors(pose_key(0), frame)
        values = gtsam.Values()
        values.insert(pose_key(0), T)
        values.insert(landmark_key(7), how.value(point))
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factor)
        ordering = gtsam.Ordering()
        ordering.push_back(pose_key(0))
        ordering.push_back(landmark_key(7))
        hessian, gradient = graph.linearize(values).hessian(ordering)
        residual = -sensor.residual(z, sensor.predict(T.matrix(), point))
        H_pose, H_point = sensor.jacobians(T.matrix(), point)
        H = np.zeros((d, p + how.tangent))
        H[:, :p] = H_pose
        H[:, p:][:, how.position] = H_point
        information = np.linalg.inv(R)
        scale = np.abs(hessian).max()
        assert 2 * graph.error(values) == pytest.approx(residual @ information @ residual, rel=1e-11)
        np.testing.assert_allclose(hessian, H.T @ information @ H, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(gradient, -H.T @ information @ residual, rtol=1e-9, atol=1e-12 * scale)
        np.testing.assert_array_equal(how.position_of(values, landmark_key(7)), point)


class _Wrapped:
    """A sensor of a type that the graph code does not know."""

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)


def test_a_wrong_jacobian_shape_is_an_error_and_not_a_crash() -> None:
    class Broken(_Wrapped):
        def jacobians(self, T: Any, point: Any) -> Any:
            H_pose, H_point = self._sensor.jacobians(T, point)
            return H_pose[:, :2], H_point

    how = observation_factors(Broken(RangeBearing()), lambda model: model)
    frame = Frame(0, 0.0, np.eye(3), np.zeros((3, 3)), [0], [[2.0, 0.1]], [np.eye(2)])
    (factor,) = how.factors(pose_key(0), frame)
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose2())
    values.insert(landmark_key(0), np.array([2.0, 0.5]))
    with pytest.raises(UsageError, match=r"Jacobian 0 has shape \(2, 2\), not \(2, 3\)"):
        factor.linearize(values)


def test_new_landmarks_start_where_the_predicted_pose_sees_them() -> None:
    stream, _, _ = toy_stream(frames=2)
    builder = GraphBuilder(stream.problem, robust="none", robust_width=None)
    builder.extend(stream.frames[0], None)
    start = gtsam.Pose2(1.0, 2.0, 0.5)
    frame = stream.frames[1]
    _, values = builder.extend(frame, start)
    predicted = start.matrix() @ frame.T_prev_body
    np.testing.assert_allclose(values.atPose2(pose_key(1)).matrix(), predicted, atol=1e-15)
    new = [i for i in frame.ids.tolist() if i not in stream.frames[0].ids.tolist()]
    assert new
    for landmark in new:
        z = frame.z[frame.ids.tolist().index(landmark)]
        expected = stream.problem.sensor.invert(predicted, z)
        np.testing.assert_allclose(values.atPoint2(landmark_key(landmark)), expected, atol=1e-14)


def test_huge_landmark_ids_and_their_limits() -> None:
    assert gtsam.symbolIndex(landmark_key(1 << 50)) == 1 << 50
    for bad in (-1, (1 << 50) + 1):
        with pytest.raises(UsageError, match="ids from 0 to"):
            landmark_key(bad)


@pytest.mark.parametrize("n", [2, 3])
def test_poses_come_out_in_the_order_of_frames(n: int) -> None:
    rng = np.random.default_rng(0)
    kind = gtsam.Pose2 if n == 2 else gtsam.Pose3
    poses = [kind.Expmap(rng.normal(size=TANGENT_DIM[n])) for _ in range(12)]
    values = gtsam.Values()
    for k in (11, 3, 0, 10, 1, 2, 4, 9, 8, 7, 5, 6):
        values.insert(pose_key(k), poses[k])
    values.insert(landmark_key(99), kind())
    np.testing.assert_allclose(poses_in(values, 12, n), [T.matrix() for T in poses], atol=1e-15)


def test_dof_counts_rows_minus_unknowns() -> None:
    stream, _, _ = toy_stream(frames=7, landmarks=6, seen_at_once=3)
    builder = GraphBuilder(stream.problem, robust="none", robust_width=None)
    last = None
    for frame in stream.frames:
        _, values = builder.extend(frame, last)
        last = values.atPose2(pose_key(frame.k))
    # 7 frames x 3 sightings x 2 rows; prior and odometry pay for the poses; 2 unknowns a landmark.
    assert builder.goodness(10.0)["dof"] == 7 * 3 * 2 - 2 * len(builder.known)


def test_singular_noise_is_refused_with_the_reason() -> None:
    stream, _, _ = toy_stream(frames=3)
    singular = np.diag([0.01, 0.0, 0.01])
    prior = type(stream.problem)(stream.problem.T_world_body, singular, stream.problem.sensor)
    with pytest.raises(UsageError, match=r"prior covariance Problem.P is singular.*positive definite"):
        GraphBuilder(prior, robust="none", robust_width=None)
    builder = GraphBuilder(stream.problem, robust="none", robust_width=None)
    frames = with_frame(stream, 1, Q=singular)
    builder.extend(frames[0], None)
    with pytest.raises(UsageError, match=r"odometry covariance Q of frame 1 is singular"):
        builder.extend(frames[1], gtsam.Pose2())


def test_definiteness_does_not_depend_on_units() -> None:
    require_definite(np.diag([1e-12, 1e12, 1.0]), "a diagonal")
    G = np.array([[1.0, 0.0], [0.3, 0.1], [0.0, 1.0]])
    with pytest.raises(UsageError, match="rank 2 is singular"):
        require_definite(G @ G.T, "rank 2")


def test_frames_must_come_in_order() -> None:
    stream, _, _ = toy_stream(frames=3)
    builder = GraphBuilder(stream.problem, robust="none", robust_width=None)
    with pytest.raises(UsageError, match="frame 1 came where frame 0 was due"):
        builder.extend(stream.frames[1], None)


def test_a_width_needs_a_kernel() -> None:
    stream, _, _ = toy_stream(frames=3)
    with pytest.raises(UsageError, match="robust_width has no meaning"):
        GraphBuilder(stream.problem, robust="none", robust_width=1.0)


def test_spatial_cost_at_the_truth_is_the_hand_summed_chi_square() -> None:
    stream, truth, world = spatial_stream(frames=6, landmarks=5)
    builder = GraphBuilder(stream.problem, robust="none", robust_width=None)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    expected = 0.0
    for k, frame in enumerate(stream.frames):
        part, _ = builder.extend(frame, gtsam.Pose3(truth[max(k - 1, 0)]))
        graph.push_back(part)
        values.insert(pose_key(k), gtsam.Pose3(truth[k]))
        if k:
            error = geometry.local(frame.T_prev_body, geometry.inverse(truth[k - 1]) @ truth[k])
            expected += error @ np.linalg.solve(frame.Q, error)
        else:
            error = geometry.local(stream.problem.T_world_body, truth[0])
            expected += error @ np.linalg.solve(stream.problem.P, error)
        y = frame.z - stream.problem.sensor.predict(truth[k], world[frame.ids])
        expected += float(np.einsum("mi,mij,mj->", y, np.linalg.inv(frame.R), y))
    for landmark in builder.known:
        values.insert(landmark_key(landmark), gtsam.Pose3(gtsam.Rot3(), world[landmark]))
    assert 2 * graph.error(values) == pytest.approx(expected, rel=1e-11)
