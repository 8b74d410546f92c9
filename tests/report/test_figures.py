"""What stands in the figures: every value against the tables or a closed form."""

from __future__ import annotations

import dataclasses
import math

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse, Rectangle
from scipy.stats import chi2

from slamcmp.errors import UsageError
from slamcmp.registry import Plugin, figures
from slamcmp.report import draw_figures, summary_table
from slamcmp.report.figures import style
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.report.figures.runs.consistency import binned_nis, plot_consistency
from slamcmp.report.figures.runs.errors import plot_errors
from slamcmp.report.figures.runs.map import ellipse_95, plot_map
from slamcmp.report.figures.runs.time import binned_times, fitted_law, plot_time
from slamcmp.report.figures.sweeps.budget import budget_points, plot_budget
from slamcmp.report.figures.sweeps.sweep import plot_sweep
from slamcmp.report.html import report_html
from slamcmp.types import GroundTruth, Run, Trajectory


@pytest.fixture(autouse=True)
def _report_style():
    with matplotlib.rc_context(style.RC):
        yield


def ellipses(axes):
    return [patch for patch in axes.patches if isinstance(patch, Ellipse)]


def test_ellipse_has_the_chi_square_semi_axes_and_the_angle_of_P():
    # Variances 4 and 1 along axes turned by 30 degrees.
    cos, sin = math.cos(math.pi / 6), math.sin(math.pi / 6)
    P = np.array([[cos, -sin], [sin, cos]]) @ np.diag([4.0, 1.0]) @ np.array([[cos, sin], [-sin, cos]])
    ellipse = ellipse_95(1.0, 2.0, P[0, 0], P[0, 1], P[1, 1])
    scale = math.sqrt(chi2.ppf(0.95, 2))
    assert ellipse.center == (1.0, 2.0)
    # The first axis belongs to the smaller eigenvalue, whose direction is 120 degrees.
    assert (ellipse.width, ellipse.height) == pytest.approx((2 * scale, 4 * scale), rel=1e-12)
    assert ellipse.angle % 180 == pytest.approx(120, abs=1e-9)


def test_map_draws_each_back_end_s_trajectories_landmarks_and_ellipses(one_trial):
    figure = plot_map(one_trial)
    ekf, isam2 = figure.axes
    frames = one_trial.frames.set_index("label")
    # Truth and online; the smoother has its final trajectory too; then true and estimated landmarks.
    assert [len(ekf.lines), len(isam2.lines)] == [4, 5]
    np.testing.assert_array_equal(ekf.lines[1].get_xdata(), frames.loc["ekf", "online_x"])
    assert ekf.lines[1].get_linestyle() == "--"
    np.testing.assert_array_equal(isam2.lines[2].get_ydata(), frames.loc["isam2", "final_y"])
    assert isam2.lines[2].get_linestyle() == "-"
    # Twelve along the path and one per landmark.
    assert len(ellipses(ekf)) == 24
    widths = {round(ellipse.height, 9) for ellipse in ellipses(ekf)[12:]}
    largest = np.linalg.eigvalsh(np.array([[0.05, 0.02], [0.02, 0.03]]))[1]
    assert widths == {round(2 * math.sqrt(chi2.ppf(0.95, 2) * largest), 9)}
    assert ekf.get_xlabel() == "x [m]"
    ate = one_trial.trials.set_index("label").loc["ekf", "online_ate"]
    assert ekf.get_title(loc="left") == f"ekf\nonline ATE {ate:.3g} m\nno final trajectory"


def test_map_keeps_to_the_reference_when_an_estimate_runs_away(one_trial):
    frames = one_trial.frames.copy()
    frames.loc[frames["label"] == "ekf", "online_x"] += 1e6
    figure = plot_map(dataclasses.replace(one_trial, frames=frames))
    assert figure.axes[0].get_xlim()[1] < 20


