"""The error-state engine: charts against differences, the standard EKF against a textbook's."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.covariances import covariance
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.error_state.linearisation import (
    FirstEstimates,
    LatestEstimate,
    ObservabilityConstrained,
)
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.variants import (
    FirstEstimatesEkf,
    IdealEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.errors import DivergedError, UsageError
from slamcmp.protocols import Smoother
from slamcmp.types import Frame, GroundTruth, Problem
from tests.oracles.filters import BodyEkf, maker, run, world_of

FILTERS = (
    WorldEkf,
    FirstEstimatesEkf,
    ObservabilityConstrainedEkf,
    IdealEkf,
    RightInvariantEkf,
    RobocentricEkf,
    BodyEkf,
)


class TextbookEkf:
    """EKF-SLAM on the vector (x, y, heading, l1x, l1y, …) with relative positions, as lectures have it."""

    def __init__(self, problem: Problem) -> None:
        T = problem.T_world_body
        self.x = geometry.se2_coordinates(T)
        self.P = rotated(self.x[2]) @ problem.P @ rotated(self.x[2]).T
        self.index: dict[int, int] = {}

    def update(self, frame: Frame) -> None:
        x, P, n = self.x, self.P, self.x.size
        if frame.k:
            dx, dy, turn = geometry.se2_coordinates(frame.T_prev_body)
            c, s = np.cos(x[2]), np.sin(x[2])
            F = np.eye(n)
            F[0, 2], F[1, 2] = -s * dx - c * dy, c * dx - s * dy
            x = x + np.concatenate([[c * dx - s * dy, s * dx + c * dy, turn], np.zeros(n - 3)])
            G = np.zeros((n, 3))
            G[:3] = rotated(x[2])
            P = F @ P @ F.T + G @ frame.Q @ G.T
        c, s = np.cos(x[2]), np.sin(x[2])
        R_wb = np.array([[c, -s], [s, c]])
        dR = np.array([[-s, -c], [c, -s]])
        seen = []
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            if landmark in self.index:
                seen.append((self.index[landmark], z, R))
                continue
            G = np.zeros((2, x.size))
            G[:, :2], G[:, 2] = np.eye(2), dR @ z
            P = np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + R_wb @ R @ R_wb.T]])
            x = np.concatenate([x, x[:2] + R_wb @ z])
            self.index[landmark] = x.size - 2
        if seen:
            H, y, R_all = np.zeros((2 * len(seen), x.size)), [], np.zeros((2 * len(seen),) * 2)
            for i, (at, z, R) in enumerate(seen):
                rows, d = slice(2 * i, 2 * i + 2), x[at : at + 2] - x[:2]
                H[rows, :2], H[rows, 2], H[rows, at : at + 2] = -R_wb.T, dR.T @ d, R_wb.T
                y.append(z - R_wb.T @ d)
                R_all[rows, rows] = R
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R_all)
            x, P = x + K @ np.concatenate(y), P - K @ H @ P
        self.x, self.P = x, P


def rotated(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_world_ekf_is_the_textbooks() -> None:
    stream, _ = world_of(2, sensor_name="relative_position")
    filter_, textbook = WorldEkf(stream.problem), TextbookEkf(stream.problem)
    for frame in stream.frames:
        filter_.update(frame)
        textbook.update(frame)
        estimate = filter_.estimate()
        np.testing.assert_allclose(
            geometry.se2_coordinates(estimate.T_world_body)[:2], textbook.x[:2], atol=1e-10
        )
        to_world = rotated(float(geometry.heading(estimate.T_world_body)))
        np.testing.assert_allclose(to_world @ estimate.P @ to_world.T, textbook.P[:3, :3], atol=1e-12)
    np.testing.assert_allclose(filter_.landmarks().positions.ravel(), textbook.x[3:], atol=1e-10)
    np.testing.assert_allclose(filter_.joint_covariance()[3:, 3:], textbook.P[3:, 3:], atol=1e-12)


@pytest.mark.parametrize("mode", ["join_first", "update_first"])
def test_engine_in_the_body_tangent_is_ekf_slam(mode: str) -> None:
    for stream, _ in (world_of(2), world_of(3)):
        fast = run(EkfSlam(stream.problem, new_landmarks=mode, error_state="body"), stream)  # type: ignore[arg-type]
        engine = run(BodyEkf(stream.problem, new_landmarks=mode), stream)
        np.testing.assert_allclose(engine.estimate().T_world_body, fast.estimate().T_world_body, atol=1e-12)
        np.testing.assert_allclose(engine.joint_covariance(), fast.joint_covariance(), atol=1e-14)
        assert engine.diagnostics() == pytest.approx(fast.diagnostics(), rel=1e-10)


@pytest.mark.parametrize("mode", ["join_first", "update_first"])
@pytest.mark.parametrize("space_dim", [2, 3])
def test_world_ekf_is_ekf_slam(space_dim: int, mode: Any) -> None:
    """After every frame: the engine in world axes, and the body tangent turned after each correction."""
    stream, _ = world_of(space_dim)
    world = WorldEkf(stream.problem, new_landmarks=mode)
    fast = EkfSlam(stream.problem, new_landmarks=mode)
    for frame in stream.frames:
        world.update(frame)
        fast.update(frame)
        np.testing.assert_allclose(world.estimate().T_world_body, fast.estimate().T_world_body, atol=1e-12)
        np.testing.assert_allclose(world.landmarks().positions, fast.landmarks().positions, atol=1e-12)
        np.testing.assert_allclose(world.joint_covariance(), fast.joint_covariance(), atol=1e-12)
        assert world.diagnostics() == pytest.approx(fast.diagnostics(), rel=1e-10, nan_ok=True)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", FILTERS)
def test_reported_blocks_are_those_of_the_joint_covariance(filter_class: Any, space_dim: int) -> None:
    stream, truth = world_of(space_dim)
    filter_ = run(maker(filter_class)(stream.problem, truth), stream)
    joint, p, n = filter_.joint_covariance(), len(stream.problem.P), space_dim
    np.testing.assert_allclose(filter_.estimate().P, joint[:p, :p], atol=1e-14)
    for i, block in enumerate(filter_.landmarks().covariances):
        at = slice(p + n * i, p + n * (i + 1))
        np.testing.assert_allclose(block, joint[at, at], atol=1e-12)
    assert np.linalg.eigvalsh(joint)[0] > 0


@pytest.mark.parametrize("filter_class", FILTERS)
def test_triangular_storage_of_large_maps_changes_nothing(
    filter_class: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, truth = world_of(3)
    small = run(maker(filter_class)(stream.problem, truth), stream)
    monkeypatch.setattr(covariance, "FULL_LIMIT", 16)
    large = run(maker(filter_class)(stream.problem, truth), stream)
    np.testing.assert_allclose(large.estimate().T_world_body, small.estimate().T_world_body, atol=1e-11)
    np.testing.assert_allclose(large.joint_covariance(), small.joint_covariance(), atol=1e-12)


@pytest.mark.parametrize("space_dim", [2, 3])
def test_small_errors_make_all_linearisations_one(space_dim: int) -> None:
    """Noise 1e-4 of the usual: the filters differ by the second order of their errors."""
    stream, truth = world_of(space_dim, noise=1e-4)
    answers = [run(maker(filter_class)(stream.problem, truth), stream).estimate() for filter_class in FILTERS]
    for answer in answers[1:]:
        np.testing.assert_allclose(answer.T_world_body, answers[0].T_world_body, atol=1e-8)
        np.testing.assert_allclose(answer.P, answers[0].P, atol=2e-3 * np.abs(answers[0].P).max())


def test_ideal_filter_names_a_landmark_that_the_truth_lacks() -> None:
    stream, truth = world_of(2)
    some = GroundTruth(truth.t, truth.T_world_body, truth.ids[1:], truth.positions[1:])
    with pytest.raises(UsageError, match="the truth has no landmark 0"):
        run(IdealEkf(stream.problem, some), stream)


def test_lost_covariance_is_reported_with_its_frame() -> None:
    stream, _ = world_of(2)
    filter_ = WorldEkf(stream.problem)
    for frame in stream.frames[:10]:
        filter_.update(frame)
    filter_._landmarks[0] = np.nan
    frame = next(frame for frame in stream.frames[10:] if 0 in [filter_._number[i] for i in frame.ids])
    with pytest.raises(DivergedError, match=f"frame {frame.k}: the innovation covariance"):
        filter_.update(frame)


LOST = "first-estimate Jacobians are far from the estimates"


@pytest.mark.parametrize(
    ("filter_class", "frames", "left_alone"),
    [(FirstEstimatesEkf, 300, "2000 km"), (ObservabilityConstrainedEkf, 210, "40 m")],
)
def test_a_filter_that_left_its_first_estimates_behind_says_so(
    filter_class: Any, frames: int, left_alone: str
) -> None:
    """Twenty times the toy world's noise: without the limit it goes ``left_alone``, the plain filter 8 m."""
    stream, truth = world_of(2, frames=frames, landmarks=30, noise=20.0)
    filter_ = filter_class(stream.problem)
    with pytest.raises(DivergedError, match=LOST) as caught:
        run(filter_, stream)
    k = int(str(caught.value).split(":")[0].removeprefix("frame "))
    position, true = filter_.estimate().T_world_body[:2, 2], truth.T_world_body[k][:2, 2]
    assert np.linalg.norm(position - true) < 20.0, left_alone
    run(WorldEkf(stream.problem), stream)


