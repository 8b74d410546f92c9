"""What no relative measurement can see, a filter must not claim to see; and the standard EKF does.

The standard EKF's failures are asserted as failures: they are the phenomenon this project measures.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.error_state.charts import RightInvariantChart
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.kalman import KnownHeadingKalmanFilter
from slamcmp.backends.filters.msckf import Msckf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.filters.variants import FirstEstimatesEkf, WorldEkf
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, GroundTruth, MeasurementStream, Problem
from tests.oracles.filters import CONSISTENT, PUBLISHED, BodyEkf, maker, run, world_of
from tests.oracles.observability import textbook_nullity

MODES = ["join_first", "update_first"]
EVERY = (*PUBLISHED, RobocentricEkf, BodyEkf, EkfSlam, IteratedEkf)


def standing_robot(space_dim: int) -> tuple[MeasurementStream, GroundTruth]:
    """100 looks at one new landmark from a robot that stands still and is 5 degrees unsure of its heading."""
    rng = np.random.default_rng(4)
    sensor = RelativePosition(space_dim=space_dim)
    landmark = np.array([[3.0, 1.0, -0.5][:space_dim]])
    size, p = space_dim + 1, {2: 3, 3: 6}[space_dim]
    P = np.diag([0.1, 0.1, np.radians(5)] if p == 3 else [np.radians(5)] * 3 + [0.1] * 3) ** 2
    frames = tuple(
        Frame(
            k,
            float(k),
            np.eye(size),
            np.zeros((p, p)),
            np.array([0]),
            landmark + 0.1 * rng.normal(size=(1, space_dim)),
            0.01 * np.eye(space_dim)[None],
        )
        for k in range(100)
    )
    truth = GroundTruth(np.arange(100.0), np.tile(np.eye(size), (100, 1, 1)), np.array([0]), landmark)
    return MeasurementStream(Problem(np.eye(size), P, sensor), frames), truth


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", CONSISTENT)
def test_standing_still_and_looking_teaches_nothing_about_the_pose(
    filter_class: Any, space_dim: int, mode: str
) -> None:
    stream, truth = standing_robot(space_dim)
    filter_ = run(maker(filter_class, new_landmarks=mode)(stream.problem, truth), stream)
    estimate = filter_.estimate()
    np.testing.assert_allclose(estimate.T_world_body, np.eye(space_dim + 1), atol=1e-12)
    np.testing.assert_allclose(estimate.P, stream.problem.P, atol=1e-12)


@pytest.mark.parametrize("space_dim", [2, 3])
def test_the_standard_ekf_believes_that_it_learns_its_heading_by_standing_still(space_dim: int) -> None:
    stream, _ = standing_robot(space_dim)
    before = np.sqrt(np.diag(stream.problem.P))
    turn = 2 if space_dim == 2 else slice(0, 3)
    after = np.sqrt(np.diag(run(WorldEkf(stream.problem), stream).estimate().P))
    assert np.max(after[turn] / before[turn]) < 1.0 + 1e-12
    assert np.min(after[turn] / before[turn]) < 0.995


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", CONSISTENT)
def test_where_the_world_lies_changes_no_estimate(filter_class: Any, space_dim: int, mode: str) -> None:
    first, second = gauge_pair(maker(filter_class, new_landmarks=mode), space_dim)
    np.testing.assert_allclose(first[0], second[0], atol=1e-11)
    np.testing.assert_allclose(first[1], second[1], atol=1e-11)


def test_where_the_world_lies_changes_the_standard_ekf_and_a_careless_fej() -> None:
    first, second = gauge_pair(maker(WorldEkf), 2)
    assert np.abs(first[0] - second[0]).max() > 1e-2
    careless = maker(FirstEstimatesEkf, new_landmarks="update_first", new_landmark_jacobian="updated")
    first, second = gauge_pair(careless, 2)
    assert np.abs(first[0] - second[0]).max() > 1e-4


def gauge_pair(make: Any, space_dim: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses and map, with a sharp and with a vague prior on where the world's origin is."""
    stream, truth = world_of(space_dim, frames=60)
    answers = []
    for sigma in (0.01, 0.3):
        problem = replace(stream.problem, P=sigma**2 * np.eye(len(stream.problem.P)))
        filter_ = make(problem, truth)
        poses = []
        for frame in stream.frames:
            filter_.update(frame)
            poses.append(filter_.estimate().T_world_body)
        answers.append((np.array(poses), filter_.landmarks().positions))
    return answers


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", [*CONSISTENT, RobocentricEkf])
def test_observability_matrix_keeps_the_rigid_motions_of_the_world(
    filter_class: Any, space_dim: int, mode: str
) -> None:
    stream, truth = world_of(space_dim)
    filter_ = run(maker(filter_class, new_landmarks=mode, smooth=True)(stream.problem, truth), stream)
    assert textbook_nullity(filter_.history) == {2: 3, 3: 6}[space_dim]