def test_errors_lie_in_a_band_of_three_sigma(one_trial):
    figure = plot_errors(one_trial)
    assert len(figure.axes) == 6
    forward, heading = figure.axes[0], figure.axes[4]
    own = one_trial.frames[one_trial.frames["label"] == "ekf"]
    band = forward.collections[0].get_paths()[0].vertices[:, 1]
    # sigma = 0.2 m, and 0.02 rad for the heading.
    assert (band.min(), band.max()) == pytest.approx((-0.6, 0.6), rel=1e-12)
    band = heading.collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx(math.degrees(0.06), rel=1e-12)
    np.testing.assert_array_equal(forward.lines[0].get_ydata(), own["online_err_0"])
    np.testing.assert_allclose(heading.lines[0].get_ydata(), np.degrees(own["online_err_2"]))
    assert (forward.get_ylabel(), heading.get_ylabel()) == ("forward [m]", "heading [deg]")


def test_errors_against_a_reference_are_called_differences(recorded):
    figure = plot_errors(recorded)
    assert figure.get_suptitle().startswith("Difference from batch (final)")


def test_nees_is_averaged_over_the_seeds_and_its_band_knows_how_many(swept):
    figure = plot_consistency(swept)
    online = figure.axes[0]
    rectangle = next(patch for patch in online.patches if isinstance(patch, Rectangle))
    low, high = chi2.interval(0.95, 6 * 3)
    assert rectangle.get_y() == pytest.approx(low / 6, rel=1e-12)
    assert rectangle.get_y() + rectangle.get_height() == pytest.approx(high / 6, rel=1e-12)
    own = swept.frames[(swept.frames["label"] == "ekf") & (swept.frames["source.range_sigma_m"] == 1.0)]
    expected = own.groupby("t")["online_nees"].mean()
    np.testing.assert_allclose(online.lines[0].get_ydata(), expected, rtol=1e-12)
    assert [axes.get_ylabel() for axes in figure.axes] == ["pose NEES", "pose NEES", "NIS / dof"]


def test_without_truth_only_the_nis_is_drawn_with_its_band(recorded):
    figure = plot_consistency(recorded)
    assert [axes.get_ylabel() for axes in figure.axes] == ["NIS / dof"]
    # 120 frames in groups of 2, 4 degrees of freedom each.
    band = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    low, high = chi2.interval(0.95, 8)
    assert (band.min(), band.max()) == pytest.approx((low / 8, high / 8), rel=1e-9)
    own = recorded.frames[recorded.frames["label"] == "ekf"]
    time, ratio, dof = binned_nis(own)
    assert time[0] == pytest.approx(0.25)
    assert ratio[0] == pytest.approx(own["nis"].iloc[:2].sum() / 8)
    assert set(dof) == {8.0}


def test_failed_runs_are_not_averaged(swept):
    frames = swept.frames.copy()
    trials = swept.trials.copy()
    bad = (trials["source.range_sigma_m"] == 1.0) & (trials["label"] == "ekf") & (trials["seed"] == 3)
    trials.loc[bad, "status"] = "diverged"
    frames.loc[frames["trial"].isin(trials.loc[bad, "trial"]) & (frames["label"] == "ekf"), "online_nees"] = (
        1e9
    )
    figure = plot_consistency(dataclasses.replace(swept, trials=trials, frames=frames))
    assert max(figure.axes[0].lines[0].get_ydata()) < 1e3
    # Five runs left for one back end: the band is the widest.
    rectangle = next(patch for patch in figure.axes[0].patches if isinstance(patch, Rectangle))
    assert rectangle.get_y() == pytest.approx(chi2.ppf(0.025, 15) / 5, rel=1e-12)


