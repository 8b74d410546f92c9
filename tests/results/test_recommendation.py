"""The rule on tables made by hand, where everybody can see what it has to say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from slamcmp.results.answers.candidates import consistency_of, find_candidates, student_interval
from slamcmp.results.answers.recommendation import recommend
from tests.results.hand_made import SEEDS, back_end, results_of, table


def test_a_clear_win_is_the_cheapest_one_within():
    found = recommend(
        table(
            back_end("EKF", 1.3, 0.1),
            back_end("RI", 1.01, 0.2),
            back_end("window", 1.01, 3.0),
            back_end("iSAM2", 1.0, 2.0),
        )
    )
    assert (found.verdict, found.label, found.best) == ("recommended", "RI", "iSAM2")
    assert [each.label for each in found.choices] == ["EKF", "RI", "iSAM2", "window"]
    assert [each.distance for each in found.choices] == ["beyond", "within", "within", "within"]
    ratio = found.of("RI").ratio
    assert 1.0 < ratio.estimate < 1.02
    assert ratio.high < 1.05
    assert ratio.runs == SEEDS


def test_of_a_tie_the_cheapest_is_taken():
    found = recommend(table(back_end("EKF", 1.0, 0.1), back_end("RI", 1.0, 0.2), back_end("iSAM2", 1.0, 2.0)))
    assert (found.verdict, found.label) == ("recommended", "EKF")
    assert {each.distance for each in found.choices} == {"within"}


def test_an_overconfident_winner_is_passed_over_and_stays_the_yardstick():
    found = recommend(
        table(back_end("EKF", 1.0, 0.1, nees=9.0), back_end("RI", 1.02, 0.2), back_end("iSAM2", 1.3, 2.0))
    )
    assert (found.verdict, found.label, found.best) == ("recommended", "RI", "EKF")
    assert found.of("EKF").reason.startswith("overconfident")
    assert found.of("iSAM2").distance == "beyond"
    # With nobody else near, the answer is nobody, not the least bad.
    alone = recommend(table(back_end("EKF", 1.0, 0.1, nees=9.0), back_end("iSAM2", 1.3, 2.0)))
    assert (alone.verdict, alone.label) == ("none", None)
    assert "EKF: overconfident" in alone.reason
    assert "iSAM2: more than 5 % above the best" in alone.reason


def test_where_all_fail_there_is_nobody_and_the_reasons():
    found = recommend(
        table(
            back_end("EKF", 1.0, 0.1, failed=range(SEEDS)), back_end("iSAM2", 1.0, 2.0, failed=range(SEEDS))
        )
    )
    assert (found.verdict, found.label, found.best) == ("none", None, None)
    assert "EKF: 12 of 12 runs failed (diverged: not positive definite)" in found.reason


def test_one_failure_in_a_dozen_is_too_many():
    """Its mean is over the runs that it survived."""
    found = recommend(table(back_end("EKF", 0.8, 0.1, failed=[3]), back_end("iSAM2", 1.0, 2.0)))
    assert (found.label, found.best) == ("iSAM2", "iSAM2")
    assert "1 of 12 runs failed" in found.of("EKF").reason


@pytest.mark.parametrize("seeds", [1, 4])
def test_a_few_runs_say_nothing(seeds):
    found = recommend(table(back_end("EKF", 1.0, 0.1, seeds=seeds), back_end("iSAM2", 1.0, 2.0, seeds=seeds)))
    assert (found.verdict, found.label) == ("not enough runs to say", None)
    assert found.best is not None
    assert f"{seeds} run" in found.reason


def test_a_cheaper_one_that_may_be_within_leaves_it_open():
    wide = np.exp(0.08 * np.random.default_rng(1).normal(size=SEEDS))
    found = recommend(
        table(
            back_end("EKF", 1.06, 0.1, noise=wide / np.exp(np.log(wide).mean())),
            back_end("RI", 1.01, 0.2),
            back_end("iSAM2", 1.0, 2.0),
        )
    )
    # RI is safe, but whether it is the cheapest, the runs do not tell.
    assert (found.verdict, found.label, found.undecided) == ("not enough runs to say", "RI", ("EKF",))
    assert 1.0 < found.of("EKF").ratio.low < 1.05 < found.of("EKF").ratio.high


def test_a_budget_of_time_or_memory_moves_the_yardstick():
    rows = table(back_end("EKF", 1.3, 0.1), back_end("RI", 1.1, 0.2), back_end("iSAM2", 1.0, 2.0))
    # 95 of 100 frames take up to twice the mean.
    found = recommend(rows, budget_ms=1.0)
    assert (found.verdict, found.label, found.best) == ("recommended", "RI", "RI")
    assert found.of("iSAM2").reason == "over the budget of 1.00 ms (4.00 ms in 95 of 100 frames)"
    assert recommend(rows, budget_ms=0.1).verdict == "none"
    assert recommend(rows, budget_ms=0.1).best is None
    assert recommend(rows, budget_ms=0.3).label == "EKF"
    assert recommend(rows, memory_mb=9.0).verdict == "none"
    assert "over the memory of 9.00 MB (10.0 MB)" in recommend(rows, memory_mb=9.0).reason


def test_hindsight_takes_final_errors_and_counts_the_final_solution():
    rows = table(
        back_end("EKF", 1.0, 0.1, final_ate=math.nan),
        back_end("EKF + RTS", 1.0, 0.2, final_pose_nees=3.0),
        back_end("batch", 0.99, 2.0, final_pose_nees=3.0),
    )
    found = recommend(rows, which="final")
    # The filter without hindsight stands with its online error, twice the final one of the others.
    assert [each.candidate.which for each in found.choices] == ["online", "final", "final"]
    assert (found.verdict, found.label) == ("recommended", "EKF + RTS")
    assert found.of("EKF").ratio.estimate == pytest.approx(2.0, rel=0.05)
    # 3 frames, a final solution of 3 ms.
    assert found.of("EKF + RTS").candidate.cost_ms == pytest.approx(0.2 + 1.0)


def test_who_borrows_an_estimate_or_knows_the_truth_is_no_candidate():
    rows = table(back_end("batch", 1.0, 2.0), back_end("ideal", 1.0, 0.1), back_end("EKF", 1.0, 0.2))
    names = [{"name": "batch", "label": "batch"}, {"name": "ekf_ideal", "label": "ideal"}]
    rows = replace(rows, manifest={"config": {"back_ends": names}})
    assert [each.label for each in find_candidates(rows)] == ["EKF"]
    assert [each.label for each in find_candidates(rows, which="final")] == ["batch", "EKF"]
    solved = replace(rows, manifest={"config": {"back_ends": [{**names[0], "every": 1}]}})
    assert "batch" in [each.label for each in find_candidates(solved)]


def test_a_grid_point_is_judged_by_its_own_rows():
    far = [{**row, "source.x": 2.0, "trial": row["seed"] + 50} for row in back_end("EKF", 2.0, 0.1)]
    near = [{**row, "source.x": 1.0} for row in back_end("EKF", 1.0, 0.1)]
    same = [
        {**row, "source.x": x, "trial": row["seed"] + 50 * (x == 2.0)}
        for x in (1.0, 2.0)
        for row in back_end("iSAM2", 1.0, 2.0)
    ]
    rows = table(near, far, same)
    assert recommend(rows, point={"source.x": 1.0}).label == "EKF"
    assert recommend(rows, point={"source.x": 2.0}).label == "iSAM2"


def test_an_overconfidence_that_the_last_frame_has_overcome_is_seen():
    rows = pd.DataFrame(back_end("EKF", 1.0, 0.1, nees=6.0)).assign(trial=range(SEEDS))
    frames = pd.DataFrame(
        {"trial": range(SEEDS), "label": "EKF", "k": 9, "online_nees": np.linspace(2.5, 3.5, SEEDS)}
    )
    found = consistency_of(_results(rows, frames), rows, "online")
    assert found.verdict == "overconfident"
    assert "NEES 3.00 at the last frame" in found.text
    honest = rows.assign(online_pose_nees=rows["online_pose_nees"] / 2)
    assert consistency_of(_results(honest, frames), honest, "online").verdict == "consistent"


def _results(rows, frames):
    return results_of(rows.to_dict("records"), frames)


def test_the_runs_means_blame_an_honest_filter_seldom():
    """Mean NEES of correlated frames: chi-square of few degrees of freedom, far from normal."""
    samples = 3.0 * np.random.default_rng(5).chisquare(6, size=(4000, 8)) / 6
    blamed = np.mean([student_interval(sample).low > 3.0 for sample in samples])
    # 2.5 % is what a two-sided 95 % interval allows; of values skewed to the right it is less.
    assert blamed < 0.02
    # Errors twice as large in square as claimed it sees in most cases, with eight runs.
    assert np.mean([student_interval(2.0 * sample).low > 3.0 for sample in samples]) > 0.5
    assert math.isnan(student_interval(samples[0, :4]).low)


def test_without_truth_innovations_can_accuse_and_never_acquit():
    def one_run(level, frames=400):
        nis = pd.DataFrame({"label": "EKF", "trial": 0, "k": range(frames), "nis_dof": 2.0})
        nis["nis"] = level * np.random.default_rng(2).chisquare(2, frames)
        rows = pd.DataFrame(
            [{"status": "ok", "label": "EKF", "trial": 0, "nis_per_dof": nis["nis"].sum() / (2 * frames)}]
        )
        return consistency_of(results_of([{}], nis), rows, "online")

    assert (one_run(1.0).verdict, one_run(1.0).evidence) == ("not known", "innovations")
    assert one_run(1.5).verdict == "overconfident"
    # Too short to cut into blocks: the value is told, nobody is accused.
    assert one_run(1.5, 50).verdict == "not known"
    rows = pd.DataFrame([{"status": "ok", "label": "EKF", "trial": 0}])
    assert consistency_of(results_of([{}]), rows, "online").evidence == ""


def test_the_best_by_luck_is_not_within_by_being_the_best():
    """Its own ratio is 1; what counts is its interval against the others, and theirs against it."""
    wide = np.exp(0.2 * np.random.default_rng(1).normal(size=SEEDS))
    found = recommend(
        table(
            back_end("EKF", 0.99, 0.1, noise=wide / np.exp(np.log(wide).mean())),
            back_end("RI", 1.01, 0.2),
            back_end("iSAM2", 1.0, 2.0),
        )
    )
    assert (found.best, found.verdict, found.label) == ("EKF", "not enough runs to say", None)
    assert found.undecided == ("EKF", "RI", "iSAM2")
    ekf = found.of("EKF")
    assert (ekf.ratio.low, ekf.ratio.high) == (1.0, 1.0)
    assert (ekf.distance, ekf.against) == ("undecided", "iSAM2")
    assert ekf.nearest.low < 1.0 < 1.05 < ekf.nearest.high
