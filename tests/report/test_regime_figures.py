"""Maps over a sweep: what each cell says is derived again from the tables by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from matplotlib.figure import Figure

import slamcmp
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.sweeps.cells import cells
from slamcmp.report.figures.sweeps.gain import frontier_table, measured_by, plot_frontier, plot_gain, unbeaten
from slamcmp.report.figures.sweeps.regimes import honesty_table, plot_honesty, plot_regimes, regime_table
from slamcmp.results.answers.recommendation import recommend
from slamcmp.results.store import Results

LABELS = ["odometry", "EKF", "EKF + RTS"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Two densities times two odometries, six short runs each."""
    return slamcmp.run(
        {
            "name": "map",
            "source": {"name": "circle", "steps": 25, "turn_deg_s": 18.0},
            "front_end": {"name": "labelled", "gate_probability": None},
            "back_ends": [
                {"name": "dead_reckoning", "label": "odometry"},
                {"name": "ekf_slam", "label": "EKF"},
                {"name": "ekf_world", "label": "EKF + RTS", "smooth": True},
            ],
            "seeds": 6,
            "sweep": {"source.in_view": [2.0, 8.0], "source.odometry_scale": [0.3, 10.0]},
        },
        folder=tmp_path_factory.mktemp("map") / "results",
        jobs=1,
        executor="serial",
    )


def texts(figure: Figure) -> list[str]:
    return [text.get_text().replace("\n", " ") for axes in figure.axes for text in axes.texts]


def test_each_cell_says_what_the_rule_says(results: Results) -> None:
    table = regime_table(results)
    assert len(table) == 4
    points = list(product([2.0, 8.0], [0.3, 10.0]))
    drawn = texts(plot_regimes(results))
    for row, (in_view, scale), text in zip(table.to_dict("records"), points, drawn, strict=True):
        assert (row["source.in_view"], row["source.odometry_scale"]) == (in_view, scale)
        found = recommend(results, point={"source.in_view": in_view, "source.odometry_scale": scale})
        assert row["verdict"] == found.verdict
        assert row["take"] == (found.label or "–")
        assert (found.label or found.best or "") in text
        assert ("(?)" in text) == (found.verdict == "not enough runs to say" and found.label is not None)


def test_a_cross_is_drawn_where_nees_says_overconfident_and_nowhere_else(results: Results) -> None:
    trials = results.trials.copy()
    bad = (
        (trials["label"] == "EKF")
        & (trials["source.in_view"] == 2.0)
        & (trials["source.odometry_scale"] == 0.3)
    )
    trials.loc[bad, "online_pose_nees"] = np.linspace(30, 31, bad.sum())
    spoilt = replace(results, trials=trials)
    table = honesty_table(spoilt).set_index(["back end", "source.in_view", "source.odometry_scale"])
    assert table.loc[("EKF", 2.0, 0.3), "online"] == "overconfident"
    # A row a back end and density, a column an odometry.
    crosses = np.array(texts(plot_honesty(spoilt))).reshape(2, 2, 3)
    for (i, view), (j, scale), (b, label) in product(
        enumerate([2.0, 8.0]), enumerate([0.3, 10.0]), enumerate(LABELS)
    ):
        assert (crosses[i, j, b] == "×") == (table.loc[(label, view, scale), "online"] == "overconfident")


def test_failed_runs_are_counted_in_their_cell(results: Results) -> None:
    trials = results.trials.copy()
    bad = (trials["label"] == "EKF") & (trials["source.in_view"] == 8.0) & (trials["seed"] < 3)
    trials.loc[bad, "status"] = "diverged"
    drawn = texts(plot_honesty(replace(results, trials=trials)))
    assert drawn.count("50 %") == 2
    assert all(text in ("", "×", "50 %") for text in drawn)