def test_time_is_the_median_of_its_group(swept):
    own = swept.frames[swept.frames["label"] == "isam2"]
    position, median, high = binned_times(own, "landmarks", "update_s")
    np.testing.assert_array_equal(position, np.arange(1, 13))
    sevens = 1e3 * own.loc[own["landmarks"] == 7, "update_s"]
    assert median[6] == pytest.approx(sevens.median())
    assert high[6] == pytest.approx(sevens.quantile(0.95))
    figure = plot_time(swept)
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["update [ms]", "estimate [ms]"]
    assert figure.axes[3].get_xlabel() == "landmarks in the map"
    np.testing.assert_allclose(figure.axes[1].lines[3].get_ydata(), median)


def test_the_law_of_a_long_runs_cost_is_that_of_its_second_half(one_trial):
    k = np.linspace(10.0, 2990.0, 60)
    cost = np.where(k < 1400, 5.0, 0.3 * k**0.7)
    a, b, late = fitted_law(k, cost)
    assert (a, b) == (pytest.approx(0.3), pytest.approx(0.7))
    assert k[late].min() >= 1495.0
    assert fitted_law(k[:10], cost[:10]) is None
    for count in (999, 1000):
        times = pd.DataFrame({"k": np.arange(count), "update_s": 1e-3})
        assert (fitted_law(*binned_times(times, "k", "update_s")[:2]) is not None) == (count == 1000)
    # A run of 2400 frames whose update costs as the square root of the frame.
    own = one_trial.frames[one_trial.frames["label"] == "isam2"]
    long = pd.concat([own.assign(k=own["k"] + len(own) * lap) for lap in range(20)])
    long["update_s"], long["estimate_s"] = 1e-4 * np.sqrt(long["k"] + 1.0), 1e-3
    figure = plot_time(dataclasses.replace(one_trial, frames=long))
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "isam2: update $k^{0.5}$, estimate $k^{0.0}$" in told


def test_budget_counts_what_each_trajectory_needs(one_trial):
    row = one_trial.trials.set_index("label").loc["isam2"]
    online = budget_points(one_trial.trials, "online").set_index("label").loc["isam2"]
    final = budget_points(one_trial.trials, "final").set_index("label").loc["isam2"]
    assert online["ms"] == pytest.approx(1e3 * (row["update_s"] + row["estimate_s"]) / 120)
    assert final["ms"] == pytest.approx(1e3 * (row["update_s"] + 0.05) / 120)
    assert final["error_m"] == row["final_ate"]
    titles = [axes.get_title(loc="left") for axes in plot_budget(one_trial).axes]
    assert titles == ["online trajectory (causal)", "final trajectory (with hindsight)"]


def test_budget_leaves_the_reference_out_of_its_own_comparison(recorded):
    assert list(budget_points(recorded.trials, "final")["label"]) == []
    assert list(budget_points(recorded.trials, "online")["label"]) == ["ekf", "batch"]


def test_sweep_draws_medians_of_finished_runs_and_counts_the_failed(swept):
    figure = plot_sweep(swept)
    ate = figure.axes[0]
    ok = swept.trials[(swept.trials["status"] == "ok") & (swept.trials["label"] == "ekf")]
    expected = ok.groupby("source.range_sigma_m")["online_ate"].median()
    # Three back ends stand side by side: the middle one at the swept value itself.
    np.testing.assert_allclose(np.asarray(ate.lines[1].get_xdata(), dtype=float), [0.5, 1.0, 2.0])
    np.testing.assert_allclose(np.asarray(ate.lines[0].get_xdata(), dtype=float), [0.482, 0.982, 1.982])
    assert ate.get_xlim()[0] > 0.3
    np.testing.assert_allclose(np.asarray(ate.lines[0].get_ydata(), dtype=float), expected)
    bar = ate.collections[0].get_segments()[2]
    assert bar[1, 1] == pytest.approx(ok[ok["source.range_sigma_m"] == 2.0]["online_ate"].quantile(0.75))
    # The interval of six runs goes from the smallest to the largest; four runs have none.
    bounds, _, few = ate.collections[1].get_segments()
    least = ok[ok["source.range_sigma_m"] == 0.5]["online_ate"]
    assert tuple(bounds[:, 1]) == (least.min(), least.max())
    assert len(few) == 0
    assert [text.get_text() for text in ate.texts] == ["2 failed"]
    # The filter has no final line; both smoothers have one.
    assert [line.get_linestyle() for line in ate.lines] == ["--", "--", "-", "--", "-"]


