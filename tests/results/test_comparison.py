"""Folders held against each other: what is paired, what is refused, and when a build fails."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from slamcmp.errors import UsageError
from slamcmp.metrics import metric_columns
from slamcmp.report.comparison import comparison_html, comparison_markdown
from slamcmp.results.compare.comparison import Comparison, compare_results, judge_condition
from slamcmp.results.compare.conditions import parse_condition
from slamcmp.results.compare.differences import differences
from slamcmp.results.compare.paired_runs import seeds_text
from slamcmp.results.store import Results
from tests.results.hand_made import results_of, runs

BEFORE = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]
FACTORS = [1.3, 1.2, 1.25, 1.4, 1.1, 1.3]
AFTER = [a * b for a, b in zip(BEFORE, FACTORS, strict=True)]
NOISE = "source.noise_scale"


def folder(name: str, rows: list[dict[str, Any]], **manifest: Any) -> Results:
    return replace(results_of(rows), folder=Path(name), manifest=manifest)


def fails(comparison: Comparison, text: str, evidence: Any = "interval") -> bool:
    return judge_condition(parse_condition(text, metric_columns()), [comparison], evidence).fails


def test_ratio_and_difference_are_those_of_the_pairs() -> None:
    found = compare_results(folder("a", runs("EKF", BEFORE)), folder("b", runs("EKF", AFTER)))
    online = next(row for row in found.rows if row.metric == "online_ate")
    logs = np.log(FACTORS)
    interval = stats.t.interval(0.95, 5, logs.mean(), stats.sem(logs))
    assert online.ratio.estimate == pytest.approx(math.exp(logs.mean()))
    assert (online.ratio.low, online.ratio.high) == pytest.approx(tuple(np.exp(interval)))
    steps = np.subtract(AFTER, BEFORE)
    assert online.difference.estimate == pytest.approx(np.median(steps))
    # Six values: their median lies between the smallest and the largest with 97 %.
    assert (online.difference.low, online.difference.high) == pytest.approx((steps.min(), steps.max()))
    assert (online.pairs, online.base, online.other, online.verdict) == (6, 6.0, np.median(AFTER), "worse")
    back = compare_results(folder("b", runs("EKF", AFTER)), folder("a", runs("EKF", BEFORE)))
    assert {row.verdict for row in back.rows} == {"better"}
    same = compare_results(folder("a", runs("EKF", BEFORE)), folder("b", runs("EKF", BEFORE)))
    assert {row.verdict for row in same.rows} == {"identical"}
    mixed = [a * f for a, f in zip(BEFORE, [1.3, 0.8, 1.2, 0.7, 1.1, 0.9], strict=True)]
    tie = compare_results(folder("a", runs("EKF", BEFORE)), folder("b", runs("EKF", mixed)))
    assert {row.verdict for row in tie.rows} == {"tie"}


@pytest.mark.parametrize(
    ("text", "evidence", "expected"),
    [
        # The ratio is 1.254 [1.14 to 1.38]; differences are 0.3 to 9.6, their median 1.3.
        ("online_ate worse by 5%", "interval", True),
        ("online_ate worse by 13 %", "interval", True),
        ("online_ate worse by 20%", "interval", False),
        ("online_ate worse by 20%", "estimate", True),
        ("online_ate worse by 30%", "estimate", False),
        ("online_ate better by 5%", "estimate", False),
        ("online_ate differs by 10%", "interval", True),
        ("online_ate worse by 0.2 m", "interval", True),
        ("online_ate worse by 29cm", "interval", True),
        ("online_ate worse by 31 cm", "interval", False),
        ("online_ate worse by 1.2 m", "estimate", True),
        ("online_ate worse by 1.4 m", "estimate", False),
        ("final_ate worse by 0", "interval", True),
    ],
)
def test_a_condition_looks_at_the_interval_or_at_the_estimate(
    text: str, evidence: str, expected: bool
) -> None:
    found = compare_results(folder("a", runs("EKF", BEFORE)), folder("b", runs("EKF", AFTER)))
    if text.endswith(" 0"):
        text += " m"
    assert fails(found, text, evidence) is expected


def test_higher_is_worse_only_where_lower_is_better() -> None:
    recall = [{"gate_recall": 0.9}] * 6, [{"gate_recall": 0.6}] * 6
    before, after = (
        folder(name, [row | more for row, more in zip(runs("EKF", BEFORE), each, strict=True)])
        for name, each in zip("ab", recall, strict=True)
    )
    down, up = (compare_results(*pair, ["gate_recall"]) for pair in ((before, after), (after, before)))
    assert fails(down, "gate_recall worse by 20%")
    assert not fails(up, "gate_recall worse by 20%")
    assert fails(up, "gate_recall better by 20%")
    assert [down.rows[0].verdict, up.rows[0].verdict] == ["worse", "better"]


def test_without_an_interval_the_estimate_decides() -> None:
    """A recorded log is one run, and a build must notice all the same."""
    before, after = folder("a", runs("EKF", [1.0, 1.0])), folder("b", runs("EKF", [1.2, 1.0]))
    found = compare_results(before, after)
    assert {row.verdict for row in found.rows} == {"too few runs"}
    assert fails(found, "online_ate worse by 5%")
    assert not fails(found, "online_ate worse by 20%")


def test_a_run_that_only_the_base_finished_is_worse_than_any_amount() -> None:
    after = folder("b", runs("EKF", BEFORE, failed=(2, 5)))
    found = compare_results(folder("a", runs("EKF", BEFORE)), after)
    online = found.rows[0]
    assert (online.pairs, online.lost, online.verdict) == (4, ("2", "5"), "identical")
    judged = judge_condition(parse_condition("online_ate worse by 500%", metric_columns()), [found])
    assert judged.because == ("b: EKF: seeds 2, 5 finished in a only",)
    assert not fails(found, "online_ate better by 1%")
    back = compare_results(after, folder("a", runs("EKF", BEFORE)))
    assert back.rows[0].gained == ("2", "5")
    assert not fails(back, "online_ate worse by 0%")
    nobody = compare_results(folder("a", runs("EKF", [1.0])), folder("b", runs("EKF", [1.0], failed=(0,))))
    assert nobody.rows[0].verdict == "no pair"
    assert fails(nobody, "online_ate worse by 5%")


def test_only_runs_on_the_same_stream_are_paired() -> None:
    other = runs("EKF", BEFORE)
    other[1]["digest"] = "e" * 64
    other[2]["reference"] = "batch (final)"
    config = {"config": {"source": {"name": "circle", "steps": 40}}}
    changed = {"config": {"source": {"name": "circle", "steps": 41}}}
    found = compare_results(folder("a", runs("EKF", BEFORE[:5]), **config), folder("b", other, **changed))
    assert {row.pairs for row in found.rows} == {3}
    assert [each.sentence() for each in found.refused] == [
        "EKF, seed 5: run in b only",
        "EKF, seed 1: different streams (digests d and eeeeeeeeeeee): source.steps 40 → 41",
        "EKF, seed 2: scored against 'truth' in the one and 'batch (final)' in the other",
    ]
    nothing = [row | {"digest": "e"} for row in runs("EKF", BEFORE)]
    with pytest.raises(UsageError, match=r"cannot be compared: EKF, seeds 0, 1, .* different streams"):
        compare_results(folder("a", runs("EKF", BEFORE)), folder("b", nothing))


def test_grid_points_meet_where_one_sweeps_what_the_other_has_set() -> None:
    """The base sweeps the noise; the other was run at one of its values."""
    base = folder("a", [row for n in (1.0, 2.0) for row in runs("EKF", [n, 2 * n], **{NOISE: n})])
    for trial, row in enumerate(base.trials.index):
        base.trials.loc[row, "trial"] = trial
    other = folder("b", runs("EKF", [2.2, 4.4]), config={"source": {"noise_scale": 2.0}})
    found = compare_results(base, other, ["online_ate"])
    (row,) = [row for row in found.rows if row.pairs]
    assert (row.at, row.ratio.estimate) == ({NOISE: 2.0}, pytest.approx(1.1))
    assert [each.at for each in found.refused] == [{NOISE: 1.0}]


def test_back_ends_of_other_names_are_paired_on_request() -> None:
    base = folder("a", runs("EKF", BEFORE) + runs("old", AFTER))
    other = folder("b", runs("new", BEFORE) + runs("EKF", BEFORE))
    found = compare_results(base, other, names={"old": "new"})
    assert {(row.label, row.verdict) for row in found.rows} == {("EKF", "identical"), ("old", "better")}
    alone = compare_results(base, other)
    assert [each.sentence() for each in alone.refused] == [
        "old: only in a; --pair 'old=NAME' names its partner",
        "new: only in b",
    ]
    with pytest.raises(UsageError, match=r"b has no back end 'newer'; did you mean 'new'\?"):
        compare_results(base, other, names={"old": "newer"})


def test_what_differs_is_named_by_its_key() -> None:
    entry = {"name": "ekf_slam", "label": "EKF"}
    before = {
        "config": {"source": {"name": "circle"}, "back_ends": [{**entry, "smooth": False}], "seeds": [1]},
        "commit": {"sha": "a" * 40, "dirty": False},
        "code": {"stream": "1" * 64, "EKF": "2" * 64},
        "versions": {"numpy": "2.1"},
        "cpu": "x",
    }
    after = {
        "config": {"source": {"name": "circle"}, "back_ends": [{**entry, "smooth": True}], "seeds": [2]},
        "commit": {"sha": "a" * 40, "dirty": True},
        "code": {"stream": "1" * 64, "EKF": "3" * 64},
        "versions": {"numpy": "2.2"},
        "cpu": "x",
    }
    row = runs("EKF", [1.0])
    found = differences(folder("a", row, **before), folder("b", row, **after))
    assert [(d.key, d.base, d.other) for d in found.configuration] == [
        ("back_ends.EKF.smooth", "False", "True")
    ]
    assert [d.key for d in found.code] == ["commit", "EKF"]
    assert [(d.key, d.base, d.other) for d in found.versions] == [("numpy", "2.1", "2.2")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("onlin_ate worse by 5%", r"no metric 'onlin_ate'; did you mean 'online_ate'\? Known: chi2_per_dof"),
        ("online_ate worse 5%", "expected METRIC worse"),
        ("online_ate bigger by 5%", "'bigger' is not one of worse, better, differs"),
        ("online_ate worse by -5%", "expected METRIC"),
        ("online_ate worse by 5 deg", "online_ate is in m or cm or mm, so the amount"),
        ("online_pose_nees worse by 5%", "no better and worse; say 'online_pose_nees differs by"),
        ("gate_recall worse by 5 m", "gate_recall is in no unit"),
        ("", "expected METRIC"),
    ],
)
def test_a_condition_that_cannot_be_read_says_what_can(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        parse_condition(text, metric_columns())


@pytest.mark.parametrize(
    "text",
    ["online ATE worse by 5%", "Online ATE [m]  worse by more than 5 %", "online-ate worse by >5%"],
)
def test_a_condition_reads_as_people_write_it(text: str) -> None:
    found = parse_condition(text, metric_columns())
    plain = parse_condition("online_ate worse by 5%", metric_columns())
    assert dataclasses.replace(found, text=plain.text) == plain
    aligned = parse_condition("final ATE, SE-aligned differs by over 2 cm", metric_columns())
    assert (aligned.metric, aligned.amount, aligned.relative) == ("final_ate_aligned", 0.02, False)


def test_a_metric_that_nobody_has_is_an_error_and_not_a_pass() -> None:
    found = compare_results(folder("a", runs("EKF", BEFORE)), folder("b", runs("EKF", BEFORE)))
    with pytest.raises(UsageError, match="no back end has landmark_rmse in both; compared are final_ate"):
        fails(found, "landmark_rmse worse by 5%")


def test_pages_hold_every_row_and_nobodys_markup() -> None:
    hostile = "<img src=x>|**a** @all"
    before, after = (folder(n, runs(hostile, each)) for n, each in (("a", BEFORE), ("b", AFTER)))
    found = [compare_results(before, after)]
    judged = [judge_condition(parse_condition("online_ate worse by 5%", metric_columns()), found)]
    page, text = comparison_html(found, judged), comparison_markdown(found, judged)
    assert "<img" not in page
    assert "**FAILS: online_ate worse by 5%**" in text
    rows = [line for line in text.splitlines() if line.startswith("| online\\_ate")]
    (row,) = rows
    # Escaped bars are no columns.
    assert len(row.replace("\\|", "").split("|")) - 2 == 8
    assert "\\<img" in row
    ratio = found[0].rows[0].ratio
    assert f"<td>{ratio.estimate:.2f} [{ratio.low:.2f} to {ratio.high:.2f}]</td>" in page


def test_many_seeds_are_counted() -> None:
    assert seeds_text(["3"]) == "seed 3"
    assert seeds_text([str(each) for each in range(9)]) == "9 seeds"
    assert seeds_text([""]) == ""
