"""The filters' identities on camera streams: one pixel needs entries, and nothing else may change."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.error_state.charts import RightInvariantChart
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.filters.variants import (
    FirstEstimatesEkf,
    IdealEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.errors import DataError, DivergedError
from tests.camera_stream import Kind, camera_stream
from tests.oracles.filters import CONSISTENT, BodyEkf, maker, run
from tests.oracles.observability import textbook_nullity
from tests.oracles.test_filter_frozen_graph import FrozenGraph

KINDS: tuple[Kind, ...] = ("stereo", "mono", "rgbd")
EVERY = (
    EkfSlam,
    WorldEkf,
    FirstEstimatesEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    RobocentricEkf,
    IteratedEkf,
    UkfSlam,
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
def test_two_codes_are_one_filter(kind: Kind, new_landmarks: Any) -> None:
    """``ekf_slam`` and the engine, in both error states; the iterated EKF with one iteration."""
    stream, _ = camera_stream(kind, frames=20)
    pairs = [
        (
            EkfSlam(stream.problem, new_landmarks=new_landmarks),
            WorldEkf(stream.problem, new_landmarks=new_landmarks),
        ),
        (
            EkfSlam(stream.problem, new_landmarks=new_landmarks, error_state="body"),
            BodyEkf(stream.problem, new_landmarks=new_landmarks),
        ),
        (EkfSlam(stream.problem), IteratedEkf(stream.problem, iterations=1)),
    ]
    for one, other in pairs:
        run(one, stream)
        run(other, stream)
        np.testing.assert_allclose(
            one.estimate().T_world_body, other.estimate().T_world_body, rtol=0, atol=1e-10
        )
        np.testing.assert_allclose(one.joint_covariance(), other.joint_covariance(), rtol=0, atol=1e-10)
        np.testing.assert_allclose(one.landmarks().positions, other.landmarks().positions, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_postponing_changes_nothing(kind: Kind) -> None:
    stream, _ = camera_stream(kind, frames=20)
    plain, postponed = EkfSlam(stream.problem), EkfSlam(stream.problem, active_landmarks=15)
    run(plain, stream)
    run(postponed, stream)
    np.testing.assert_allclose(postponed.joint_covariance(), plain.joint_covariance(), rtol=0, atol=1e-11)
    np.testing.assert_allclose(postponed.landmarks().positions, plain.landmarks().positions, atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("filter_class", [BodyEkf, WorldEkf, FirstEstimatesEkf, ObservabilityConstrainedEkf])
@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
def test_filter_and_its_smoother_are_marginals_of_the_frozen_graph(
    kind: Kind, filter_class: Any, new_landmarks: Any
) -> None:
    stream, _ = camera_stream(kind, frames=8, landmarks=30, seen_at_once=6)
    total = len(run(EkfSlam(stream.problem), stream).landmarks().ids)
    filter_ = filter_class(stream.problem, new_landmarks=new_landmarks, smooth=True)
    graph = FrozenGraph(filter_, stream, total)
    x, covariance, chi2 = graph.solve()
    last = graph.p * (graph.poses - 1)
    np.testing.assert_allclose(x[last : last + 6], graph.corrections[-1], atol=1e-8)
    np.testing.assert_allclose(x[last + 6 :], graph.landmark_moves, atol=1e-7)
    P = filter_._P.dense()
    np.testing.assert_allclose(covariance[last:, last:], P, atol=1e-7 * np.abs(P).max())
    assert graph.chi2_filter == pytest.approx(chi2, rel=1e-7)
    _, errors, _ = filter_.history.smoothed_errors()
    np.testing.assert_allclose(graph.corrections + errors, x[: graph.poses * 6].reshape(-1, 6), atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("filter_class", CONSISTENT)
def test_observability_matrix_keeps_the_rigid_motions_of_the_world(kind: Kind, filter_class: Any) -> None:
    stream, truth = camera_stream(kind, frames=12, landmarks=40, noise=0.5, seen_at_once=8)
    filter_ = run(maker(filter_class, smooth=True)(stream.problem, truth), stream)
    assert textbook_nullity(filter_.history) == 6


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_the_standard_ekf_loses_the_three_rotations(kind: Kind) -> None:
    stream, _ = camera_stream(kind, frames=12, landmarks=40, noise=0.5, seen_at_once=8)
    filter_ = run(WorldEkf(stream.problem, smooth=True), stream)
    assert textbook_nullity(filter_.history) == 3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("filter_class", EVERY)
def test_a_moved_world_moves_the_answer_with_it(kind: Kind, filter_class: Any) -> None:
    stream, _ = camera_stream(kind, frames=10)
    T = geometry.exp(np.array([0.4, -1.0, 2.0, 5, -3, 1]))
    moved = replace(stream.problem, T_world_body=T @ stream.problem.T_world_body)
    here = run(filter_class(stream.problem), stream)
    there = run(filter_class(moved), stream)
    # Which sigma points stand for a covariance depends on the axes, to the order alpha².
    tolerance = 1e-6 if filter_class is UkfSlam else 1e-9
    np.testing.assert_allclose(
        there.estimate().T_world_body, T @ here.estimate().T_world_body, atol=10 * tolerance
    )
    np.testing.assert_allclose(there.estimate().P, here.estimate().P, atol=tolerance)


@pytest.mark.parametrize("kind", KINDS)
def test_unscented_filter_with_tiny_spread_is_the_ekf_of_its_chart(kind: Kind) -> None:
    """Its remainder is of second order: the gap falls with the noise, and much faster than it."""
    gaps = []
    for noise in (0.1, 0.05):
        stream, _ = camera_stream(kind, frames=8, noise=noise)
        ukf = run(UkfSlam(stream.problem, retraction="right_invariant"), stream)
        ekf = run(RightInvariantEkf(stream.problem), stream)
        assert isinstance(ukf._chart, RightInvariantChart)
        gap = geometry.local(ekf.estimate().T_world_body, ukf.estimate().T_world_body)
        sigma = np.sqrt(np.diag(ekf.estimate().P))
        gaps.append(np.abs(gap / sigma).max())
    assert gaps[0] < 0.2
    assert gaps[1] < 0.7 * gaps[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_every_filter_is_consistent_where_noise_is_small(kind: Kind) -> None:
    """Mean NEES of the last pose over 12 worlds: chi-square with 72 dof over 12, 99.9 % in [3.1, 10.1]."""
    for filter_class in (*EVERY, IdealEkf):
        nees = []
        for seed in range(12):
            stream, truth = camera_stream(kind, frames=8, landmarks=30, seed=seed, noise=0.1, seen_at_once=5)
            estimate = run(maker(filter_class)(stream.problem, truth), stream).estimate()
            error = geometry.local(estimate.T_world_body, truth.T_world_body[-1])
            nees.append(error @ np.linalg.solve(estimate.P, error))
        assert 3.1 < np.mean(nees) < 10.1, filter_class.__name__


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_gap_between_filter_and_smoother_falls_quadratically_with_the_noise(kind: Kind) -> None:
    scales = np.array([0.08, 0.04, 0.02])
    slopes = []
    for seed in range(5):
        gaps = []
        for scale in scales:
            stream, _ = camera_stream(kind, frames=12, landmarks=40, seed=seed, noise=scale, seen_at_once=8)
            ekf = run(EkfSlam(stream.problem), stream)
            batch = run(Batch(stream.problem, optimizer="gauss_newton"), stream)
            gap = ekf.estimate().T_world_body - batch.trajectory().T_world_body[-1]
            gaps.append(np.linalg.norm(gap))
        slopes.append(np.polyfit(np.log(scales), np.log(gaps), 1)[0])
    assert np.median(slopes) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("filter_class", EVERY)
def test_a_landmark_behind_the_camera_is_left_out_and_counted(filter_class: Any) -> None:
    """One landmark that was placed wrongly: from then on what is measured of it changes nothing."""
    stream, _ = camera_stream("stereo", frames=6)
    shared = set(stream.frames[0].ids) & set(stream.frames[1].ids)
    victim = int(min(shared))
    frames = list(stream.frames)
    first = frames[0]
    z = first.z.copy()
    row = first.ids.tolist().index(victim)
    # 0.1 m in front of the camera: after half a metre of travel it lies behind.
    z[row, 1] = z[row, 0] - 400.0 * 0.4 / 0.1
    frames[0] = replace(first, z=z)
    with_victim = filter_class(stream.problem)
    without = filter_class(stream.problem)
    for frame in frames[:2]:
        with_victim.update(frame)
        keep = (frame.ids != victim) if frame.k else np.ones(frame.ids.size, dtype=bool)
        without.update(replace(frame, ids=frame.ids[keep], z=frame.z[keep], R=frame.R[keep]))
    assert with_victim.diagnostics()["dropped"] == 1
    assert without.diagnostics()["dropped"] == 0
    np.testing.assert_array_equal(with_victim.estimate().T_world_body, without.estimate().T_world_body)
    np.testing.assert_array_equal(with_victim.estimate().P, without.estimate().P)


@pytest.mark.parametrize("filter_class", EVERY)
def test_a_filter_that_expects_everything_behind_it_has_diverged(filter_class: Any) -> None:
    stream, _ = camera_stream("stereo", frames=4)
    filter_ = filter_class(stream.problem)
    filter_.update(stream.frames[0])
    turned = geometry.exp(np.array([0, 0, np.pi, 0, 0, 0.0]))
    with pytest.raises(DivergedError, match="only 0 are in front of it"):
        filter_.update(replace(stream.frames[1], T_prev_body=turned))


@pytest.mark.parametrize("filter_class", EVERY)
def test_a_measurement_that_places_no_landmark_is_refused_by_name(filter_class: Any) -> None:
    stream, _ = camera_stream("stereo", frames=2)
    first = stream.frames[0]
    z = first.z.copy()
    z[3, 1] = z[3, 0] + 1.0
    with pytest.raises(DataError, match=rf"landmark {first.ids[3]} cannot be placed by its measurement"):
        filter_class(stream.problem).update(replace(first, z=z))
