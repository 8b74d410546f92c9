"""The dial and the attribution figure: drawn values against the tables they come from."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest

from slamcmp.metrics.consistency import average_band
from slamcmp.report.figures import style
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.runs.attribution import (
    attribution_table,
    find_stages,
    plot_attribution,
    stage_scores,
)
from slamcmp.report.figures.sweeps.dial import arrangement, plot_dial, reach
from slamcmp.results.numbers import number_text
from slamcmp.results.store import Results

BACK_ENDS = [
    {"name": "ekf_slam", "label": "EKF"},
    {"name": "iterated_ekf", "label": "IEKF"},
    *(
        {"name": "sliding_window", "label": f"{policy} {w}", "window": w, "linearisation": policy}
        for policy in ("latest", "fej", "frozen")
        for w in (5, 1, 20)
    ),
    {"name": "sliding_window", "label": "full", "window": None, "linearisation": "latest"},
]
RUNS = 7


@pytest.fixture(autouse=True)
def _report_style():
    with matplotlib.rc_context(style.RC):
        yield


@pytest.fixture
def dial(tmp_path: Any) -> Results:
    """Random scores for every back end; run 3 of ``fej 5`` failed."""
    rng = np.random.default_rng(0)
    rows = []
    for trial in range(RUNS):
        for entry in BACK_ENDS:
            failed = trial == 3 and entry["label"] == "fej 5"
            rows.append(
                {
                    "trial": trial,
                    "label": entry["label"],
                    "back_end": entry["name"],
                    "seed": 10 + trial,
                    "status": "diverged" if failed else "ok",
                    "frames": 100,
                    "completion": 0.5 if failed else 1.0,
                    "update_s": rng.uniform(0.1, 0.2),
                    "estimate_s": 0.01,
                    "online_ate": np.nan if failed else rng.uniform(0.5, 2.0),
                    "final_ate": rng.uniform(0.2, 0.5) if entry["label"] == "full" else np.nan,
                    "online_pose_nees": np.nan if failed else rng.uniform(2, 9),
                }
            )
    frames = pd.DataFrame({"trial": [0], "label": ["EKF"], "online_err_0": [0.1]})
    return Results(tmp_path, {"config": {"back_ends": BACK_ENDS}}, pd.DataFrame(rows), frames, pd.DataFrame())


def values(results: Results, label: str, column: str) -> pd.Series:
    trials = results.trials
    return trials.loc[(trials["label"] == label) & (trials["status"] == "ok"), column]


def test_arrangement_sorts_windows_and_finds_the_ends(dial: Results) -> None:
    curves, ends, full = arrangement(dial.manifest)
    assert [(curve.policy, curve.windows) for curve in curves] == [
        ("latest", (1, 5, 20)),
        ("fej", (1, 5, 20)),
        ("frozen", (1, 5, 20)),
    ]
    assert curves[1].labels == ("fej 1", "fej 5", "fej 20")
    assert (list(ends), full) == (["EKF", "IEKF"], "full")


def test_dial_draws_medians_means_and_milliseconds(dial: Results) -> None:
    error, honesty, price = plot_dial(dial).axes
    for axes, column, statistic, scale in (
        (error, "online_ate", "median", 1.0),
        (honesty, "online_pose_nees", "mean", 1.0),
    ):
        for line, policy in ((0, "latest"), (2, "fej"), (4, "frozen")):
            solid = axes.lines[line + (1 if axes is honesty else 0)]
            expected = [values(dial, f"{policy} {w}", column).agg(statistic) * scale for w in (1, 5, 20)]
            np.testing.assert_allclose(solid.get_ydata(), expected)
    cost = [((values(dial, f"latest {w}", "update_s") + 0.01) / 100 * 1e3).median() for w in (1, 5, 20)]
    np.testing.assert_allclose(price.lines[0].get_ydata(), cost)
    # The dotted lead ends at full smoothing, one place right of the longest window.
    lead = error.lines[1]
    assert lead.get_linestyle() == ":"
    assert lead.get_xdata()[1] == 3.0
    assert lead.get_ydata()[1] == pytest.approx(values(dial, "full", "online_ate").median())
    assert [text.get_text() for text in price.get_xticklabels()] == ["1", "5", "20", "∞"]


def test_dial_has_the_band_of_its_number_of_runs_and_counts_failures(dial: Results) -> None:
    error, honesty, _ = plot_dial(dial).axes
    low, high = average_band(3, RUNS)
    band = honesty.patches[0]
    assert (band.get_y(), band.get_y() + band.get_height()) == pytest.approx((low, high))
    assert [text.get_text() for text in error.texts] == ["1 failed"]


def test_dial_says_from_which_window_on_a_policy_has_arrived(dial: Results) -> None:
    """Within a tenth of full smoothing's median for this and every longer window."""
    scores = {"full": 1.0, "latest 1": 1.05, "latest 5": 1.2, "latest 20": 1.09, "fej 1": 1.1, "fej 5": 0.9}
    trials = dial.trials.assign(online_ate=dial.trials["label"].map(scores).fillna(1.5))
    curves, _, _ = arrangement(dial.manifest)
    assert reach(trials, curves, "full") == ": error within 10% of full smoothing from w = 20 (latest)"
    trials.loc[trials["label"] == "fej 20", "online_ate"] = 1.0
    assert reach(trials, curves, "full").endswith("from w = 20 (latest), w = 1 (FEJ)")
    assert reach(trials, curves[2:], "full") == ""
    figure = plot_dial(Results(dial.folder, dial.manifest, trials, dial.frames, dial.landmarks))
    assert figure.get_suptitle() == "One dial from filter to smoother" + reach(trials, curves, "full")


