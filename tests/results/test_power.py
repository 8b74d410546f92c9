"""Numbers of seeds against tables, against simulated experiments, and through the command line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from slamcmp.errors import DataError, UsageError
from slamcmp.metrics.statistics import ratio_test
from slamcmp.results.judgements.power import (
    paired_seeds,
    plan_seeds,
    simulated_paired_seeds,
    simulated_unpaired_seeds,
    unpaired_seeds,
)
from slamcmp.results.judgements.summary import paired_table
from slamcmp.results.store import Results, save_results


def pilot(
    folder: Path, seeds: int = 40, *, common: float = 1.0, own: float = 0.4, shift: float = 0.1
) -> Results:
    rng = np.random.default_rng(1)
    world = common * rng.normal(size=seeds)
    values = {"A": np.exp(world + own * rng.normal(size=seeds))}
    values["B"] = np.exp(shift + world + own * rng.normal(size=seeds))
    rows = [
        {
            "trial": seed,
            "label": label,
            "seed": seed,
            "status": "ok",
            "online_ate": float(values[label][seed]),
            "reference": "truth",
        }
        for seed in range(seeds)
        for label in ("A", "B")
    ]
    empty = pd.DataFrame({"trial": []})
    return Results(folder, {"name": "pilot", "config": {}}, pd.DataFrame(rows), empty, empty)


@pytest.mark.parametrize(
    # Sample sizes of the t test (Cohen 1988, table 2.4.1, and G*Power): effect, power, pairs, per group.
    ("effect", "power", "paired", "unpaired"),
    [(0.5, 0.8, 34, 64), (0.8, 0.8, 15, 26), (0.2, 0.8, 199, 394), (0.5, 0.9, 44, 86)],
)
def test_closed_forms_agree_with_the_tables(effect, power, paired, unpaired) -> None:
    assert abs(paired_seeds(1.0, effect, power) - paired) <= 1
    assert abs(unpaired_seeds(1.0, 1.0, effect, power) - unpaired) <= 1


def test_pairing_is_worth_the_common_spread(tmp_path: Path) -> None:
    (plan,) = plan_seeds(pilot(tmp_path), "online_ate", math.exp(0.25) - 1, relative=True)
    assert (plan.back_end, plan.compared_with, plan.pairs, plan.lost) == ("B", "A", 40, 0)
    table = np.log(pilot(tmp_path).trials.pivot(index="seed", columns="label", values="online_ate"))
    difference = table["B"] - table["A"]
    assert plan.ratio == pytest.approx(math.exp(difference.mean()))
    assert plan.goal == pytest.approx(math.exp(0.25))
    z = stats.norm.ppf([0.975, 0.8])
    assert plan.paired == np.ceil((z.sum() * difference.std() / 0.25) ** 2 + z[0] ** 2 / 2)
    gain = (table["A"].var() + table["B"].var()) / difference.var()
    assert plan.unpaired / plan.paired == pytest.approx(gain, rel=0.1)
    assert plan.correlation == pytest.approx(table.corr().iloc[0, 1])
    # 80 % of the chi-square distribution of the pilot's variance, 39 degrees of freedom.
    low, high = difference.std() * np.sqrt(39 / stats.chi2.ppf([0.9, 0.1], 39))
    assert (plan.paired_low, plan.paired_high) == (paired_seeds(low, 0.25), paired_seeds(high, 0.25))
    assert plan.paired_low < plan.paired < plan.paired_high


def test_the_planned_seeds_have_the_power() -> None:
    rng = np.random.default_rng(2)
    count = paired_seeds(1.0, 0.6)
    seen = stats.ttest_1samp(rng.normal(0.6, 1.0, size=(4000, count)), 0.0, axis=1).pvalue < 0.05
    # Four standard deviations of a share of 0.8 over 4000, and the ceiling's own gain.
    assert 0.775 < seen.mean() < 0.85
    count = unpaired_seeds(1.0, 0.5, 0.6)
    first, other = rng.normal(0.0, 1.0, (4000, count)), rng.normal(0.6, 0.5, (4000, count))
    seen = stats.ttest_ind(first, other, axis=1, equal_var=False).pvalue < 0.05
    assert 0.775 < seen.mean() < 0.85


def test_what_is_planned_is_what_the_report_tests(tmp_path: Path) -> None:
    """As many new seeds as planned: the report's p value is below 0.05 in four of five experiments."""
    (plan,) = plan_seeds(pilot(tmp_path, seeds=400), "online_ate", 0.25, relative=True)
    rng = np.random.default_rng(12)
    seen = []
    for _ in range(600):
        world = rng.normal(size=plan.paired)
        first = np.exp(world + 0.4 * rng.normal(size=plan.paired))
        other = 1.25 * np.exp(world + 0.4 * rng.normal(size=plan.paired))
        seen.append(ratio_test(other, first) < 0.05)
    # Four standard deviations of a share of 0.8 over 600, and what the pilot's own spread is off.
    assert 0.73 < np.mean(seen) < 0.88
    (row,) = paired_table(pilot(tmp_path)).to_dict("records")
    table = pilot(tmp_path).trials.pivot(index="seed", columns="label", values="online_ate")
    assert row["t test p"] == pytest.approx(stats.ttest_rel(*np.log(table[["B", "A"]]).to_numpy().T).pvalue)