def test_the_gain_is_the_geometric_mean_of_paired_ratios(results: Results) -> None:
    assert measured_by(results) == "EKF"
    figure = plot_gain(results)
    panel = figure.axes[1]
    assert panel.get_title() == "in view = 8"
    rows = results.trials[results.trials["source.in_view"] == 8.0]
    expected = {}
    for which in ("online", "final"):
        ratios = []
        for scale in (0.3, 10.0):
            here = rows[rows["source.odometry_scale"] == scale].set_index("trial")
            ours = here[here["label"] == "EKF + RTS"][f"{which}_ate"]
            ratios.append(np.exp(np.log(ours / here[here["label"] == "EKF"]["online_ate"]).mean()))
        expected[which] = ratios
    # The line at 1 is drawn as well; the EKF's own online ratio and what the odometry alone does are not.
    lines = [np.asarray(line.get_ydata(), dtype=float) for line in panel.lines if len(line.get_xdata()) == 2]
    curves = [line for line in lines if not np.array_equal(line, [1.0, 1.0])]
    np.testing.assert_allclose(sorted(curves, key=lambda y: y[0]), sorted(expected.values()), rtol=1e-9)
    assert expected["online"] == pytest.approx([1.0, 1.0], rel=1e-6)
    assert max(expected["final"]) < 1.0


def test_bits_are_differences_of_scores_and_entropies(results: Results) -> None:
    table = frontier_table(results).set_index(["back end", "source.in_view", "source.odometry_scale"])
    assert set(table.index.get_level_values(0)) == {"EKF", "EKF + RTS"}
    here = results.trials[
        (results.trials["source.in_view"] == 2.0) & (results.trials["source.odometry_scale"] == 10.0)
    ].set_index("trial")
    ekf, odometry = (here[here["label"] == label] for label in ("EKF", "odometry"))
    row = table.loc[("EKF", 2.0, 10.0)]
    gained = ekf["online_pose_log_score_bits"] - odometry["online_pose_log_score_bits"]
    assert row["bits gained"] == pytest.approx(gained.mean())
    claimed = odometry["online_pose_entropy_bits"] - ekf["online_pose_entropy_bits"]
    assert row["bits claimed"] == pytest.approx(claimed.mean())
    ms = 1e3 * (ekf["update_s"] + ekf["estimate_s"]) / 25
    assert row["bits per ms"] == pytest.approx(gained.mean() / ms.median())
    assert plot_frontier(results).axes[0].get_title() == "odometry scale = 0.3"


def test_nobody_beats_who_is_on_the_frontier() -> None:
    generator = np.random.default_rng(3)
    for _ in range(50):
        cost, gain = generator.integers(0, 6, (2, 8)).astype(float)
        kept = unbeaten(cost, gain)
        beaten = [
            any(
                (cost[j] <= cost[i] and gain[j] > gain[i]) or (cost[j] < cost[i] and gain[j] >= gain[i])
                for j in range(8)
            )
            for i in range(8)
        ]
        places = {(cost[i], gain[i]) for i in kept}
        assert places == {(cost[i], gain[i]) for i in range(8) if not beaten[i]}
        assert len(places) == len(kept)
        assert list(cost[kept]) == sorted(cost[kept])


def test_other_sweeps_are_told_why_there_is_no_map(results: Results) -> None:
    one = replace(results, trials=results.trials[results.trials["source.in_view"] == 2.0])
    with pytest.raises(NotDrawable, match="a map needs two or three swept parameters, and one was"):
        cells(one)
    names = ("regimes", "honesty", "gain", "frontier")
    assert all("a map needs two or three" in drawn.reason for drawn in each_figure(one, names))
    with_three = results.trials.assign(**{"source.steps": 25 + results.trials["seed"] % 2})
    of = cells(replace(results, trials=with_three))
    assert (of.panel, of.down, of.across) == ("source.in_view", "source.odometry_scale", "source.steps")


def test_without_the_odometry_no_bits_are_told(results: Results) -> None:
    config = {**results.manifest["config"], "back_ends": results.manifest["config"]["back_ends"][1:]}
    alone = replace(
        results,
        trials=results.trials[results.trials["label"] != "odometry"],
        manifest={**results.manifest, "config": config},
    )
    with pytest.raises(NotDrawable, match="no back end is the odometry alone"):
        frontier_table(alone)
