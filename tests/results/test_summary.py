"""Tables of the whole experiment, from numbers that tell every mistake from every other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from slamcmp.cli.run import _print_results
from slamcmp.results.judgements.certainty import certainty_table, failure_rate, last_frame_nees
from slamcmp.results.judgements.summary import paired_table, summary_intervals, summary_table, terminal_table
from slamcmp.results.numbers import interval_text, number_text
from tests.results.hand_made import results_of, runs

ERRORS = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]
NOISE = "source.noise_scale"


def test_runs_that_failed_are_in_no_statistic() -> None:
    """Seed 7 diverged at an error of 10 km and seed 6 crashed: both stand in the counts alone."""
    rows = runs("A", [*ERRORS[:6], 1e4, 1e4], failed=(7,))
    rows[6]["status"] = "crashed"
    results = results_of(rows)
    (row,) = summary_table(results).to_dict("records")
    assert (row["runs"], row["ok"], row["failed"]) == (8, 6, "1 diverged, 1 crashed")
    # Six values: half way between the third and the fourth, not the mean.
    assert row["online ATE [m]"] == 6.0
    assert row["final ATE [m]"] == 3.0
    (intervals,) = summary_intervals(results)
    assert (intervals["online ATE [m]"].low, intervals["online ATE [m]"].high) == (1.0, 32.0)
    online, final = certainty_table(results).to_dict("records")
    assert (online["median ATE [m]"], final["median ATE [m]"]) == (6.0, 3.0)
    assert (online["mean ATE [m]"], final["mean ATE [m]"]) == (10.5, 5.25)
    assert (online["worst ATE [m]"], online["its seed"]) == (32.0, "5")
    assert online["95 % of the median"] == "1.00 to 32.0"
    assert online["95 % of the mean"] == ""
    assert failure_rate(results.trials) == online["failed (95 %)"] == "25 % (7 to 59 %)"


def test_a_mean_has_an_interval_from_fifty_runs_on() -> None:
    errors = np.random.default_rng(0).rayleigh(1.0, 50).tolist()
    texts = [certainty_table(results_of(runs("A", errors[:n])))["95 % of the mean"][0] for n in (49, 50)]
    assert texts[0] == ""
    low, high = map(float, texts[1].split(" to "))
    assert low < np.mean(errors) < high


def test_the_last_frames_nees_is_that_of_its_trajectory() -> None:
    """Online 2, 4 and (diverged) 60 at the last frame, with hindsight half of it; before, far more."""
    last = {0: 2.0, 1: 4.0, 2: 60.0}
    frames = pd.DataFrame(
        [
            {"trial": seed, "label": label, "k": k, "online_nees": nees * by, "final_nees": nees * by / 2}
            for seed, nees in last.items()
            for label, more in (("A", 1.0), ("B", 7.0))
            for k, by in ((2, more), (0, 100.0 * more), (1, 10.0 * more))
        ]
    )
    results = results_of(runs("A", [1.0, 2.0, 3.0], failed=(2,)), frames)
    online, final = certainty_table(results).to_dict("records")
    assert (online["ANEES, last frame"], final["ANEES, last frame"]) == (3.0, 1.5)
    band = stats.chi2.interval(0.95, 6)
    assert online["95 % band"] == f"{number_text(band[0] / 2)} to {number_text(band[1] / 2)}"
    assert last_frame_nees(results, results.trials).runs == 2
    space = results_of(runs("A", [1.0, 2.0, 3.0], failed=(2,)), frames.assign(online_err_5=0.0))
    band = stats.chi2.interval(0.95, 12)
    assert last_frame_nees(space, space.trials).high == pytest.approx(band[1] / 2)


def test_pairs_are_seeds_that_both_finished_at_one_grid_point() -> None:
    """B is about 1.5 times A at noise 1 and half of A at noise 2; a failed run spoils its pair only."""
    wobble = np.array([1.0, 1.1, 0.9, 1.05, 0.95, 1.02, 1.0, 1.0])
    rows = runs("A", ERRORS, **{NOISE: 1.0}) + runs(
        "B", (1.5 * wobble * ERRORS).tolist(), (7,), **{NOISE: 1.0}
    )
    rows += [row | {"trial": row["seed"] + 100} for row in runs("A", ERRORS, **{NOISE: 2.0})]
    rows += [row | {"trial": row["seed"] + 100} for row in runs("B", [e / 2 for e in ERRORS], **{NOISE: 2.0})]
    # What A and B had online is not what they have with hindsight.
    for row in rows:
        row["final_ate"] = row["online_ate"] * (0.5 if row["label"] == "A" else 0.1)
    table = paired_table(results_of(rows)).set_index([NOISE, "trajectory"])
    online = table.loc[(1.0, "online")]
    ratios = 1.5 * wobble[:7]
    assert (online["back end"], online["compared with"], online["pairs"]) == ("B", "A", 7)
    assert online["median ATE ratio"] == pytest.approx(np.median(ratios))
    assert online["ATE ratio"] == pytest.approx(stats.gmean(ratios))
    test = stats.ttest_1samp(np.log(ratios), 0.0)
    assert online["t test p"] == pytest.approx(test.pvalue)
    low, high = np.exp(test.confidence_interval(0.95))
    assert online["95 % of it"] == f"{number_text(low)} to {number_text(high)}"
    assert online["95 % of the ratio"] == f"{number_text(min(ratios))} to {number_text(max(ratios))}"
    differences = ratios * ERRORS[:7] - ERRORS[:7]
    assert online["median difference [m]"] == pytest.approx(np.median(differences))
    assert (online["better in"], online["sign test p"]) == (0, pytest.approx(2 / 2**7))
    assert online["signed-rank p"] == pytest.approx(stats.wilcoxon(np.log(ratios), method="exact").pvalue)
    assert table.loc[(1.0, "final"), "median ATE ratio"] == pytest.approx(np.median(ratios) / 5)
    other = table.loc[(2.0, "online")]
    assert (other["pairs"], other["better in"], other["ATE ratio"]) == (8, 8, pytest.approx(0.5))


def test_a_signed_rank_is_of_the_logarithm() -> None:
    """Twice and half as large are equally far from equal: their ranks must not differ by which is which."""
    up = [2.0, 3.0, 5.0, 1 / 1.5, 1 / 7.0, 1.2]
    first, second = [1.0] * 6, [1.0] * 6
    table = paired_table(results_of(runs("A", first) + runs("B", up)))
    swapped = paired_table(results_of(runs("A", up) + runs("B", second)))
    assert table["signed-rank p"][0] == pytest.approx(swapped["signed-rank p"][0])
    assert table["t test p"][0] == pytest.approx(swapped["t test p"][0])


def test_the_reference_is_left_out_of_its_own_comparison_only() -> None:
    """Its final trajectory has no error against itself; its online one has, and so has everybody's."""
    rows = runs("A", ERRORS[:6], reference="B (final)") + runs("B", ERRORS[:6], reference="B (final)")
    for row in rows[6:]:
        row["online_ate"], row["final_ate"] = 3 * row["online_ate"], 1e-13
    table = paired_table(results_of(rows))
    assert table["trajectory"].tolist() == ["online"]
    assert table["ATE ratio"][0] == pytest.approx(3.0)
    # Where each grid point has its own, the row names its own.
    rows = runs("A", [1.0], **{NOISE: 1.0}) + runs("A", [1.0], reference="B (final)", **{NOISE: 2.0})
    assert summary_table(results_of(rows))["reference"].tolist() == ["truth", "B (final)"]


