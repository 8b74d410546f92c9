"""What is said of tables whose right answer everybody sees."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from slamcmp.advice.advice import changes
from slamcmp.advice.page import advice_html
from slamcmp.advice.words import percent, signed, time_words
from slamcmp.metrics.statistics import Interval, ratio_interval
from tests.advice.hand_made import advice, said
from tests.results.hand_made import SEEDS, back_end

NO_FINAL = {"final_ate": math.nan}


def odometry(**more):
    return back_end("dead reckoning", 8.0, 0.01, **NO_FINAL, **more)


def filters(ekf=1.2, invariant=1.03, *, full=1.0, window=1.03, **more):
    """A robot for which the chart buys what keeping poses would."""
    return [
        odometry(),
        back_end("EKF", ekf, 0.2, **NO_FINAL, **more),
        back_end("right-invariant EKF", invariant, 0.25, **NO_FINAL),
        back_end("window of 10", window, 4.0, **NO_FINAL),
        back_end("iSAM2", full, 2.0),
    ]


def test_a_clear_answer_is_that_of_the_intervals():
    made = advice(*filters())
    text = said(made, "answer")
    found = re.search(
        r"^On this robot the right-invariant EKF is within ([\d.]+) % \[([\d.]+), ([\d.]+)\] of full "
        r"smoothing \(iSAM2\) online, at an eighth of the time, and consistent\.",
        text,
    )
    assert found, text
    trials = made.results.trials.set_index(["label", "seed"])["online_ate"]
    ratio = ratio_interval(trials["right-invariant EKF"], trials["iSAM2"])
    expected = [100 * (value - 1) for value in (ratio.estimate, ratio.low, ratio.high)]
    assert [float(each) for each in found.groups()] == pytest.approx(expected, abs=0.051)
    assert "The covariance of the right-invariant EKF fits its errors: 3" in text
    assert "A window of 10" in said(made, "others")
    assert "buys nothing over the right-invariant EKF" in said(made, "others")
    assert re.search(
        r"The EKF has 16\.2 % \[15\.3, 17\.1\] more error than the right-inv", said(made, "others")
    )
    assert "Odometry alone has 7.8 times" in said(made, "odometry").replace("7.77", "7.8")
    assert "12 paired seeds; errors against the truth" in said(made, "limits")


def test_no_difference_is_said_to_be_none():
    text = said(advice(*filters(1.0, 1.0, window=1.0)), "answer")
    assert text.startswith(
        "There is no difference that matters online: the EKF, the right-invariant EKF, iSAM2 and a window of "
        "10 are all within 5 % of each other, by "
    )
    assert "Take the cheapest: the EKF, 0.200 ms a frame, and consistent." in text


def test_full_smoothing_is_recommended_where_nobody_cheaper_is_near():
    text = said(advice(*filters(1.5, 1.4, window=1.0)), "answer")
    assert text.startswith("On this robot full smoothing (iSAM2) is worth its 2.00 ms a frame online")
    assert re.search(r"the EKF has 5\d % \[\d\d, \d\d\] more error than it", text)


def test_an_overconfident_one_is_named_and_not_recommended():
    made = advice(*filters(1.0, 1.01, nees=9.0))
    assert made.recommendation.label == "right-invariant EKF"
    assert "The EKF is overconfident, do not use its covariance: " in said(made, "answer")
    assert "Take the cheapest of those not overconfident: the right-invariant EKF" in said(made, "answer")


def test_too_few_runs_give_no_comparison_at_all():
    few = [[row for row in group if row["seed"] < 3] for group in filters()]
    made = advice(*few, untried=["twice the odometry noise"])
    assert said(made, "answer").startswith("Not enough runs to say which back end to take: 3 runs that")
    assert not said(made, "others") + said(made, "odometry") + said(made, "hindsight")
    assert said(made, "change") == "Not tried, for there are too few runs: twice the odometry noise."
    assert "recommended" not in set(made.table["verdict"])


def test_an_open_question_names_the_safe_choice_and_the_runs_that_would_tell():
    wide = np.exp(0.08 * np.random.default_rng(1).normal(size=SEEDS))
    groups = filters(window=1.0)
    groups[1] = back_end("EKF", 1.08, 0.2, noise=wide / np.exp(np.log(wide).mean()), **NO_FINAL)
    text = said(advice(*groups), "answer")
    assert text.startswith(
        "Not enough runs to say whether the EKF, which costs less, is within 5 % of the best: the EKF has "
    )
    assert re.search(r"About \d\d seeds would tell \(--seeds \d+\)", text)
    assert "A safe choice: On this robot the right-invariant EKF" in text


def test_a_budget_is_part_of_the_answer():
    made = advice(*filters(), budget_ms=0.45)
    assert made.recommendation.best == "EKF"
    assert "within 0.450 ms a frame" in said(made, "limits")
    nobody = said(advice(*filters(), budget_ms=0.001), "answer")
    assert nobody.startswith("No back end can be recommended. ")
    assert "the EKF: over the budget of 0.00100 ms (0.400 ms in 95 of 100 frames)" in nobody


def test_without_truth_and_batch_there_is_nothing_to_hold_them_against():
    groups = [
        [{**row, "online_ate": math.nan, "reference": "none", "nis_per_dof": 1.1} for row in group[:1]]
        for group in filters()[:3]
    ]
    made = advice(*groups, dropped={"batch": "timed out on the first trial (after 37 s)"})
    text = said(made, "answer")
    assert text.startswith(
        "There is no truth, and no batch solution in its place (batch timed out on the first"
    )
    assert "The EKF's squared innovations are 1.10 times what it expects" in text
    assert "errors against the truth" not in said(made, "limits")


def test_hindsight_tells_the_share_that_the_filters_own_smoother_gets():
    """RTS takes 40 of 100, batch 50: four fifths."""
    groups = [
        *filters(1.0, 1.0),
        back_end("EKF + RTS", 1.0, 0.3, final_ate=0.0),
        back_end("batch", 1.0, 2.0, final_ate=0.0),
    ]
    errors = [row["online_ate"] for row in groups[1]]
    for group, share in ((groups[-2], 0.6), (groups[-1], 0.5)):
        for row, error in zip(group, errors, strict=True):
            row["final_ate"] = share * error * (1.0 + 0.01 * math.sin(row["seed"] + 10 * share))
    text = said(advice(*groups), "hindsight")
    assert re.search(
        r"take `ekf_world` with `smooth: true` \(the EKF with RTS\): 80 % \[79, 8[01]\]", text
    ), text
    assert re.search(r"batch has 50.0 % \[49\.\d, 50\.\d\] less error than what the EKF has online", text), (
        text
    )


def test_hindsight_as_the_question_judges_final_trajectories():
    groups = [
        *filters(),
        back_end("EKF + RTS", 1.02, 0.3, final_pose_nees=3.0),
        back_end("batch", 1.0, 2.0, final_pose_nees=3.0),
    ]
    made = advice(*groups, which="final")
    assert made.recommendation.label == "EKF + RTS"
    assert re.match(
        r"On this robot the EKF \+ RTS is within 2\.3 % \[1\.4, 3\.1\] of full smoothing \(batch\) with",
        said(made, "answer"),
    )
    assert set(made.table["trajectory"]) == {"online", "final"}


def test_what_would_change_it_and_what_would_not():
    made = advice(
        *filters(1.0, 1.0),
        what_ifs=[
            ("twice the odometry noise", filters(1.5, 1.0)),
            ("half the landmarks", filters(1.0, 1.0)),
            ("half the loop closures", [group[:3] for group in filters(1.0, 1.0)]),
        ],
        untried=["twice the sensor noise"],
    )
    text = said(made, "change")
    assert text.startswith("What would change this: twice the odometry noise. Then it would be the right-")
    assert "Half the landmarks would not change this (12 runs)." in text
    assert "With half the loop closures, not enough runs to say which it would be (3 runs" in text
    assert "Not tried, for there was no time (--time-limit-s): twice the sensor noise." in text
    assert [changes(made.recommendation, each.recommendation) for each in made.what_ifs] == [
        True,
        False,
        None,
    ]
    assert "cannot be tried: the noise" in said(advice(*filters(), varied=False), "change")


def test_failures_are_named_with_their_reason():
    groups = filters()
    groups[3] = back_end("window of 10", 1.0, 4.0, failed=range(4), **NO_FINAL)
    text = said(advice(*groups, dropped={"batch": "timed out on the first trial (after 37 s)"}), "failed")
    assert text == (
        "Batch timed out on the first trial (after 37 s). "
        "A window of 10: 4 of 12 runs diverged (not positive definite)."
    )


def test_json_and_page_hold_every_sentence():
    made = advice(*filters(), what_ifs=[("half the <landmarks>", filters(1.5, 1.0))])
    told = json.loads(json.dumps(made.as_dict(), allow_nan=False))
    assert {
        "name",
        "mode",
        "verdict",
        "recommended",
        "best",
        "runs",
        "sentences",
        "back_ends",
        "what_if",
    } <= set(told)
    assert (told["mode"], told["verdict"], told["recommended"]) == (
        "online",
        "recommended",
        "right-invariant EKF",
    )
    assert told["what_if"][0]["changes"] is False
    assert [each["text"] for each in told["sentences"]] == str(made).split("\n")
    page = advice_html(made)
    assert "half the &lt;landmarks&gt;" in page.lower()
    assert page.count("<tr>") == 1 + len(made.table)
    assert "right-invariant EKF" in made._repr_html_()
    assert "<script" not in page


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        ((1.03, 1.01, 1.05), "3 % [1, 5]"),
        ((0.88, 0.85, 0.92), "12 % [8, 15]"),
        ((1.003, 1.002, 1.004), "0.3 % [0.2, 0.4]"),
        ((2.4, 2.1, 2.7), "2.40 times [2.10, 2.70]"),
        ((1.01, 0.98, 1.04), "1 % [−2, 4]"),
    ],
)
def test_percentages_of_a_ratio(ratio, text):
    assert percent(Interval(*ratio, 10)) == text


def test_signed_percentages_have_no_negative_nought():
    assert signed(Interval(0.9999, 0.98, 1.02, 10)) == "0 % [−2, 2]"
    assert signed(Interval(1.04, 1.01, 1.07, 10)) == "+4 % [1, 7]"


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        ((0.125, 0.12, 0.13), "at an eighth of the time"),
        ((0.5, 0.45, 0.55), "at half the time"),
        ((0.7, 0.6, 0.8), "at 0.7 of the time"),
        ((0.02, 0.01, 0.03), "at 1/50 of the time"),
        ((1.05, 1.04, 1.06), "in about the same time"),
        ((1.5, 0.9, 2.5), "in about the same time"),
        ((2.5, 2.4, 2.6), "at 2.5 times the time"),
        ((27.3, 20.0, 30.0), "at 27 times the time"),
    ],
)
def test_times_in_words(ratio, text):
    assert time_words(Interval(*ratio, 10)) == text