def test_simulation_agrees_with_the_normal_limit_on_a_normal_pilot() -> None:
    rng = np.random.default_rng(3)
    sample = rng.normal(size=3000)
    sample = (sample - sample.mean()) / sample.std(ddof=1)
    assert simulated_paired_seeds(sample, 0.5) == pytest.approx(34, abs=2)
    assert simulated_unpaired_seeds(sample, rng.permutation(sample), 0.5) == pytest.approx(64, abs=4)
    assert simulated_paired_seeds(sample, 0.5) == simulated_paired_seeds(sample, 0.5)


def test_the_simulation_keeps_the_pilots_spread_and_not_its_mean() -> None:
    """A pilot that happened to differ by a lot says nothing about the difference that shall be seen."""
    sample = np.random.default_rng(4).normal(size=200)
    moved = simulated_paired_seeds(sample + 5.0, 0.5)
    assert (
        moved == simulated_paired_seeds(sample, 0.5) == pytest.approx(paired_seeds(sample.std(), 0.5), abs=3)
    )
    apart = simulated_unpaired_seeds(sample, sample[::-1] + 5.0, 0.5)
    assert apart == simulated_unpaired_seeds(sample, sample[::-1], 0.5)


def test_relative_difference_and_failed_runs(tmp_path: Path) -> None:
    results = pilot(tmp_path)
    trials = results.trials.copy()
    trials.loc[[0, 3], "status"] = "diverged"
    (plan,) = plan_seeds(replace(results, trials=trials), "online_ate", 0.1, relative=True)
    assert (plan.pairs, plan.lost) == (38, 2)
    kept = trials[(trials["label"] == "A") & (trials["trial"] > 1)]["online_ate"]
    assert plan.goal == pytest.approx(1.1)
    assert plan.difference == pytest.approx(0.1 * stats.gmean(kept))
    (same,) = plan_seeds(replace(results, trials=trials), "online_ate", plan.difference)
    assert (same.goal, same.paired) == (pytest.approx(1.1), plan.paired)


def test_swept_points_are_planned_apart(tmp_path: Path) -> None:
    parts = [pilot(tmp_path, own=own).trials.assign(**{"source.noise": own}) for own in (0.2, 0.4)]
    parts[1]["trial"] += 40
    results = replace(pilot(tmp_path), trials=pd.concat(parts, ignore_index=True))
    first, second = plan_seeds(results, "online_ate", 0.25)
    assert (first.point, second.point) == ({"source.noise": 0.2}, {"source.noise": 0.4})
    assert second.paired > 3 * first.paired


def test_what_cannot_be_planned_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no metric 'online_at'; did you mean 'online_ate'"):
        plan_seeds(pilot(tmp_path), "online_at", 0.1)
    with pytest.raises(UsageError, match="above 0"):
        plan_seeds(pilot(tmp_path), "online_ate", 0.0)
    with pytest.raises(UsageError, match="a difference of 1e-12 cannot be seen: the ratio of 'B'"):
        plan_seeds(pilot(tmp_path), "online_ate", 1e-12)
    results = pilot(tmp_path)
    none = replace(results, trials=results.trials.assign(online_ate=results.trials["online_ate"] - 0.5))
    with pytest.raises(UsageError, match=r"'online_ate' is not above 0 in \d+ of 40 seeds"):
        plan_seeds(none, "online_ate", 0.1)
    with pytest.raises(DataError, match=r"share 5 finished seeds with 'online_ate' \(at most 4\)"):
        plan_seeds(pilot(tmp_path, seeds=4), "online_ate", 0.1)


def slamcmp(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "slamcmp", *arguments], cwd=cwd, capture_output=True, text=True
    )


def test_command_line(tmp_path: Path) -> None:
    results = pilot(tmp_path / "results" / "mine")
    results.folder.mkdir(parents=True)
    save_results(results)
    (expected,) = plan_seeds(results, "online_ate", 0.25)
    said = slamcmp("seeds", "mine", "--metric", "online_ate", "--difference", "0.25", cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    assert f"paired:   {expected.paired} seeds (simulated {expected.paired_simulated};" in said.stdout
    assert f"unpaired: {expected.unpaired} seeds a back end" in said.stdout
    arguments = ["seeds", "results/mine", "--metric", "online_ate", "--difference", "0.25", "--json"]
    (plan,) = json.loads(slamcmp(*arguments, cwd=tmp_path).stdout)["plans"]
    assert plan["paired"] == expected.paired
    lost = slamcmp("seeds", "quickstart", "--metric", "online_ate", "--difference", "1", cwd=tmp_path)
    assert lost.returncode == 3
    assert "no pilot yet; run one with 10 or more seeds: slamcmp run quickstart" in lost.stderr