def test_a_swept_name_gets_a_place_of_its_own(swept):
    trials = swept.trials.rename(columns={"source.range_sigma_m": "source.path"})
    trials["source.path"] = trials["source.path"].map({0.5: "circle", 1.0: "line", 2.0: "eight"})
    figure = plot_sweep(dataclasses.replace(swept, trials=trials))
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["circle", "line", "eight"]
    np.testing.assert_allclose(np.asarray(figure.axes[0].lines[1].get_xdata(), dtype=float), [0, 1, 2])


def test_a_sweep_without_a_single_value_says_so(swept):
    """Every run of every grid point crashed before its first frame: there is no cell to draw."""
    keys = ["trial", "label", "seed", "digest", "source.range_sigma_m", "status", "frames", "reference"]
    trials = swept.trials[keys].assign(
        status="crashed", completion=0.0, update_s=math.nan, estimate_s=math.nan, final_s=math.nan
    )
    empty = dataclasses.replace(swept, trials=trials, frames=swept.frames[:0])
    with pytest.raises(NotDrawable, match="no run has an error, a NEES or a time"):
        plot_sweep(empty)
    (drawn,) = each_figure(empty, ["sweep"])
    assert not drawn.reason.startswith("drawing it failed")


def test_times_that_were_not_taken_are_not_zero(swept):
    """Runs that record have no times: no panel of them, and no accuracy against time."""
    trials = swept.trials.assign(update_s=math.nan, estimate_s=math.nan)
    timeless = dataclasses.replace(swept, trials=trials)
    assert [axes.get_title(loc="left") for axes in plot_sweep(timeless).axes] == [
        "ATE [m]",
        "heading RMSE [deg]",
        "pose NEES (dotted: expected)",
    ]
    with pytest.raises(NotDrawable, match="no run has times"):
        plot_budget(timeless)


def test_figures_without_inputs_are_skipped_with_the_reason(nothing_known, tmp_path):
    files = draw_figures(nothing_known, None, tmp_path / "figures", formats=("svg",))
    assert [path.name for path in files] == ["map.svg", "time.svg"]
    assert set(files.skipped) == {
        "association",
        "attribution",
        "budget",
        "consistency",
        "decisions",
        "dial",
        "errors",
        "frontier",
        "gain",
        "honesty",
        "images",
        "kl_from_batch",
        "observability",
        "regimes",
        "sweep",
    }
    assert "no truth" in files.skipped["errors"]
    assert files.skipped["sweep"] == "nothing was swept"
    with pytest.raises(NotDrawable, match="covariances"):
        plot_consistency(nothing_known)


def test_results_of_runs_that_all_crashed_at_once(swept):
    trials = swept.trials.assign(status="crashed", completion=0.0)
    empty = dataclasses.replace(swept, trials=trials, frames=swept.frames[:0], landmarks=swept.landmarks[:0])
    drawn = {figure.name: figure for figure in each_figure(empty)}
    assert drawn["map"].reason == "no run has a trajectory"
    assert drawn["time"].reason == "no run has times"
    assert drawn["budget"].figure is None


