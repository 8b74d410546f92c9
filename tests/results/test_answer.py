"""The sentence on top: tables whose answer is known, every number worked out again by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student

from slamcmp.metrics.statistics import Interval
from slamcmp.results.answers.against import comparisons
from slamcmp.results.answers.answer import answer
from slamcmp.results.answers.phrases import change_text, percent_text, share_text, tie_text, times_text
from slamcmp.results.judgements.summary import in_words, summary_table
from slamcmp.results.judgements.unfinished import unfinished_runs
from slamcmp.results.words import parameter_words, parameters_in_words
from tests.results.hand_made import results_of, runs

RNG = np.random.default_rng(14)
BASE = list(0.1 * np.exp(0.3 * RNG.normal(size=20)))
SPREAD = RNG.normal(size=20)
SPREAD = (SPREAD - SPREAD.mean()) / SPREAD.std(ddof=1)
HALF = float(student.ppf(0.975, 19)) / math.sqrt(20)
"""Of the interval of a mean of 20 logs of unit deviation."""


def scaled(factor: float, deviation: float) -> list[float]:
    """Errors whose ratio to BASE has this geometric mean, and logs with this standard deviation."""
    return [base * factor * math.exp(deviation * spread) for base, spread in zip(BASE, SPREAD, strict=True)]


def online_only(label: str, errors: list[float], **more: object) -> list[dict[str, object]]:
    return runs(label, errors, final_ate=math.nan, **more)


def test_a_tie_is_told_with_its_interval_and_the_number_of_seeds():
    results = results_of(online_only("EKF", BASE) + online_only("iSAM2", scaled(0.98, 0.06)))
    low, high = 0.98 * math.exp(-0.06 * HALF), 0.98 * math.exp(0.06 * HALF)
    bounds = f"[{100 * (1 - high):.0f}, {100 * (1 - low):.0f}]".replace("-", "−")
    assert bounds == "[−1, 5]"
    expected = "Online, iSAM2 is 2 % [−1, 5] better than EKF: no difference at 20 seeds."
    assert answer(results).sentences == (expected,)


@pytest.mark.parametrize(
    ("factor", "deviation", "text"),
    [
        (0.80, 0.06, "B is 20 % [18, 22] better than A at 20 seeds."),
        (1.25, 0.06, "B is 25 % [22, 29] worse than A at 20 seeds."),
        (3.00, 0.06, "B is 3.0 × worse than A at 20 seeds."),
        (3.00, 0.60, "B is 3.0 × [2.3, 4.0] worse than A at 20 seeds."),
        # Of a wide interval no tie follows: the seeds cannot tell.
        (1.10, 0.60, "B is 10 % [−17, 46] worse than A: no difference that 20 seeds can tell."),
        # A difference that is there is never rounded to none.
        (0.998, 0.0021, "B is 0.2 % [0.1, 0.3] better than A at 20 seeds."),
    ],
)
def test_who_is_better(factor, deviation, text):
    text_of_both = answer(results_of(online_only("A", BASE) + online_only("B", scaled(factor, deviation))))
    low, high = (factor * math.exp(sign * deviation * HALF) for sign in (-1, 1))
    (found,) = comparisons(
        results_of(online_only("A", BASE) + online_only("B", scaled(factor, deviation))), "online"
    )
    assert (found.ratio.low, found.ratio.high) == pytest.approx((low, high))
    assert text_of_both.text == f"Online, {text}"


def test_hindsight_shares_and_time_as_in_the_example():
    """Everybody ties online; hindsight halves the error, the RTS smoother gets four fifths of that gain."""

    def timed(label, online, final, seconds):
        return [
            {**row, "final_ate": value, "update_s": seconds, "estimate_s": 0.0}
            for row, value in zip(runs(label, online), final, strict=True)
        ]

    half = [0.48 * error for error in BASE]
    # What is left is 1 - 0.8 (1 - 0.48) of the online error.
    results = results_of(
        timed("EKF", BASE, [math.nan] * 20, 0.003)
        + timed("RTS", BASE, [(1 - 0.8 * 0.52) * error for error in BASE], 0.004)
        + timed("iSAM2", scaled(0.98, 0.06), half, 0.021)
    )
    median = float(np.median(BASE))
    assert answer(results).text == (
        "Online, RTS and iSAM2 against EKF: no difference at 20 seeds; with hindsight the error halves "
        f"({0.48 * median:.4f} against {median:.4f} m, iSAM2 final against EKF online), and RTS gets "
        "four fifths of that; EKF is 1.3 × faster than RTS and 7 × faster than iSAM2."
    )


def test_no_common_seeds_say_nothing():
    rows = runs("A", BASE[:12], tuple(range(6))) + runs("B", BASE[:12], tuple(range(6, 12)))
    text = answer(results_of(rows)).text
    assert "nothing can be said" in text
    assert "better" not in text
    assert "Failed, and in none of these numbers: A 6 of 12, B 6 of 12 runs." in text


def test_failures_are_counted_and_in_no_ratio():
    errors = scaled(0.8, 0.06)
    whole = results_of(online_only("A", BASE) + online_only("B", errors))
    rows = online_only("A", BASE, failed=(3, 5)) + online_only("B", errors, failed=(5, 7))
    found = answer(results_of(rows))
    (compared,) = comparisons(results_of(rows), "online")
    kept = [seed for seed in range(20) if seed not in (3, 5, 7)]
    logs = np.log([errors[seed] / BASE[seed] for seed in kept])
    assert compared.ratio.runs == 17
    assert compared.ratio.estimate == pytest.approx(math.exp(logs.mean()))
    assert "at 17 seeds." in found.sentences[0]
    assert found.sentences[1] == "Failed, and in none of these numbers: A 2 of 20, B 2 of 20 runs."
    assert len(answer(whole).sentences) == 1
    lines, more = unfinished_runs(results_of(rows))
    assert lines == [
        "A, seed 3: diverged",
        "A, seed 5: diverged",
        "B, seed 5: diverged",
        "B, seed 7: diverged",
    ]
    assert more == 0
    assert unfinished_runs(results_of(rows), most=1) == (lines[:1], 3)


def test_nothing_ended_well():
    rows = runs("A", BASE[:6], tuple(range(6)))
    assert answer(results_of(rows)).sentences == (
        "No run ended well: there is nothing to compare.",
        "Failed, and in none of these numbers: A 6 of 6 runs.",
    )


def test_one_seed_says_that_nothing_can_be_said():
    found = answer(results_of(runs("A", [0.2]) + runs("B", [0.01])))
    assert found.text == (
        "One seed: nothing can be said about which back end is better. "
        "On this one: online ATE A 0.200, B 0.0100 m; final ATE A 0.100, B 0.00500 m."
    )


@pytest.mark.parametrize("count", [2, 4])
def test_few_seeds_are_too_few(count):
    text = answer(results_of(runs("A", BASE[:count]) + runs("B", scaled(0.1, 0.0)[:count]))).text
    assert text.startswith(f"{count} seeds are too few to tell back ends apart (5 are needed)")
    assert "% " not in text


def test_one_recording_and_no_truth():
    rows = [{**row, "seed": pd.NA, "trial": 0} for row in runs("A", [0.2]) + runs("B", [0.1])]
    assert answer(results_of(rows)).text.startswith("One recording: nothing can be said")
    blind = [{**row, "online_ate": math.nan, "final_ate": math.nan, "reference": "none"} for row in rows]
    assert answer(results_of(blind)).text == (
        "There are no errors to compare: the log has no truth, and no reference was named."
    )


def test_different_measurements_are_no_pair():
    rows = online_only("A", BASE) + online_only("B", scaled(0.8, 0.06))
    spoilt = [{**row, "digest": "other"} if row["label"] == "B" and row["seed"] < 4 else row for row in rows]
    (found,) = comparisons(results_of([row for row in rows if row["seed"] >= 4]), "online")
    assert f"at {found.ratio.runs} seeds" in answer(results_of(spoilt)).text
    assert found.ratio.runs == 16


def test_a_warm_start_is_not_the_batch_solvers_own_online_answer():
    rows = runs("EKF", BASE) + runs("batch", scaled(0.5, 0.05))
    results = dataclasses.replace(
        results_of(rows), manifest={"config": {"back_ends": [{"name": "batch", "label": "batch"}]}}
    )
    assert comparisons(results, "online") == []
    assert not answer(results).text.startswith("Online")


def test_times_side_by_side_are_called_rough():
    rows = [
        {**row, "update_s": 0.003 if row["label"] == "A" else 0.03, "estimate_s": 0.0}
        for row in online_only("A", BASE) + online_only("B", BASE)
    ]
    alone = results_of(rows)
    busy = dataclasses.replace(alone, manifest={"jobs": 2})
    assert answer(alone).text.endswith("; A is 10 × faster than B.")
    assert "an order of magnitude: measured with 2 jobs side by side" in answer(busy).text


NOISE, WINDOW = "source.noise_scale", "back_ends.W.window"


def swept_rows() -> list[dict[str, object]]:
    """A tie at noise 1, B better at noise 2 and worse at 4."""
    rows = []
    for point, (noise, factor) in enumerate({1.0: 1.0, 2.0: 0.8, 4.0: 1.25}.items()):
        for label, errors in (("A", BASE), ("B", scaled(factor, 0.06))):
            rows += [
                {**row, NOISE: noise, "trial": 20 * point + row["seed"]} for row in online_only(label, errors)
            ]
    return rows


def test_a_sweep_has_a_line_per_back_end_with_what_differs_only():
    found = answer(results_of(swept_rows()))
    assert found.text == (
        "Online, over noise scale (1 to 4): B is better than A at 1 of 3 values and worse than A at 1 of 3 "
        "values (no difference told at 1)."
    )
    assert found.lines == (
        "B: online, against A: 20 % [18, 22] better at 2, 25 % [22, 29] worse at 4, no difference told at 1.",
    )


def test_a_parameter_that_only_one_back_end_has_repeats_nobody_elses_row():
    rows = []
    for point, window in enumerate((1, 5, 20)):
        for label, factor in (("A", 1.0), ("B", 0.8), ("W", 1.0 if window > 1 else 1.25)):
            rows += [
                {**row, WINDOW: window, "trial": 20 * point + row["seed"]}
                for row in online_only(label, scaled(factor, 0.06) if label != "A" else BASE)
            ]
    results = results_of(rows)
    table = summary_table(results)
    assert table["back end"].tolist() == ["A", "B", "W", "W", "W"]
    assert table[WINDOW].isna().tolist() == [True, True, False, False, False]
    assert table["runs"].tolist() == [20] * 5
    assert list(in_words(table).columns)[1] == "window of W"
    assert [(each.label, dict(each.point)) for each in comparisons(results, "online")] == [
        ("B", {}),
        ("W", {WINDOW: 1}),
        ("W", {WINDOW: 5}),
        ("W", {WINDOW: 20}),
    ]
    assert answer(results).lines[0].startswith("B: online, against A: 20 % [")
    assert answer(results).lines[1].endswith("worse at 1, no difference told at 5 and 20.")


def test_those_that_never_differ_are_told_together():
    rows = []
    for point, width in enumerate([0.5, 1.0, 2.0]):
        for label, factor in (("A", 1.0), ("B", 1.001), ("C", 0.999), ("D", 0.8)):
            errors = BASE if label == "A" else scaled(factor, 0.06)
            rows += [
                {**row, "source.turn_sigma_deg_s": width, "trial": 20 * point + row["seed"]}
                for row in online_only(label, errors)
            ]
    assert answer(results_of(rows)).text == (
        "Online, over turn sigma (0.5 to 2°/s): D is better than A at 3 of 3 values, "
        "B and C show no difference from A at any of 3 values."
    )


def test_of_many_only_the_first_and_the_ends_are_named():
    rows = [row for i, label in enumerate("ABCDEFG") for row in online_only(label, [0.5 - 0.05 * i])]
    assert answer(results_of(rows)).text.endswith(
        "On this one: online ATE A 0.500, of all 7 from 0.200 (G) to 0.500 (A) m."
    )
    blind = [{**row, "reference": "batch (final)"} for row in rows[:2]]
    assert "On this one, measured against batch (final),: online" not in answer(results_of(blind)).text
    assert "On this one, measured against batch (final): online ATE A" in answer(results_of(blind)).text


def test_two_parameters_are_named():
    rows = []
    for point, (noise, steps) in enumerate([(1.0, 10), (1.0, 20), (2.0, 10), (2.0, 20)]):
        for label, factor in (("A", 1.0), ("B", 0.8 if (noise, steps) == (2.0, 10) else 1.0)):
            errors = scaled(factor, 0.06) if label == "B" else BASE
            rows += [
                {**row, NOISE: noise, "source.steps": steps, "trial": 20 * point + row["seed"]}
                for row in online_only(label, errors)
            ]
    found = answer(results_of(rows))
    assert "over noise scale (1 and 2) and steps (10 and 20)" in found.text
    assert "better at (noise scale = 2, steps = 10)" in found.lines[0]


def test_one_seed_of_a_sweep():
    rows = [row for row in swept_rows() if row["seed"] == 0]
    assert answer(results_of(rows)).text == (
        "One seed: nothing can be said about which back end is better, at any value that was swept."
    )


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("source.range_sigma_m", "range sigma [m]"),
        ("source.bearing_sigma_deg", "bearing sigma [°]"),
        ("source.noise_scale", "noise scale"),
        ("front_end.gate_probability", "gate probability"),
        ("back_ends.iSAM2.relinearize_skip", "relinearize skip of iSAM2"),
        ("back_ends.v1.2.window", "window of v1.2"),
        ("source.m", "m"),
    ],
)
def test_names_of_parameters_in_words(path, words):
    assert parameter_words(path) == words


def test_two_parameters_of_one_name_say_their_section():
    found = parameters_in_words(["source.start", "front_end.start", "source.steps"])
    assert list(found.values()) == ["start (source)", "start (front end)", "steps"]


def test_phrases():
    assert percent_text(Interval(0.98, 0.95, 1.01, 20)) == "2 % [−1, 5]"
    assert percent_text(Interval(1.0, 1.0, 1.0, 20)) == "0 % [0, 0]"
    # Nobody wants 59.999 % [59.999, 60.000]; only the zero that is left out must not be rounded to.
    assert percent_text(Interval(0.400004, 0.400002, 0.400006, 20)) == "60 % [60, 60]"
    assert percent_text(Interval(0.98, 0.961, 0.9996, 20)) == "2.00 % [0.04, 3.90]"
    assert change_text(Interval(2.5, 2.4, 2.6, 20)) == "2.5 × worse"
    assert times_text(Interval(7.1, 6.9, 7.3, 20)) == "7 ×"
    assert times_text(Interval(7.1, 5.0, 9.9, 20)) == "7 × [5, 10]"
    assert share_text(Interval(0.81, 0.75, 0.86, 20)) == "four fifths"
    assert share_text(Interval(0.81, 0.55, 0.95, 20)) == "81 % [55, 95]"
    assert share_text(Interval(0.85, 0.83, 0.88, 20)) == "85 % [83, 88]"
    assert tie_text([Interval(1.0, 0.91, 1.09, 20)], "9 seeds") == "no difference at 9 seeds"
    assert tie_text([Interval(1.0, 0.85, 1.09, 20)], "9 seeds") == "no difference that 9 seeds can tell"