@pytest.mark.parametrize("policy_class", [FirstEstimates, ObservabilityConstrained])
@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_points_are_far_in_units_of_the_distance_to_landmarks(policy_class: Any, unit: float) -> None:
    """Five times the 5 m from which landmarks were placed; no matter in what they are told."""
    policy, T = policy_class(np.eye(3)), np.eye(3)
    seen = unit * np.array([[4.0, 3.0], [-3.0, 4.0]])
    policy.new(T, np.array([0, 1]), seen)
    off = unit * np.array([[15.0, 20.0]])
    policy.require_near(0, T, seen + 0.99 * off, (T, seen))
    with pytest.raises(DivergedError, match="frame 1: " + LOST):
        policy.require_near(1, T, seen + 1.01 * off, (T, seen))
    LatestEstimate().require_near(1, T, seen + 1.01 * off, (T, seen))


@pytest.mark.parametrize("policy_class", [FirstEstimates, ObservabilityConstrained])
@pytest.mark.parametrize("others", [0, 9])
def test_one_landmark_far_off_is_enough(policy_class: Any, others: int) -> None:
    """The error grows from one landmark on, however many beside it are in place."""
    policy, T = policy_class(np.eye(3)), np.eye(3)
    seen = np.tile([[4.0, 3.0]], (others + 1, 1))
    policy.new(T, np.arange(others + 1), seen)
    moved = seen.copy()
    moved[0] += [15.1, 20.1]
    with pytest.raises(DivergedError, match=LOST):
        policy.require_near(1, T, moved, (T, seen))