def test_poses_in_space_have_six_rows_and_six_degrees_of_freedom(tabulated):
    poses = np.broadcast_to(np.eye(4), (5, 4, 4)).copy()
    poses[:, 0, 3] = np.arange(5)
    truth = GroundTruth(np.arange(5.0), poses, np.array([7]), np.array([[1.0, 2.0, 3.0]]))
    estimated = poses.copy()
    estimated[:, 2, 3] -= 0.4
    P = np.broadcast_to(np.diag([0.01, 0.01, 0.01, 0.04, 0.04, 0.16]), (5, 6, 6))
    run = Run(
        back_end="spatial",
        parameters={},
        digest="0" * 64,
        seed=None,
        frames=5,
        status="ok",
        message="",
        online=Trajectory(truth.t, estimated, P),
        update_s=np.full(5, 1e-3),
        estimate_s=np.full(5, 1e-3),
    )
    results = tabulated([({}, truth, "truth", [run])])
    figure = plot_errors(results)
    assert [axes.get_ylabel() for axes in figure.axes[::5]] == ["rotation x [deg]", "body z [m]"]
    # 0.4 m along z with sigma 0.4 m.
    np.testing.assert_allclose(figure.axes[5].lines[0].get_ydata(), 0.4)
    band = figure.axes[5].collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx(1.2)
    nees = plot_consistency(results).axes[0]
    np.testing.assert_allclose(nees.lines[0].get_ydata(), 1.0)
    assert "expected 6" in nees.get_title(loc="left")
    assert ellipses(plot_map(results).axes[0])[0].width == pytest.approx(0.4 * math.sqrt(chi2.ppf(0.95, 2)))
    assert "online ATE, SE(3)-aligned [m]" not in summary_table(results).columns
    assert summary_table(results)["online ATE [m]"].tolist() == [pytest.approx(0.4)]


def test_an_unknown_figure_is_a_usage_error(one_trial, tmp_path):
    with pytest.raises(UsageError, match="did you mean 'map'"):
        draw_figures(one_trial, ["maps"], tmp_path)


def test_the_same_results_give_the_same_bytes(one_trial, tmp_path):
    first = draw_figures(one_trial, ["map", "consistency"], tmp_path / "a")
    second = draw_figures(one_trial, ["map", "consistency"], tmp_path / "b")
    assert [path.name for path in first] == ["map.png", "map.svg", "consistency.png", "consistency.svg"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_a_back_end_keeps_its_colour(swept):
    known = style.colours(swept)
    assert known == {"ekf": "#0072B2", "isam2": "#D55E00", "batch": "#009E73"}
    assert to_hex(plot_sweep(swept).axes[0].lines[0].get_color()).upper() == "#0072B2"
    assert to_hex(plot_time(swept).axes[0].lines[0].get_color()).upper() == "#0072B2"
    assert len(set(style.markers(swept).values())) == 3


def test_the_typical_trial_has_the_median_error(swept):
    trial = typical_trial(swept)
    here = swept.trials[swept.trials["source.range_sigma_m"] == 1.0]
    errors = here.groupby("trial")["online_ate"].mean().sort_values()
    assert trial == errors.index[2]


def test_every_figure_says_what_it_shows_and_needs():
    assert {plugin.name for plugin in figures} >= {"map", "errors", "consistency", "time", "budget", "sweep"}
    for plugin in figures:
        assert plugin.traits["caption"].endswith(".")
        assert plugin.traits["title"]
        assert plugin.traits["needs"]


def test_figure_with_a_mistake_is_skipped_with_its_reason(one_trial, tmp_path, monkeypatch):
    def broken(results):
        raise KeyError("online_q")

    def unwritable(results):
        figure = style.new_figure(2, 2, "x")
        figure.savefig = lambda *_, **__: 1 / 0
        return figure

    monkeypatch.setitem(figures._plugins, "map", Plugin("map", broken))
    monkeypatch.setitem(figures._plugins, "time", Plugin("time", unwritable))
    files = draw_figures(one_trial, ["map", "time", "errors"], tmp_path, formats=["svg"])
    assert [file.name for file in files] == ["errors.svg"]
    assert files.skipped["map"].startswith("drawing it failed: KeyError: 'online_q' (test_figures.py:")
    assert files.skipped["time"].startswith("drawing it failed: ZeroDivisionError: ")
    page = report_html(one_trial)
    assert "drawing it failed: KeyError" in page
    assert "drawing it failed: ZeroDivisionError" in page
