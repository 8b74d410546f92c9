"""What is run, and when: the runner is replaced by one that only takes notes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import slamcmp
from slamcmp.advice import advise as advising
from slamcmp.advice.advise import _next_count, _samples
from slamcmp.advice.ladder import rungs
from slamcmp.errors import UsageError
from slamcmp.results.store import Results
from tests.advice.test_problem import WORLD, problem
from tests.results.hand_made import back_end, results_of

MS = {"dead reckoning": 0.01, "EKF": 0.2, "iSAM2": 2.0, "batch": 2.0}


class _Runner:
    """In place of the runner: tables of what was asked for, the EKF bad where the odometry is."""

    def __init__(self, timed_out=(), frames=3):
        self.asked, self.timed_out, self.frames = [], timed_out, frames

    def __call__(self, experiment, *, folder, **options):
        self.asked.append((str(folder), len(experiment.seeds), [each.label for each in experiment.back_ends]))
        rows = []
        for each in experiment.back_ends:
            bad = experiment.source.parameters.get("odometry_scale", 1.0) > 1 and each.label == "EKF"
            ratio = 8.0 if each.label == "dead reckoning" else 1.5 if bad else 1.0
            for row in back_end(each.label, ratio, MS.get(each.label, 0.5), seeds=len(experiment.seeds)):
                failed = each.label in self.timed_out
                row |= {
                    "status": "timed_out" if failed else "ok",
                    "message": "after 9 s",
                    "frames": self.frames,
                }
                rows.append(row)
        found = results_of(rows)
        return Results(folder, {"config": experiment.as_dict()}, found.trials, found.frames, found.landmarks)


@pytest.fixture
def ask(monkeypatch, tmp_path):
    def asked(runner, source=WORLD, **more):
        monkeypatch.setattr(advising, "run_experiment", runner)
        options = {"seeds": 12, "progress": False, "folder": tmp_path / "here", **more}
        return slamcmp.advise({"source": source, "seeds": [3, 1]}, **options)

    return asked


def test_a_first_trial_then_all_that_the_time_allows_then_the_same_otherwise(ask):
    runner = _Runner()
    made = ask(runner)
    assert [count for folder, count, _ in runner.asked if "what_if" not in folder] == [1, 1, 5, 12]
    assert runner.asked[0][2] == ["dead reckoning"]
    ladder = runner.asked[3][2]
    assert {"window of 5", "window of 10", "window of 20", "EKF + RTS", "batch"} <= set(ladder)
    varied = [(Path(folder).name, count) for folder, count, _ in runner.asked if "what_if" in folder]
    assert varied == [("odometry", 8), ("loops", 8), ("landmarks", 8), ("sensor", 8)]
    assert (made.recommendation.verdict, made.recommendation.label) == ("recommended", "EKF")
    text = str(made)
    assert "What would change this: twice the odometry noise. Then it would be " in text
    assert "Half the loop closures, half the landmarks and twice the sensor noise would not change" in text
    stored = json.loads((made.folder / "advice.json").read_text())
    assert stored == json.loads(json.dumps(made.as_dict(), default=str))
    assert [each["changes"] for each in stored["what_if"]] == [True, False, False, False]


def test_who_does_not_finish_the_first_trial_is_named_and_left(ask):
    runner = _Runner(timed_out=("window of 10", "iterated EKF"))
    made = ask(runner)
    assert "window of 10" in runner.asked[1][2]
    # Where 10 is too slow, 20 is, and nobody asks for 5.
    assert not {"window of 5", "window of 10", "window of 20", "iterated EKF"} & set(runner.asked[-1][2])
    assert "A window of 10 timed out on the first trial (after 9 s)." in str(made)
    assert set(made.as_dict()["not_tried_further"]) == {"window of 10", "iterated EKF"}


def test_a_stop_before_the_runner_takes_signals_is_one_line(ask):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    with pytest.raises(
        advising.Stopped, match=r"interrupted: what finished is in .*the same command"
    ) as found:
        ask(stopped)
    assert found.value.exit_code == 130


def test_long_logs_have_isam2_look_for_variables_now_and_then():
    short, long = ({each.label: each for each in rungs(long=long)} for long in (False, True))
    assert short["iSAM2"].parameters["relinearize_skip"] == 1
    assert long["iSAM2"].parameters == {"relinearize_skip": 10}


def test_hindsight_and_a_budget_are_passed_on(ask):
    made = ask(_Runner(), hindsight=True, budget_ms=1e-6)
    assert (made.recommendation.which, made.recommendation.verdict) == ("final", "none")
    assert "over the budget of 1.00e-06 ms" in str(made)
    assert made.as_dict()["mode"] == "hindsight"


@pytest.mark.parametrize(
    "wrong",
    [{"budget_ms": 0}, {"memory_mb": float("nan")}, {"seeds": 0}, {"seeds": 2.5}, {"time_limit_s": -1}],
)
def test_options_that_cannot_be_are_refused(wrong):
    with pytest.raises(UsageError, match=f"advise: {next(iter(wrong))} is a"):
        slamcmp.advise({"source": WORLD}, **wrong)
    with pytest.raises(UsageError, match="not int"):
        slamcmp.advise(3)


def test_samples_are_the_files_seeds_and_then_more():
    found = _samples(problem(seeds=[7, 2]), 4)
    assert [each.seeds for each in found] == [(7,), (7, 2), (7, 2, 8), (7, 2, 8, 9)]
    assert [each.seeds for each in _samples(problem(seeds=3), 2)] == [(0,), (0, 1)]
    alone = _samples(problem({"name": "victoria_park"}), 9)
    assert [each.seeds for each in alone] == [(None,)]


class _Left:
    def __init__(self, seconds):
        self.seconds = seconds

    def left(self, share=1.0):
        return self.seconds - 100.0 * (1.0 - share)


@pytest.mark.parametrize(
    ("done", "left_s", "cost_s", "count"),
    [
        (1, 100.0, 0.1, 5),  # five as soon as they can be afforded
        (5, 90.0, 0.1, 15),  # then three times as many
        (15, 80.0, 0.1, 20),  # up to what was asked for
        (5, 50.0, 3.0, 8),  # as far as the ladder's own share goes
        (2, 20.0, 8.0, 4),  # or, below five, all that is left
        (2, -5.0, 8.0, 2),
        (5, 30.0, 0.1, 5),
    ],
)
def test_how_many_samples_the_time_allows(done, left_s, cost_s, count):
    assert _next_count(done, 20, _Left(left_s), cost_s) == count