def test_pose_and_map_that_fly_apart_together_do_not_stretch_the_measure() -> None:
    """Seen from where the filter thinks it is, everything is far: the distance is that of the placing."""
    policy, T, gone = FirstEstimates(np.eye(3)), np.eye(3), np.eye(3)
    gone[:2, 2] = 1000.0
    placed = np.array([[4.0, 3.0]])
    policy.new(T, np.array([0]), placed)
    for k in range(1, 50):
        policy.require_near(k, gone, placed + 17.0, (gone, placed))
    with pytest.raises(DivergedError, match=LOST):
        policy.require_near(50, gone, placed + 30.0, (gone, placed))


def test_a_close_look_at_one_landmark_is_no_alarm() -> None:
    """Half a metre between first and present estimate is nothing where landmarks are placed from metres."""
    policy, T = FirstEstimates(np.eye(3)), np.eye(3)
    away, near = np.array([[4.0, 3.0]]), np.array([[0.1, 0.0]])
    policy.new(T, np.array([0]), away)
    policy.require_near(1, T, near + 0.5, (T, near))


class OneFrame:
    """The cost that an iterated EKF minimises in one frame, with its exact derivative at a point.

    The prior's residual is (p - p0, log(R0^T R)) in the prediction's axes.
    """

    def __init__(self, prior: WorldEkf, frame: Frame) -> None:
        self.T, self.landmarks = prior._T @ frame.T_prev_body, prior._landmarks
        prior._predict(frame, np.empty(0, dtype=np.int64))
        self.P, self.sensor = prior.joint_covariance(), prior._sensor
        self.rows = np.array([prior._number[name] for name in frame.ids.tolist()])
        self.frame = frame

    def gradient_and_information(self, T: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, n = {3: 3, 4: 6}[len(T)], landmarks.shape[1]
        relative = geometry.inverse(self.T) @ T
        J_prior = np.eye(p + landmarks.size)
        if n == 2:
            xi = geometry.se2_coordinates(relative)
            J_prior[:2, :2] = relative[:2, :2]
        else:
            xi = np.concatenate([geometry.so3_log(relative[:3, :3]), relative[:3, 3]])
            J_prior[:3, :3] = np.linalg.inv(geometry.so3_left_jacobian(-xi[:3]))
            J_prior[3:6, 3:6] = relative[:3, :3]
        r = np.concatenate([xi, (landmarks - self.landmarks).ravel()])
        information = J_prior.T @ np.linalg.solve(self.P, J_prior)
        gradient = J_prior.T @ np.linalg.solve(self.P, r)
        for row, z, R in zip(self.rows, self.frame.z, self.frame.R, strict=True):
            H_pose, H_land = self.sensor.jacobians(T, landmarks[row])
            H = np.zeros((len(z), p + landmarks.size))
            H[:, :p], H[:, p + n * row : p + n * (row + 1)] = H_pose, H_land
            y = self.sensor.residual(z, self.sensor.predict(T, landmarks[row]))
            gradient -= H.T @ np.linalg.solve(R, y)
            information += H.T @ np.linalg.solve(R, H)
        return gradient, information


@pytest.mark.parametrize("space_dim", [2, 3])
def test_iterated_ekf_stands_at_the_minimum_of_its_frames_cost(space_dim: int) -> None:
    """Gradient zero there, and P the inverse of the Gauss–Newton matrix."""
    stream, _ = world_of(space_dim, noise=3.0)
    filter_ = IteratedEkf(stream.problem, iterations=50)
    checked = 0
    for frame in stream.frames:
        if frame.k > 5 and all(name in filter_._number for name in frame.ids.tolist()):
            prior = WorldEkf(stream.problem)
            prior._T, prior._landmarks, prior._number = filter_._T, filter_._landmarks, filter_._number
            prior._P = copy.deepcopy(filter_._P)
            cost = OneFrame(prior, frame)
            filter_.update(frame)
            gradient, information = cost.gradient_and_information(filter_._T, filter_._landmarks)
            P = np.linalg.inv(information)
            # The Newton step that is left [m, rad].
            assert np.abs(P @ gradient).max() < 1e-11
            np.testing.assert_allclose(filter_.joint_covariance(), P, atol=1e-9 * np.abs(P).max())
            checked += 1
        else:
            filter_.update(frame)
    assert checked > 10


@pytest.mark.parametrize("space_dim", [2, 3])
def test_one_iteration_is_the_plain_ekf_and_more_are_not(space_dim: int) -> None:
    stream, _ = world_of(space_dim)
    plain = run(EkfSlam(stream.problem), stream)
    once = run(IteratedEkf(stream.problem, iterations=1), stream)
    np.testing.assert_allclose(once.estimate().T_world_body, plain.estimate().T_world_body, atol=1e-12)
    np.testing.assert_allclose(once.joint_covariance(), plain.joint_covariance(), atol=1e-12)
    converged = run(IteratedEkf(stream.problem, iterations=30), stream)
    assert np.abs(converged.estimate().T_world_body - plain.estimate().T_world_body).max() > 1e-4


def test_only_a_filter_that_keeps_its_history_is_a_smoother() -> None:
    stream, truth = world_of(2)
    for filter_class in FILTERS:
        assert not isinstance(maker(filter_class)(stream.problem, truth), Smoother)
        assert isinstance(maker(filter_class, smooth=True)(stream.problem, truth), Smoother)
