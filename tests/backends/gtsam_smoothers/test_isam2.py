"""What iSAM2's parameters do to its distance from the optimum."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.gtsam_smoothers import incremental as gtsam_incremental
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.frontend.labelled import labelled
from tests.backends.graph_streams import run
from tests.toy_stream import toy_stream


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position"])
def test_smoothed_trajectory_is_within_a_thousandth_of_the_optimum_on_real_data(sensor: str) -> None:
    """The first 1000 poses of Victoria Park with GTSAM's default thresholds, by chi-square."""
    stream = labelled(victoria_park(sensor=sensor, steps=1000), 0, gate_probability=None)
    isam2, batch = run(Isam2(stream.problem), stream), run(Batch(stream.problem), stream)
    gap = isam2.trajectory().T_world_body - batch.trajectory().T_world_body
    best, found = batch.diagnostics()["chi2"], isam2.diagnostics()["chi2"]
    assert best <= found <= 1.001 * best
    assert np.abs(gap[:, :2, 2]).max() < 0.05


def test_relinearising_more_comes_nearer_to_the_optimum() -> None:
    """Median over 8 seeds of the excess χ²: never, by threshold 0.1, always."""
    settings = [
        {"relinearize_threshold": 1e9},
        {"relinearize_threshold": 0.1, "relinearize_skip": 10},
        {"relinearize_threshold": 0.0, "relinearize_skip": 1, "extra_updates": 3},
    ]
    excess = np.empty((8, 3))
    for seed in range(8):
        stream, _, _ = toy_stream(frames=60, seed=seed)
        batch = run(Batch(stream.problem, optimizer="gauss_newton"), stream)
        batch.trajectory()
        for column, parameters in enumerate(settings):
            isam2 = run(Isam2(stream.problem, **parameters), stream)
            isam2.trajectory()
            excess[seed, column] = isam2.diagnostics()["chi2"] - batch.diagnostics()["chi2"]
    never, some, always = np.median(excess, axis=0)
    assert never > some > always
    assert abs(always) < 1e-6


def test_the_final_solution_stands_still() -> None:
    """Relinearised only after the last frame: median χ² over 6 seeds, before, after, and the optimum's."""
    ratios = []
    for seed in range(6):
        stream, _, _ = toy_stream(frames=60, seed=seed, noise=3.0)
        isam2 = run(Isam2(stream.problem, relinearize_threshold=0.02, relinearize_skip=1000), stream)
        before = 2.0 * isam2._solver.graph().error(isam2._solver.values())
        isam2.trajectory()
        told = isam2.diagnostics()
        batch = run(Batch(stream.problem), stream)
        batch.trajectory()
        best = batch.diagnostics()["chi2"]
        assert told["converged"] == 1.0
        ratios.append((before / best, told["chi2"] / best))
        again = isam2.trajectory().T_world_body
        np.testing.assert_array_equal(again, isam2.trajectory().T_world_body)
    before, after = np.median(ratios, axis=0)
    assert before > 1.02
    assert after == pytest.approx(1.0, abs=1e-3)


def test_what_does_not_stand_still_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gtsam_incremental, "FINAL_UPDATES", 1)
    stream, _, _ = toy_stream(frames=60, noise=3.0)
    isam2 = run(Isam2(stream.problem, relinearize_threshold=0.0, relinearize_skip=1000), stream)
    isam2.trajectory()
    assert isam2.diagnostics()["converged"] == 0.0


def test_final_covariances_can_be_left_out() -> None:
    stream, _, _ = toy_stream(frames=10)
    assert run(Isam2(stream.problem, final_covariances=False), stream).trajectory().P is None
    assert run(Batch(stream.problem, final_covariances=False), stream).trajectory().P is None


def test_many_covariances_are_those_of_the_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other way to them, which large maps take; variables wait for relinearisation in both."""
    stream, _, _ = toy_stream(frames=47, seed=3)
    isam2 = run(Isam2(stream.problem, relinearize_threshold=0.02, relinearize_skip=7), stream)
    poses, one_by_one = isam2.trajectory(), isam2.landmarks()
    monkeypatch.setattr(gtsam_incremental, "MANY", 0)
    poses_together, together = isam2.trajectory(), isam2.landmarks()
    np.testing.assert_allclose(together.covariances, one_by_one.covariances, rtol=1e-7, atol=1e-13)
    np.testing.assert_allclose(poses_together.P, poses.P, rtol=1e-7, atol=1e-13)