def test_dial_needs_windows(dial: Results) -> None:
    dial.manifest["config"]["back_ends"] = BACK_ENDS[:3]
    with pytest.raises(NotDrawable, match="two windows"):
        plot_dial(dial)


def test_attribution_takes_the_runs_that_finished_every_stage(dial: Results) -> None:
    """The chain goes through window 20 (the middle of 5 and 20, rounded up), where no run failed."""
    stages, scores, runs = stage_scores(dial)
    assert [stage.label for stage in stages] == ["EKF", "IEKF", "latest 20", "fej 20", "full", "full"]
    assert scores.shape == (RUNS, 6)
    gaps = scores[:, 0] - scores[:, -1]
    assert (np.diff(gaps) >= 0).all()
    by_seed = dial.trials.set_index(["label", "seed"])
    for run, row in zip(runs, scores, strict=True):
        assert row[0] == by_seed.loc[("EKF", int(run)), "online_ate"]
        assert row[5] == by_seed.loc[("full", int(run)), "final_ate"]


def test_attribution_stacks_sum_to_the_gap(dial: Results) -> None:
    left, right = plot_attribution(dial).axes
    _, scores, _ = stage_scores(dial)
    heights = np.array([[bar.get_height() for bar in container] for container in left.containers])
    np.testing.assert_allclose(heights.sum(axis=0), scores[:, 0] - scores[:, -1], atol=1e-12)
    np.testing.assert_allclose(left.lines[0].get_ydata(), scores[:, 0] - scores[:, -1])
    widths = [container[0].get_width() for container in right.containers]
    np.testing.assert_allclose(widths, np.median(scores[:, :-1] - scores[:, 1:], axis=0))


def test_attribution_table_holds_medians_and_the_whole_gap(dial: Results) -> None:
    table = attribution_table(dial).set_index("part")
    _, scores, _ = stage_scores(dial)
    medians = table["error removed, median [m]"]
    gap = scores[:, 0] - scores[:, -1]
    assert medians["whole gap"] == pytest.approx(np.median(gap))
    assert medians["iterate the update"] == pytest.approx(np.median(scores[:, 0] - scores[:, 1]))
    assert table.loc["whole gap", "least [m]"] == gap.min()
    assert table.loc["whole gap", "runs it helped"] == (gap > 0).sum()
    # Of seven runs, the smallest and the largest hold the median with 98.4 %, the next two with 87.5 %.
    interval = f"{number_text(gap.min())} to {number_text(gap.max())}"
    assert table.loc["whole gap", "95 % of median [m]"] == interval
    assert set(table["runs"]) == {RUNS}


def test_the_report_shows_the_parts_as_a_table_too(dial: Results) -> None:
    dial.manifest["config"]["figures"] = ["attribution"]
    (drawn,) = each_figure(dial, ["attribution"])
    assert drawn.figure is not None
    assert drawn.table is not None
    assert drawn.table["part"].tolist()[-1] == "whole gap"


def test_attribution_says_which_link_is_missing(dial: Results) -> None:
    dial.manifest["config"]["back_ends"] = [entry for entry in BACK_ENDS if entry["name"] != "iterated_ekf"]
    with pytest.raises(NotDrawable, match="iterated_ekf was not run"):
        find_stages(dial.manifest)
