"""The figures of what was recorded: what is drawn against its series, and reasons where there are none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
import pytest

from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.runs.kl import plot_kl_from_batch
from slamcmp.report.figures.runs.observability import median_series, observability_table, plot_observability
from slamcmp.results.store import Results
from tests.report.conftest import FRAMES, circle, make_run


@pytest.fixture(autouse=True)
def _report_style():
    with matplotlib.rc_context(style.RC):
        yield


def series(**values: float) -> dict[str, np.ndarray]:
    """Values at every tenth frame."""
    found = {}
    for name, value in values.items():
        found[name] = np.full(FRAMES, np.nan)
        found[name][9::10] = value
    return found


@pytest.fixture
def studied(tabulated: Callable[..., Results]) -> Results:
    """Three runs of three back ends: one loses the heading, one keeps all, one was asked for nothing."""
    truth = circle()
    trials = []
    for seed, factor in enumerate((1.0, 3.0, 2.0)):
        loses = series(
            nullity=2,
            spurious_turn_per_rad2=100 * factor,
            drift_landmarks_m=0.02 * factor,
            kl_from_batch=4 * factor,
        )
        keeps = series(nullity=3, spurious_turn_per_rad2=1e-24, drift_landmarks_m=1e-9, kl_from_batch=1e-12)
        runs = [
            make_run("loses", truth, seed, 1.0, diagnostics=loses),
            make_run("keeps", truth, seed, 1.0, diagnostics=keeps),
            make_run("silent", truth, seed, 1.0, diagnostics={}),
        ]
        trials.append(({}, truth, "truth", runs))
    return tabulated(trials)


def lines(axes: Any, points: int) -> list[np.ndarray]:
    return [line.get_ydata() for line in axes.lines if len(line.get_ydata()) == points]


def test_observability_draws_the_medians_of_its_series(studied: Results) -> None:
    nullity, information, drift, compass = plot_observability(studied).axes
    looks = FRAMES // 10
    # Alone on their values, so neither line stands beside its place.
    np.testing.assert_array_equal(sorted(y[0] for y in lines(nullity, looks)), [2.0, 3.0])
    np.testing.assert_allclose(sorted(y[-1] for y in lines(information, looks)), [1e-24, 200.0])
    # Distances under a millimetre stand on the axis' end.
    np.testing.assert_allclose(sorted(y[-1] for y in lines(drift, looks)), [1e-3, 0.04])
    assert [text.get_text() for text in nullity.texts] == ["2: loses", "3: keeps"]
    assert [text.get_text() for text in information.texts] == ["0: keeps"]
    # 1 / (6 deg)² = 91.2 / rad²: what a compass of 6 degrees would tell.
    named = dict(zip([t.get_text() for t in compass.get_yticklabels()], compass.get_yticks(), strict=True))
    assert named["6°"] == pytest.approx(91.19, abs=0.01)
    assert compass.get_ylim() == information.get_ylim()


def test_the_table_holds_medians_over_the_runs(studied: Results) -> None:
    table = observability_table(studied).set_index("back end")
    assert table.index.tolist() == ["loses", "keeps"]
    assert table["nullity at the end"].tolist() == ["2", "3"]
    assert table["spurious information on turns [1/rad²]"].tolist() == [200.0, 1e-24]
    assert table.loc["loses", "as a compass of σ [deg]"] == pytest.approx(np.degrees(1 / np.sqrt(200)))
    assert np.isnan(table.loc["keeps", "as a compass of σ [deg]"])
    assert table["KL from batch [nat]"].tolist() == [8.0, 1e-12]
    assert table["runs"].tolist() == [3, 3]
    studied.trials.loc[studied.trials.index[0], "nullity"] = 1.0
    assert observability_table(studied)["nullity at the end"].tolist() == ["1 or 2", "3"]


def test_equal_nullities_stand_side_by_side(studied: Results) -> None:
    frames = studied.frames
    frames.loc[frames["nullity"].notna(), "nullity"] = 3.0
    (nullity, *_) = plot_observability(studied).axes
    heights = sorted(y[0] for y in lines(nullity, FRAMES // 10))
    np.testing.assert_allclose(heights, [2.975, 3.025])
    assert [text.get_text() for text in nullity.texts] == ["3: loses, keeps"]


def test_median_series_leaves_frames_without_values_out(studied: Results) -> None:
    found = median_series(studied.frames, "loses", "kl_from_batch")
    assert found.index.tolist() == [0.5 * k for k in range(9, FRAMES, 10)]
    assert set(found) == {8.0}


def test_divergence_draws_each_run_and_leaves_the_batch_solution_out(studied: Results) -> None:
    studied.manifest["config"]["record"] = {"divergence_from": "batch"}
    figure = plot_kl_from_batch(studied)
    over_time, medians = figure.axes
    assert [y.tolist() for y in lines(over_time, FRAMES // 10)] == [[8.0] * (FRAMES // 10)]
    assert [label.get_text() for label in medians.get_yticklabels()] == ["loses"]
    dots = next(line for line in medians.lines if len(line.get_xdata()) == 3)
    assert sorted(dots.get_xdata()) == [4.0, 8.0, 12.0]
    assert "belief of batch" in figure.get_suptitle()


def test_experiments_without_a_study_say_what_is_missing(one_trial: Results) -> None:
    with pytest.raises(NotDrawable, match=r"record: \{observability: true\}"):
        plot_observability(one_trial)
    with pytest.raises(NotDrawable, match=r"record: \{divergence_from: LABEL\}"):
        plot_kl_from_batch(one_trial)


def test_a_batch_solution_that_failed_is_named(one_trial: Results) -> None:
    one_trial.manifest["config"]["record"] = {"divergence_from": "batch"}
    with pytest.raises(NotDrawable, match="'batch' kept no posterior, see its status"):
        plot_kl_from_batch(one_trial)