@pytest.mark.parametrize("space_dim", [2, 3])
def test_the_standard_ekf_loses_rotation_and_the_body_chart_everything(space_dim: int) -> None:
    stream, _ = world_of(space_dim)
    world = run(WorldEkf(stream.problem, smooth=True), stream)
    assert textbook_nullity(world.history) == space_dim
    body = run(BodyEkf(stream.problem, smooth=True), stream)
    assert textbook_nullity(body.history) == 0


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", EVERY)
def test_a_moved_world_moves_the_answer_with_it(filter_class: Any, space_dim: int) -> None:
    stream, truth = world_of(space_dim)
    assert_moved_with_the_world(maker(filter_class), stream, truth, 1e-9)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", [*EVERY, Msckf, UkfSlam])
def test_a_world_far_from_its_origin_is_like_any_other(filter_class: Any, space_dim: int) -> None:
    """A map grid's coordinates, millions of metres, of which float64 keeps nanometres."""
    stream, truth = world_of(space_dim, frames=25)
    far = np.array([450e3, 5.4e6, 0.0]) if space_dim == 2 else np.array([0.0, 0, 0, 450e3, 5.4e6, 300.0])
    for turn in (0.0, 2.5):
        T = geometry.exp(far)
        T[:2, :2] = geometry.se2(0.0, 0.0, turn)[:2, :2]
        assert_moved_with_the_world(maker(filter_class), stream, truth, 1e-6, T=T)


def test_a_far_world_moves_no_sigma_point_of_any_chart() -> None:
    stream, truth = world_of(2, frames=25)
    T = geometry.se2(450e3, 5.4e6, 0.0)
    for retraction in ("right_invariant", "left_invariant"):
        for alpha in (1e-3, 1.0):
            make = maker(UkfSlam, retraction=retraction, alpha=alpha)
            assert_moved_with_the_world(make, stream, truth, 1e-4, T=T)


def test_a_moved_world_moves_the_unscented_answer_with_it() -> None:
    """To the order alpha² only: which sigma points stand for a covariance depends on the axes."""
    stream, truth = world_of(2)
    for retraction in ("additive", "right_invariant", "left_invariant"):
        assert_moved_with_the_world(maker(UkfSlam, retraction=retraction), stream, truth, 1e-6)


def assert_moved_with_the_world(
    make: Any,
    stream: MeasurementStream,
    truth: GroundTruth,
    tolerance: float,
    *,
    T: np.ndarray | None = None,
) -> None:
    """Everything but where the world lies stays; T moves it, None: somewhere near."""
    if T is None:
        near = [7.0, -3.0, 2.0] if len(stream.problem.P) == 3 else [0.4, -1.0, 2.0, 5, -3, 1]
        T = geometry.exp(np.array(near))
    moved_truth = replace(
        truth, T_world_body=T @ truth.T_world_body, positions=geometry.transform(T, truth.positions)
    )
    moved = replace(stream.problem, T_world_body=T @ stream.problem.T_world_body)
    here = run(make(stream.problem, truth), stream)
    there = run(make(moved, moved_truth), stream)
    np.testing.assert_allclose(
        there.estimate().T_world_body, T @ here.estimate().T_world_body, atol=tolerance
    )
    np.testing.assert_allclose(there.estimate().P, here.estimate().P, atol=tolerance)
    np.testing.assert_allclose(
        there.landmarks().positions, geometry.transform(T, here.landmarks().positions), atol=tolerance
    )
    turned = T[:-1, :-1] @ here.landmarks().covariances @ T[:-1, :-1].T
    np.testing.assert_allclose(there.landmarks().covariances, turned, atol=tolerance)


