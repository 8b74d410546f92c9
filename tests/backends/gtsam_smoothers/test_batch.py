"""The batch optimum on real data, goodness of fit, and what is refused as a wrong basin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.errors import DivergedError
from slamcmp.frontend.labelled import labelled
from slamcmp.geometry import adjoint_of_inverse
from slamcmp.types import MeasurementStream
from tests.backends.graph_streams import run
from tests.toy_stream import toy_stream


def victoria_stream(sensor: str, steps: int | None = None) -> MeasurementStream:
    """Every observation as recorded: no gate."""
    return labelled(victoria_park(sensor=sensor, steps=steps), 0, gate_probability=None)


@pytest.mark.parametrize(
    ("sensor", "half_chi2"),
    [("range_bearing", 3173.5), pytest.param("relative_position", 3091.97, marks=pytest.mark.slow)],
)
def test_victoria_park_optimum(sensor: str, half_chi2: float) -> None:
    """Whole log, 6969 poses, from the incremental warm start (values: FACTS P6, independent solvers)."""
    stream = victoria_stream(sensor)
    batch = run(Batch(stream.problem), stream)
    final = batch.trajectory()
    fit = batch.diagnostics()
    assert 0.5 * fit["chi2"] == pytest.approx(half_chi2, abs=0.5)
    assert fit["dof"] == 2 * 3640 - 2 * 151
    assert fit["iterations"] < 10
    assert final.T_world_body.shape == (6969, 3, 3)
    assert final.P is not None
    assert np.linalg.eigvalsh(final.P).min() > 0
    assert batch.landmarks().ids.size == 151


def test_dead_reckoning_start_ends_in_a_wrong_basin_and_says_so() -> None:
    stream = victoria_stream("range_bearing")
    batch = run(Batch(stream.problem, warm_start="dead_reckoning"), stream)
    with pytest.raises(
        DivergedError, match=r"χ²/dof is \d+\S* .*wrong basin \(start from warm_start 'isam2'\)"
    ):
        batch.trajectory()
    assert batch.diagnostics()["chi2_per_dof"] > 10


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_chi_square_per_dof_is_one_on_a_correct_model(sensor_name: str) -> None:
    """Sum over 20 seeded runs; bound: 4 standard deviations of chi-square per dof, sqrt(2 / dof)."""
    chi2 = dof = 0.0
    for seed in range(20):
        stream, _, _ = toy_stream(frames=50, sensor_name=sensor_name, seed=seed, noise=0.3)
        batch = run(Batch(stream.problem), stream)
        batch.trajectory()
        fit = batch.diagnostics()
        chi2, dof = chi2 + fit["chi2"], dof + fit["dof"]
    assert chi2 / dof == pytest.approx(1.0, abs=4 * np.sqrt(2 / dof))


def test_a_solve_cut_short_stands_if_it_is_better_than_its_start_and_says_so() -> None:
    stream, _, _ = toy_stream(frames=30)
    whole, short = (run(Batch(stream.problem, max_iterations=most), stream) for most in (100, 1))
    whole.trajectory(), short.trajectory()
    best, found = whole.diagnostics(), short.diagnostics()
    assert (best["converged"], found["converged"], found["iterations"]) == (1.0, 0.0, 1.0)
    assert best["chi2"] <= found["chi2"] < 1.01 * best["chi2"]


def test_a_solve_that_went_up_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver cut short that hands back something worse than its start."""
    stream, _, _ = toy_stream(frames=30)
    batch = run(Batch(stream.problem, optimizer="gauss_newton", max_iterations=1), stream)

    class Lost:
        def __init__(self, initial: Any) -> None:
            pass

        def optimize(self) -> Any:
            return run(Batch(stream.problem, warm_start="dead_reckoning"), stream)._chain

        def iterations(self) -> int:
            return 1

    monkeypatch.setattr(batch, "_make_optimizer", Lost)
    with pytest.raises(
        DivergedError, match=r"no convergence in 1 iterations, and χ² rose from \d+\S* to \d+"
    ):
        batch.trajectory()


def test_online_column_is_the_warm_starts_and_causal() -> None:
    """By default the online estimate is iSAM2's with the same settings, to the last bit."""
    stream, _, _ = toy_stream(frames=40)
    batch, isam2 = Batch(stream.problem), Isam2(stream.problem)
    for frame in stream.frames:
        batch.update(frame)
        isam2.update(frame)
        a, b = batch.estimate(), isam2.estimate()
        np.testing.assert_array_equal(a.T_world_body, b.T_world_body)
        np.testing.assert_array_equal(a.P, b.P)


def test_between_causal_solves_odometry_carries_the_estimate() -> None:
    stream, _, _ = toy_stream(frames=9)
    batch = Batch(stream.problem, every=4)
    batch.update(stream.frames[0])
    for frame in stream.frames[1:]:
        before = batch.estimate()
        batch.update(frame)
        now = batch.estimate().T_world_body
        carried = before.T_world_body @ frame.T_prev_body
        solved = frame.k % 4 == 0
        assert np.allclose(now, carried, rtol=0, atol=1e-14) is not solved
        A = adjoint_of_inverse(frame.T_prev_body)
        P = A @ before.P @ A.T + frame.Q
        assert np.allclose(batch.estimate().P, P, rtol=1e-12, atol=0) is not solved


def test_a_solution_is_forgotten_when_a_frame_comes() -> None:
    """landmarks() after trajectory() is the batch's; one more frame and it is solved anew."""
    stream, _, _ = toy_stream(frames=31)
    batch = Batch(stream.problem)
    for frame in stream.frames[:30]:
        batch.update(frame)
    batch.trajectory()
    first = batch.landmarks()
    batch.update(stream.frames[30])
    assert "chi2" not in batch.diagnostics()
    second = batch.landmarks()
    fresh = run(Batch(stream.problem), stream).landmarks()
    assert np.abs(first.positions - second.positions).max() > 1e-6
    np.testing.assert_allclose(second.positions, fresh.positions, rtol=0, atol=1e-12)
