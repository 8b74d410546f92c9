"""The page "Filter or smooth?": each of its numbers is derived anew from the committed runs of the study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import slamcmp
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.metrics.statistics import Interval
from slamcmp.results.answers.recommendation import recommend
from slamcmp.results.numbers import interval_text, number_text
from tests.anchors.answer import PARTS, failed, pooled, read, write

PAGE = (Path(__file__).parents[2] / "docs" / "filter-or-smooth.md").read_text(encoding="utf-8")
TEXT = " ".join(PAGE.split())
ODOMETRY, LAP = "source.odometry_scale", "source.turn_deg_s"
FAST = ("EKF", "right-invariant EKF", "iterated EKF", "UKF", "iSAM2")


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    return read("relative_position")


def ratio(found: Interval) -> str:
    return f"{number_text(found.estimate)} ({interval_text(found)})"


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0, 10.0])
@pytest.mark.parametrize(("part", "seeds"), [("relative_position", 20), ("range_bearing", 10)])
def test_the_tables_are_those_of_the_runs(part: str, seeds: int, scale: float) -> None:
    runs, at = read(part), {ODOMETRY: scale}
    assert runs["seed"].nunique() == seeds
    online = [ratio(pooled(runs, label, "EKF", at=at)) for label in ("iSAM2", *FAST[1:4])]
    assert f"| {scale:g} | {' | '.join(online)} |" in PAGE
    final = [
        ratio(pooled(runs, label, "EKF", "final_ate", "online_ate", at)) for label in ("batch", "EKF + RTS")
    ]
    final.append(ratio(pooled(runs, "EKF + RTS", "batch", "final_ate", at=at)))
    assert f"| {scale:g} | {' | '.join(final)} |" in PAGE


def test_windows_stand_beside_isam2_on_the_same_runs(runs: pd.DataFrame) -> None:
    windows = read("relative_position_windows")
    assert sorted(windows["seed"].unique()) == list(range(5))
    both = pd.concat([windows, runs[(runs["seed"] < 5) & (runs["label"] == "iSAM2")]])
    at = {ODOMETRY: 10.0}
    found = {
        label: pooled(both, label, "iSAM2", at=at)
        for label in ("fej 5", "fej 10", "fixed lag 10", "latest 5")
    }
    assert all(each.low <= 1.0 <= each.high for each in found.values())
    said = {label: ratio(each) for label, each in found.items()}
    assert f"first-estimate Jacobians have {said['fej 5']} times iSAM2's error" in TEXT
    assert f"so do ten, {said['fej 10']}, and fixed lag of ten, {said['fixed lag 10']}." in TEXT
    assert f"latest estimates have {said['latest 5']} times its error" in TEXT


def test_what_the_page_says_of_no_difference_is_an_interval_that_holds_one(runs: pd.DataFrame) -> None:
    for scale in (0.3, 1.0):
        for label in FAST[1:]:
            found = pooled(runs, label, "EKF", at={ODOMETRY: scale})
            assert found.low <= 1.0 <= found.high or abs(found.estimate - 1.0) < 0.005, (label, scale, found)
        found = pooled(runs, "EKF + RTS", "batch", "final_ate", at={ODOMETRY: scale})
        assert found.low <= 1.0 <= found.high
    for scale in (0.3, 1.0, 3.0, 10.0):
        found = pooled(runs, "iterated EKF", "EKF", at={ODOMETRY: scale})
        assert found.low <= 1.0 <= found.high
    for label in ("iSAM2", "right-invariant EKF"):
        for scale in (3.0, 10.0):
            assert pooled(runs, label, "EKF", at={ODOMETRY: scale}).high < 1.0
    assert pooled(runs, "EKF + RTS", "batch", "final_ate", at={ODOMETRY: 10.0}).low > 1.0


def test_the_sentences_have_the_numbers_of_the_runs(runs: pd.DataFrame) -> None:
    def against_isam2(scale: float) -> str:
        return ratio(pooled(runs, "right-invariant EKF", "iSAM2", at={ODOMETRY: scale}))

    assert f"times {against_isam2(3.0)} at odometry 3, and times {against_isam2(10.0)} at 10" in TEXT
    bearing = pooled(read("range_bearing"), "right-invariant EKF", "iSAM2", at={ODOMETRY: 10.0})
    assert f"range and bearing times {ratio(bearing)} at 10" in TEXT
    of_laps = [
        ratio(pooled(runs, "iSAM2", "EKF", at={ODOMETRY: 10.0, LAP: turn})) for turn in (18.0, 9.0, 4.5)
    ]
    assert f"iSAM2 has {of_laps[0]} times the EKF's error on laps of 20 m, {of_laps[1]} on 40 m" in TEXT
    assert f"and {of_laps[2]} on 80 m" in TEXT
    hindsight = [
        ratio(pooled(runs, "batch", "EKF", "final_ate", "online_ate", {LAP: turn})) for turn in (18.0, 4.5)
    ]
    assert (
        f"batch has {hindsight[0]} times the EKF's online error on laps of 20 m, and {hindsight[1]}" in TEXT
    )


def test_the_nees_and_the_failures_are_those_of_the_runs(runs: pd.DataFrame) -> None:
    means = runs.groupby(["label", ODOMETRY])["online_pose_nees"].mean()
    ekf, invariant, isam2 = (
        [f"{value:.2g}" if value >= 10 else f"{value:.1f}" for value in means[label]]
        for label in ("EKF", "right-invariant EKF", "iSAM2")
    )
    assert ekf[0] == ekf[1]
    assert f"of the EKF is {ekf[0]} at odometry 0.3 and 1, {ekf[2]} at 3 and {ekf[3]} at 10" in TEXT
    assert f"right-invariant filter {', '.join(invariant[:3])} and {invariant[3]}" in TEXT
    assert f"of iSAM2 {', '.join(isam2[:3])} and {isam2[3]}" in TEXT
    assert "With relative positions no run failed; with range and bearing one of batch's 360 did" in TEXT
    assert all(failed(runs, label) == (0, 720) for label in (*FAST, "batch", "EKF + RTS"))
    other = read("range_bearing")
    assert failed(other, "batch") == (1, 360)
    assert all(failed(other, label) == (0, 360) for label in (*FAST, "EKF + RTS"))


def test_three_sentences_by_hand(runs: pd.DataFrame) -> None:
    """A second way to the page's first claims: plain arithmetic, no function of ours."""
    table = runs.pivot_table(
        index=["seed", ODOMETRY, LAP, "source.in_view"], columns="label", values="online_ate"
    )
    of_seed = np.log(table["iSAM2"] / table["EKF"]).groupby(["seed", ODOMETRY]).mean().unstack()
    mean, error = of_seed.mean(), of_seed.std(ddof=1) / np.sqrt(20)
    # Student's 97.5 % point with 19 degrees of freedom, from a table.
    low, high = np.exp(mean - 2.093 * error), np.exp(mean + 2.093 * error)
    assert low[0.3] < 1 < high[0.3]
    assert f"{np.exp(mean[10.0]):.3f} ({low[10.0]:.3f} to {high[10.0]:.3f})" in PAGE
    hindsight = runs.pivot_table(
        index=["seed", ODOMETRY, LAP, "source.in_view"], columns="label", values="final_ate"
    )
    rts = np.log(hindsight["EKF + RTS"] / hindsight["batch"]).groupby([ODOMETRY]).mean()
    assert f"| {np.exp(rts[10.0]):.2f} (" in PAGE
    assert abs(rts[0.3]) < 0.01