@pytest.mark.parametrize("filter_class", EVERY)
def test_the_order_of_observations_and_the_names_of_landmarks_do_not_matter(filter_class: Any) -> None:
    stream, truth = world_of(2)
    rng = np.random.default_rng(1)
    names = rng.permutation(len(truth.ids)) + 100
    frames = []
    for frame in stream.frames:
        order = rng.permutation(frame.ids.size)
        frames.append(replace(frame, ids=names[frame.ids[order]], z=frame.z[order], R=frame.R[order]))
    mixed = MeasurementStream(stream.problem, tuple(frames))
    first = run(maker(filter_class)(stream.problem, truth), stream)
    second = run(maker(filter_class)(stream.problem, replace(truth, ids=names)), mixed)
    np.testing.assert_allclose(
        first.estimate().T_world_body, second.estimate().T_world_body, atol=1e-11, rtol=0
    )
    np.testing.assert_allclose(first.estimate().P, second.estimate().P, atol=1e-12, rtol=0)


@pytest.mark.parametrize("filter_class", EVERY)
def test_metres_or_centimetres_do_not_matter(filter_class: Any) -> None:
    stream, truth = world_of(2, sensor_name="relative_position")
    scale = np.array([100.0, 100.0, 1.0])

    def longer(T: np.ndarray) -> np.ndarray:
        return T * np.array([[1, 1, 100.0], [1, 1, 100.0], [1, 1, 1]])

    frames = tuple(
        replace(
            frame,
            T_prev_body=longer(frame.T_prev_body),
            Q=frame.Q * np.outer(scale, scale),
            z=100 * frame.z,
            R=1e4 * frame.R,
        )
        for frame in stream.frames
    )
    problem = replace(stream.problem, P=stream.problem.P * np.outer(scale, scale))
    big_truth = replace(truth, T_world_body=longer(truth.T_world_body), positions=100 * truth.positions)
    metres = run(maker(filter_class)(stream.problem, truth), stream).estimate()
    centimetres = run(maker(filter_class)(problem, big_truth), MeasurementStream(problem, frames)).estimate()
    tolerance = 1e-9
    np.testing.assert_allclose(longer(metres.T_world_body), centimetres.T_world_body, atol=100 * tolerance)
    np.testing.assert_allclose(metres.P, centimetres.P / np.outer(scale, scale), atol=tolerance)


def one_by_one(stream: MeasurementStream) -> MeasurementStream:
    """The same observations, each in a frame of its own that the robot spends standing still."""
    frames: list[Frame] = []
    for frame in stream.frames:
        for i in range(frame.ids.size):
            step, Q = (frame.T_prev_body, frame.Q) if i == 0 else (np.eye(3), np.zeros((3, 3)))
            one = slice(i, i + 1)
            k = len(frames)
            frames.append(Frame(k, float(k), step, Q, frame.ids[one], frame.z[one], frame.R[one]))
    return MeasurementStream(stream.problem, tuple(frames))


def test_sequential_updates_differ_from_one_stacked_update_unless_the_problem_is_linear() -> None:
    stream, _ = world_of(2)
    split = one_by_one(stream)
    stacked, sequential = (run(WorldEkf(s.problem), s).estimate().T_world_body for s in (stream, split))
    assert np.abs(stacked - sequential).max() > 1e-4
    linear, _ = world_of(2, sensor_name="relative_position", heading_sigma=1e-9)
    split = one_by_one(linear)
    answers = [run(KnownHeadingKalmanFilter(s.problem), s).estimate() for s in (linear, split)]
    np.testing.assert_allclose(answers[0].T_world_body, answers[1].T_world_body, atol=1e-11)
    np.testing.assert_allclose(answers[0].P, answers[1].P, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
def test_right_invariant_and_world_covariance_differ_by_the_lever_of_the_position(angle: float) -> None:
    """P_world = D P_ri D^T with D = [[1, J p], [0, 1]] in the order (position, heading)."""
    T = geometry.se2(4.0, -7.0, angle)
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    stream, _ = world_of(2)
    problem = Problem(T, root @ root.T, stream.problem.sensor)
    D = np.array([[1.0, 0.0, 7.0], [0.0, 1.0, 4.0], [0.0, 0.0, 1.0]])
    in_world = WorldEkf(problem)._P.dense()
    to_group = RightInvariantChart(2).from_body(T)
    in_group = to_group @ problem.P @ to_group.T
    np.testing.assert_allclose(in_world, D @ in_group @ D.T, atol=1e-12)
