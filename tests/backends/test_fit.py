"""One rule for what cannot be right, whichever back end solved the cost."""

from __future__ import annotations

from typing import Any

import pytest
from scipy.stats import chi2

from slamcmp.backends.fit import CHANCE, largest_chi2_per_dof, require_fit
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.errors import DivergedError
from slamcmp.types import Frame, MeasurementStream
from tests.backends.graph_streams import run
from tests.toy_stream import toy_stream

SAME_COST = [
    (Batch, {}),
    (Isam2, {"relinearize_threshold": 0.0, "relinearize_skip": 1}),
    (SlidingWindow, {"window": None}),
    (SlidingWindow, {"window": 60}),
    (FixedLag, {"lag_frames": 59, "mode": "batch"}),
    (FixedLag, {"lag_frames": 100, "relinearize_threshold": 0.0, "extra_updates": 2}),
]


def told_too_small(share: float) -> MeasurementStream:
    """Sixty clean frames whose sigmas are told as that share of what they are."""
    stream, _, _ = toy_stream(frames=60)
    quiet, _, _ = toy_stream(frames=60, noise=share)
    frames = tuple(
        Frame(f.k, f.t, f.T_prev_body, q.Q, f.ids, f.z, q.R)
        for f, q in zip(stream.frames, quiet.frames, strict=True)
    )
    return MeasurementStream(quiet.problem, frames)


def test_the_limit_is_the_users_or_what_chance_reaches() -> None:
    for dof in (1, 2, 4, 10, 20):
        bound = largest_chi2_per_dof(dof, 3.0)
        assert chi2.sf(bound * dof, dof) == pytest.approx(CHANCE, rel=1e-6)
        assert bound > 3.0
    assert largest_chi2_per_dof(25, 3.0) == largest_chi2_per_dof(5000, 3.0) == 3.0
    require_fit(1e9, 0, 3.0, "isam2", "")
    with pytest.raises(DivergedError, match="isam2: χ² is not finite"):
        require_fit(float("nan"), 100, 3.0, "isam2", "")
    with pytest.raises(
        DivergedError, match=r"χ²/dof is 40, above .* with 2 degrees of freedom, 13\.8: a wrong"
    ):
        require_fit(80.0, 2, 3.0, "isam2", "")


@pytest.mark.parametrize(("back_end", "parameters"), SAME_COST)
def test_same_cost_same_chi_square_same_status(back_end: Any, parameters: dict[str, Any]) -> None:
    """Sigmas told 3 times too small are refused by every back end, 1.5 times by none."""
    stream = told_too_small(1 / 3)
    with pytest.raises(DivergedError, match="above max_chi2_per_dof 3"):
        run(back_end(stream.problem, **parameters), stream).trajectory()
    tolerant = run(back_end(stream.problem, **parameters, max_chi2_per_dof=20.0), stream)
    assert tolerant.trajectory().T_world_body.shape == (60, 3, 3)
    best = run(Batch(stream.problem, max_chi2_per_dof=20.0), stream)
    best.trajectory()
    told, batch = tolerant.diagnostics(), best.diagnostics()
    assert told["dof"] == batch["dof"]
    assert told["chi2"] == pytest.approx(batch["chi2"], rel=1e-6)
    assert told.get("converged", 1.0) == 1.0
    stream = told_too_small(1 / 1.5)
    run(back_end(stream.problem, **parameters), stream).trajectory()


@pytest.mark.parametrize("mode", ["batch", "incremental"])
def test_a_lag_that_poses_have_left_has_no_chi_square_of_the_run(mode: Any) -> None:
    """What GTSAM marginalises takes its misfit along: no number is told for one that nobody knows."""
    stream = told_too_small(1 / 3)
    for lag, judged in ((59, True), (58, False)):
        smoother = FixedLag(stream.problem, lag_frames=lag, mode=mode, max_chi2_per_dof=20.0)
        run(smoother, stream).trajectory()
        assert ("chi2" in smoother.diagnostics()) == judged


@pytest.mark.parametrize("seed", [61, 113, 148])
def test_clean_data_are_no_wrong_basin_however_few_frames(seed: int) -> None:
    """Of 150 seeds, those where χ²/dof of two or four degrees of freedom is above 3."""
    stream, _, _ = toy_stream(frames=3, landmarks=1, seen_at_once=1, seed=seed)
    batch = Batch(stream.problem, every=1)
    window, isam2 = SlidingWindow(stream.problem, window=None), Isam2(stream.problem)
    lag = FixedLag(stream.problem, lag_frames=3, mode="batch")
    largest = 0.0
    for frame in stream.frames:
        for back_end in (batch, window, isam2, lag):
            back_end.update(frame)
            back_end.trajectory()
        batch.landmarks()
        ratio = batch.diagnostics()["chi2_per_dof"]
        largest = max(largest, ratio if frame.k else 0.0)
    assert largest > 3.0