def test_the_grid_is_the_whole_factorial_on_common_seeds(runs: pd.DataFrame) -> None:
    cells = runs.groupby([LAP, "source.in_view", ODOMETRY])
    assert cells.ngroups == 36
    for _, cell in cells:
        assert cell.groupby("label")["seed"].apply(sorted).map(tuple).nunique() == 1
        assert sorted(cell["seed"].unique()) == list(range(20))


def test_each_part_of_the_study_is_shipped_and_has_the_factors() -> None:
    shipped = shipped_experiments()
    assert {name.removeprefix("answer/") for name in shipped if name.startswith("answer/")} == set(PARTS)
    for part in PARTS:
        experiment = load_experiment(shipped[f"answer/{part}"])
        assert [len(values) for values in experiment.sweep.values()] == [3, 3, 4]
        # The parts of a sensor share source and sweep, so that their streams are the same.
        sensor = load_experiment(shipped[f"answer/{part.split('_outliers')[0].split('_windows')[0]}"])
        assert experiment.sweep == sensor.sweep
        own = {**experiment.source.parameters, "outlier_fraction": 0.0}
        assert own == {**sensor.source.parameters, "outlier_fraction": 0.0}


def test_a_small_part_of_the_study_runs_and_its_table_is_what_it_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two cells of the grid, five seeds, 30 frames: the whole way from the file to a verdict."""
    experiment = load_experiment(shipped_experiments()["answer/relative_position"])
    labels = ("dead reckoning", "EKF", "right-invariant EKF")
    found = slamcmp.run(
        {
            "name": "small",
            "source": {"name": experiment.source.name, **experiment.source.parameters, "steps": 30},
            "front_end": {"name": "labelled", "gate_probability": None},
            "back_ends": [
                {"name": each.name, "label": each.label, **each.parameters}
                for each in experiment.back_ends
                if each.label in labels
            ],
            "seeds": 5,
            "sweep": {ODOMETRY: [0.3, 10.0], "source.in_view": [2.0, 5.0]},
        },
        folder=tmp_path / "results",
        jobs=1,
        executor="serial",
    )
    monkeypatch.setattr("tests.anchors.answer.ANSWER", tmp_path)
    write("relative_position", found.folder)
    table = read("relative_position")
    assert len(table) == 2 * 2 * 5 * 3
    # Where wheels are poor nobody is content with them, and the odometry is never within 5 %.
    advice = recommend(found, point={ODOMETRY: 10.0, "source.in_view": 5.0})
    odometry = advice.of("dead reckoning")
    assert odometry is not None
    assert odometry.distance == "beyond"
    assert pooled(table, "EKF", "dead reckoning", at={ODOMETRY: 10.0}).high < 1.0
