"""Series that several metrics share are computed once, and never taken for another's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamcmp.metrics import consistency, score_run
from slamcmp.metrics.consistency import nees_series, quadratic_forms
from slamcmp.metrics.remembered import KEPT, remembered
from slamcmp.types import FloatArray, GroundTruth, Run, Trajectory


def pair(seed: int, frames: int = 20) -> tuple[Trajectory, GroundTruth]:
    random = np.random.default_rng(seed)
    t = np.arange(frames, dtype=float)
    poses = np.tile(np.eye(3), (frames, 1, 1))
    true = poses.copy()
    poses[:, :2, 2] = random.normal(size=(frames, 2))
    factors = random.normal(size=(frames, 3, 3))
    P = factors @ np.swapaxes(factors, 1, 2) + np.eye(3)
    return Trajectory(t, poses, P), GroundTruth(t, true, np.empty(0, int), np.empty((0, 2)))


def test_another_trajectory_truth_or_part_is_asked_anew() -> None:
    calls = []

    @remembered
    def series(trajectory: Trajectory, truth: GroundTruth, how: str) -> FloatArray:
        calls.append(how)
        return trajectory.t + truth.t

    one, truth = pair(0)
    other, _ = pair(1)
    first = series(one, truth, "a")
    assert series(one, truth, "a") is first
    assert not first.flags.writeable
    series(one, truth, "b")
    series(other, truth, "a")
    series(one, replace(truth), "a")
    assert calls == ["a", "b", "a", "a"]


def test_what_is_gone_is_never_taken_for_what_came_to_lie_there() -> None:
    """Objects are compared while they live: an address is given out again."""

    @remembered
    def first_pose(trajectory: Trajectory, truth: GroundTruth, how: None) -> FloatArray:
        return trajectory.T_world_body[0, :2, 2].copy()

    for seed in range(4 * KEPT):
        trajectory, truth = pair(seed)
        expected = trajectory.T_world_body[0, :2, 2].copy()
        np.testing.assert_array_equal(first_pose(trajectory, truth, None), expected)
        del trajectory, truth


def test_the_scores_of_a_run_ask_for_each_series_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def counted(errors: FloatArray, covariances: FloatArray) -> FloatArray:
        asked.append(errors.shape[-1])
        return quadratic_forms(errors, covariances)

    monkeypatch.setattr(consistency, "quadratic_forms", counted)
    trajectory, truth = pair(5)
    nothing = np.zeros(trajectory.t.size)
    run = Run("x", {}, "d", 0, trajectory.t.size, "ok", "", trajectory, nothing, nothing)
    scores = score_run(run, truth)
    # The pose's, its position's and its heading's, where there were eight.
    assert sorted(asked) == [1, 2, 3]
    assert scores["online_pose_nees"] == pytest.approx(float(np.mean(nees_series(trajectory, truth))))


def test_one_dimension_is_its_own_correlation() -> None:
    errors, variances = np.array([[2.0], [3.0], [1.0]]), np.array([[[4.0]], [[9.0]], [[0.0]]])
    np.testing.assert_array_equal(quadratic_forms(errors, variances), [1.0, 1.0, np.nan])