def test_too_few_pairs_have_no_test() -> None:
    (row,) = paired_table(results_of(runs("A", ERRORS[:4]) + runs("B", ERRORS[1:5]))).to_dict("records")[:1]
    assert row["pairs"] == 4
    assert row["ATE ratio"] == pytest.approx(2.0)
    assert (row["95 % of it"], row["95 % of the ratio"]) == ("", "")
    assert all(math.isnan(row[name]) for name in ("t test p", "sign test p", "signed-rank p"))


def test_the_terminal_says_whose_online_columns_a_batch_solver_shows(capsys) -> None:
    once, always, other = (
        {"name": "batch", "label": "MAP"},
        {"name": "batch", "label": "B", "every": 1},
        {"name": "isam2", "label": "iSAM2"},
    )
    results = results_of(runs("MAP", ERRORS) + runs("B", ERRORS))
    for back_ends, told in (([once, always, other], True), ([always, other], False), ([], False)):
        known = replace(results, manifest={"config": {"back_ends": back_ends}})
        _print_results(known, terminal_table(known), known.trials[:0])
        said = capsys.readouterr().out
        assert ("online columns of MAP: the warm start's (iSAM2's by default)" in said) is told


def test_texts() -> None:
    (intervals,) = summary_intervals(results_of(runs("A", ERRORS[:5])))
    assert interval_text(intervals["online ATE [m]"]) == ""
