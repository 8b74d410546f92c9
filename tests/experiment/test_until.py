"""``until``: seeds in batches until intervals are narrow, the same when resumed, and honest about it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment import runner
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.schema import experiment_schema
from slamcmp.experiment.config.stop_rule import StopRule
from slamcmp.experiment.planning.plan import plan_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.experiment.stop_search import describe_stop, precisions, search_coverage
from slamcmp.metrics.statistics import median_interval
from slamcmp.results.store import load_results
from tests.conftest import PLUGINS

Write = Callable[..., Path]


def table(**values: list[float]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"point": 0, "label": label, "seed": seed, "value": value}
            for label, column in values.items()
            for seed, value in enumerate(column)
        ]
    )


def test_every_back_end_must_be_known_well_enough() -> None:
    rule = StopRule(metric="online_ate", half_width=2.0)
    values = table(a=[1.0, 2, 3, 4, 5, 6], b=[10.0, 20, 30, 40, 50, 60], c=[math.nan] * 6)
    first, second = precisions(rule, values, ["a", "b", "c"])
    # Six runs: smallest to largest.
    assert (first.label, first.interval.half_width, first.goal, first.enough) == ("a", 2.5, 2.0, False)
    assert (second.label, second.interval.half_width) == ("b", 25.0)
    about = describe_stop(rule, [first, second], 6)
    assert about["reached"] is False
    assert about["reason"] == (
        "2 of 2 intervals are too wide after 6 seeds; the widest: b, ±25 where ±2 is asked for"
    )
    relative = StopRule(metric="online_ate", half_width=0.8, relative=True)
    assert [(each.goal, each.enough) for each in precisions(relative, values, ["a", "b"])] == [
        (pytest.approx(2.8), True),
        (pytest.approx(28.0), True),
    ]


def test_differences_are_paired_with_the_first_back_end() -> None:
    values = table(a=[1.0, 2, 3, 4, 5, 6, 7], b=[2.0, 3, 4, 5, 6, 7.5, math.nan])
    (found,) = precisions(StopRule(metric="m", half_width=0.3, of="difference"), values, ["a", "b"])
    assert found.name == "b against a"
    assert (found.interval.estimate, found.interval.low, found.interval.high) == (1.0, 1.0, 1.5)
    assert found.enough
    rule = StopRule(metric="m", half_width=0.3, of="difference", relative=True)
    (found,) = precisions(rule, values, ["a", "b"])
    # Ratios 2, 1.5, 4/3, 1.25, 1.2, 1.25.
    assert (found.interval.low, found.interval.high) == (1.2, 2.0)
    assert found.goal == pytest.approx(0.3 * (1.25 + 4 / 3) / 2)
    assert not found.enough


def test_no_value_at_all_ends_the_search() -> None:
    rule = StopRule(metric="final_ate", half_width=1.0)
    found = precisions(rule, table(a=[math.nan] * 10), ["a"])
    assert found == []
    assert "more seeds would not help" in describe_stop(rule, found, 10)["reason"]


def simulated_search(batch: int, goal: float, searches: int, sigma: float = 0.5) -> tuple[float, float]:
    """Coverage and usual length of searches, one by one with the interval itself."""
    rng = np.random.default_rng(11)
    covered, seeds = [], []
    for _ in range(searches):
        sample = np.exp(sigma * rng.normal(size=400))
        for count in range(batch, 401, batch):
            interval = median_interval(sample[:count])
            if interval.half_width <= goal * interval.estimate:
                break
        covered.append(interval.low <= 1.0 <= interval.high)
        seeds.append(count)
    return float(np.mean(covered)), float(np.median(seeds))


def test_stopping_by_width_costs_as_much_coverage_as_is_told() -> None:
    covered, seeds = simulated_search(10, 0.15, 1500)
    assert 30 < seeds < 90
    # Nominal 0.95; four standard deviations (0.006) below 0.93.
    assert 0.906 < covered < 0.97
    assert search_coverage(10, 0.95, round(seeds)) == pytest.approx(covered, abs=0.03)
    rule = StopRule(metric="m", half_width=1.0, of="each")
    for goal, told in ((0.1, None), (9.0, search_coverage(10, 0.95, 70))):
        found = [replace(each, goal=goal) for each in precisions(rule, table(a=[1.0, 2, 3, 4, 5, 6]), ["a"])]
        assert describe_stop(rule, found, 70)["coverage"] == told
    assert search_coverage(2, 0.95, 66) < search_coverage(20, 0.95, 66)
    assert search_coverage(10, 0.8, 70) < 0.85
    # Too few for an interval, and a batch that is the whole search.
    assert search_coverage(2, 0.95, 4) is None
    assert search_coverage(1000, 0.95, 1000) > 0.93


@pytest.mark.slow
@pytest.mark.parametrize(("batch", "low", "high"), [(2, 0.92, 0.97), (5, 0.92, 0.97), (20, 0.94, 0.97)])
@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.0])
def test_coverage_of_searches_is_what_the_help_says(
    batch: int, low: float, high: float, sigma: float
) -> None:
    for goal in (0.3, 0.5) if sigma == 1.0 else (0.15, 0.2):
        covered, seeds = simulated_search(batch, goal * sigma / 0.5 if sigma < 1 else goal, 4000, sigma)
        # Three standard deviations of a share over 4000.
        assert low - 0.012 < covered < high + 0.012, (goal, seeds)


def sweep_of(write: Write, **until: object) -> Path:
    return write(
        back_ends=["DeadReckoning", "Hindsight"],
        source={"name": f"{PLUGINS}:straight", "steps": 5},
        until={"metric": "online_ate", "batch": 6, **until},
    )


def test_seeds_are_added_until_the_interval_is_narrow(write_experiment: Write, tmp_path: Path) -> None:
    path = sweep_of(write_experiment, half_width=0.35, relative=True, max_seeds=60)
    results = run_experiment(path, folder=tmp_path / "r", executor="serial")
    about = results.manifest["until"]
    count = about["seeds"]
    assert about["reached"] is True
    assert 6 < count < 60
    assert count % 6 == 0
    assert results.manifest["seeds"] == list(range(count)) == sorted(set(results.trials["seed"]))
    ate = results.trials[results.trials["label"] == "DeadReckoning"]["online_ate"]
    before, after = median_interval(ate[: count - 6]), median_interval(ate)
    assert before.half_width > 0.35 * before.estimate
    assert after.half_width <= 0.35 * after.estimate
    assert (about["intervals"][0]["low"], about["intervals"][0]["high"]) == (after.low, after.high)
    assert results.manifest["jobs_run"] == 3 * count
    # Nothing is left to run, and the answer is the same.
    again = run_experiment(path, folder=tmp_path / "r", executor="serial")
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 2 * count)
    assert again.manifest["until"] == about
    assert load_results(tmp_path / "r").manifest["until"] == about
    # A narrower goal goes on from there.
    narrower = sweep_of(write_experiment, half_width=0.01, relative=True, max_seeds=count + 4)
    more = run_experiment(narrower, folder=tmp_path / "r", executor="serial")
    assert (more.manifest["jobs_run"], more.manifest["until"]["seeds"]) == (3 * 4, count + 4)
    assert more.manifest["until"]["reached"] is False
    assert "intervals are too wide" in more.manifest["until"]["reason"]


def test_an_interrupted_search_goes_on_where_it_was(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = sweep_of(write_experiment, half_width=1e-6, max_seeds=12)
    finish = Schedule._finish
    ended = []

    def interrupt_in_the_second_round(self, how) -> None:
        finish(self, how)
        ended.append(how)
        if len(ended) == 3 * 6 + 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Schedule, "_finish", interrupt_in_the_second_round)
        with pytest.raises(runner.Interrupted):
            run_experiment(path, folder=tmp_path / "r", jobs=1)
    about = load_results(tmp_path / "r").manifest
    assert (about["until"]["reached"], about["until"]["reason"]) == (False, "interrupted")
    assert (about["jobs_run"], about["jobs_missing"]) == (3 * 6 + 4, 3 * 6 - 4)
    rest = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert rest.manifest["jobs_run"] == 3 * 6 - 4
    assert rest.manifest["until"]["seeds"] == 12
    fresh = run_experiment(path, folder=tmp_path / "fresh", jobs=1)
    assert fresh.manifest["until"] == rest.manifest["until"]


def test_failing_runs_are_tried_once_a_session(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(
        back_ends=["DeadReckoning", "Raises"],
        until={"metric": "online_ate", "batch": 2, "half_width": 1e-9, "max_seeds": 6},
    )
    first = run_experiment(path, folder=tmp_path / "r", executor="serial")
    assert first.manifest["jobs_run"] == 3 * 6
    again = run_experiment(path, folder=tmp_path / "r", executor="serial", rerun_failed=True)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (6, 6)
    labels = {each["label"] for each in again.manifest["until"]["intervals"]}
    assert labels == {"DeadReckoning"}


def test_a_source_that_fails_ends_the_search(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(
        back_ends=["DeadReckoning"],
        source={"name": f"{PLUGINS}:broken_source"},
        until={"metric": "online_ate", "batch": 2, "half_width": 1.0},
    )
    results = run_experiment(path, folder=tmp_path / "r", executor="serial")
    assert len(results.trials) == 2
    assert results.manifest["until"]["reached"] is False
    assert all("ZeroDivisionError" in message for message in results.trials["message"])


def test_plan_and_single_seeds_do_without_the_search(write_experiment: Write, tmp_path: Path) -> None:
    experiment = load_experiment(sweep_of(write_experiment, half_width=0.1))
    assert experiment.seeds == (0, 1, 2, 3, 4, 5)
    assert len(plan_experiment(experiment, tmp_path / "r").trials) == 6
    results = run_experiment(experiment, folder=tmp_path / "r", executor="serial", seeds=[7])
    assert "until" not in results.manifest
    assert results.manifest["seeds"] == [7]


def test_given_seeds_come_first(write_experiment: Write) -> None:
    path = write_experiment(
        back_ends=["DeadReckoning"],
        seeds=[3, 9],
        until={"metric": "online_ate", "batch": 3, "half_width": 1.0, "max_seeds": 4},
    )
    experiment = load_experiment(path)
    assert experiment.seeds == (3, 9)
    assert experiment.with_more_seeds().seeds == (3, 9, 10, 11)


@pytest.mark.parametrize(
    ("line", "place", "part"),
    [
        ("{metric: online_at, half_width: 1}", "3:17", "no metric 'online_at'; did you mean 'online_ate'?"),
        ("{metric: online_ate, half_width: 0}", "3:41", "half_width: input should be greater than 0, not 0"),
        ("{metric: online_ate}", "3:8", "key 'half_width' is missing"),
        ("{metric: online_ate, half_with: 1}", "3:29", "did you mean 'half_width'?"),
        (
            "{metric: online_ate, half_width: 1, max_seeds: 4}",
            "3:55",
            "fewer than the 10 seeds to begin with",
        ),
        ("{metric: online_ate, half_width: 1, of: difference}", "3:48", "at least two back ends"),
        ("{metric: online_ate, half_width: 1, of: ech}", "3:48", "did you mean 'each'?"),
    ],
)
def test_mistakes_have_their_place(tmp_path: Path, line: str, place: str, part: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"source: {{name: circle}}\nback_ends: [{{name: ekf_slam}}]\nuntil: {line}\n")
    with pytest.raises(UsageError) as caught:
        load_experiment(path)
    assert any(
        each.startswith(f"{path}:{place}: ") and part in each for each in str(caught.value).splitlines()
    ), str(caught.value)


def test_recorded_data_has_no_seeds_to_add(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "source: {name: victoria_park}\nback_ends: [{name: ekf_slam}]\n"
        "until: {metric: online_ate, half_width: 1}\n"
    )
    with pytest.raises(UsageError, match="3:8: until: the source is recorded data: it has no seeds to add"):
        load_experiment(path)


def test_schema_has_the_rule() -> None:
    schema = json.loads(json.dumps(experiment_schema()))
    rule = schema["$defs"]["StopRule"]["properties"]
    assert rule["half_width"]["exclusiveMinimum"] == 0
    assert rule["of"]["enum"] == ["each", "difference"]
    assert {"$ref": "#/$defs/StopRule"} in schema["properties"]["until"]["anyOf"]
