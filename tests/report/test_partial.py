"""Interrupted and damaged experiments: what is missing is said everywhere; back ends share their seeds."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.report.cautions import cautions
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.html import report_html
from slamcmp.results.judgements.certainty import certainty_table
from slamcmp.results.judgements.summary import paired_table, summary_table, terminal_table
from slamcmp.results.partial import comparable, missing_runs
from slamcmp.results.store import Results, load_results, save_results

NOISES = (0.5, 1.0, 2.0)
LABELS = ("ekf", "isam2", "batch")


def configured(results: Results) -> Results:
    """With the configuration that asks for these runs."""
    config = {
        "back_ends": [{"name": label, "label": label} for label in LABELS],
        "sweep": {"source.range_sigma_m": list(NOISES)},
        "seeds": list(range(6)),
        "figures": ["sweep"],
    }
    return replace(results, manifest={**results.manifest, "config": config, "seeds": list(range(6))})


def without(results: Results, noise: float, label: str, seeds: set[int]) -> Results:
    """As if these runs had not been made."""

    def kept(table: pd.DataFrame) -> pd.DataFrame:
        lost = table["seed"].isin(seeds) & (table["label"] == label)
        return table[~(lost & (table["source.range_sigma_m"] == noise))]

    return replace(
        results,
        trials=kept(results.trials),
        frames=kept(results.frames),
        landmarks=kept(results.landmarks),
    )


@pytest.fixture
def whole(swept: Results) -> Results:
    """Three noise levels, six seeds, three back ends."""
    return configured(swept)


@pytest.fixture
def partial(whole: Results) -> Results:
    """Of noise 1, ``ekf`` lacks seeds 4 and 5, and ``isam2`` seed 5; at noise 2 ``batch`` has none."""
    results = without(whole, 1.0, "ekf", {4, 5})
    results = without(results, 1.0, "isam2", {5})
    return without(results, 2.0, "batch", set(range(6)))


def test_a_whole_experiment_is_left_as_it_is(whole: Results) -> None:
    assert missing_runs(whole) is None
    assert comparable(whole) is whole
    assert "missing" not in summary_table(whole)
    assert "Not complete" not in [caution.title for caution in cautions(whole)]


def test_the_missing_runs_are_counted_and_named(partial: Results) -> None:
    missing = missing_runs(partial)
    assert missing is not None
    named = {(row["source.range_sigma_m"], row["label"], row["seed"]) for _, row in missing.runs.iterrows()}
    assert named == {(1.0, "ekf", 4), (1.0, "ekf", 5), (1.0, "isam2", 5)} | {
        (2.0, "batch", seed) for seed in range(6)
    }
    assert (missing.asked, missing.trials, missing.compared) == (54, 18, 16)
    assert missing.sentence() == (
        "not complete: 9 of 54 runs are missing (ekf: seed 4 at range sigma = 1 m, "
        "seed 5 at range sigma = 1 m; isam2: seed 5 at range sigma = 1 m; "
        "batch: seed 0 at range sigma = 2 m, seed 1 at range sigma = 2 m, "
        "seed 2 at range sigma = 2 m, seed 3 at range sigma = 2 m, "
        "seed 4 at range sigma = 2 m, seed 5 at range sigma = 2 m); "
        "back ends are compared on the 16 of 18 trials that all of them have"
    )


def test_medians_are_over_the_seeds_that_all_back_ends_have(whole: Results, partial: Results) -> None:
    table = summary_table(partial).set_index(["source.range_sigma_m", "back end"])
    trials = whole.trials
    at_one = trials[(trials["source.range_sigma_m"] == 1.0) & (trials["seed"] < 4)]
    for label in LABELS:
        assert table.loc[(1.0, label), "runs"] == 4
        expected = float(np.median(at_one.loc[at_one["label"] == label, "online_ate"]))
        assert table.loc[(1.0, label), "online ATE [m]"] == expected
    assert table["missing"].to_dict() == {
        (0.5, "ekf"): 0, (0.5, "isam2"): 0, (0.5, "batch"): 0,
        (1.0, "ekf"): 2, (1.0, "isam2"): 1, (1.0, "batch"): 0,
        (2.0, "ekf"): 0, (2.0, "isam2"): 0,
    }  # fmt: skip
    # What is whole stays as it is.
    before = summary_table(whole).set_index(["source.range_sigma_m", "back end"])
    for key in [(0.5, "ekf"), (0.5, "batch"), (2.0, "isam2")]:
        assert table.loc[key, "online ATE [m]"] == before.loc[key, "online ATE [m]"]


def test_every_table_uses_the_same_seeds(partial: Results) -> None:
    sure = certainty_table(partial)
    assert set(sure.loc[sure["source.range_sigma_m"] == 1.0, "runs"]) == {4}
    pairs = paired_table(partial)
    assert set(pairs.loc[pairs["source.range_sigma_m"] == 1.0, "pairs"]) == {4}
    shown = terminal_table(partial)
    assert set(shown.loc[shown["source.range_sigma_m"] == 1.0, "runs"]) == {4}


@pytest.mark.parametrize("status", ["missing", "killed"])
def test_rows_that_only_say_so_count_as_missing(whole: Results, status: str) -> None:
    trials = whole.trials.copy()
    lost = (trials["label"] == "ekf") & (trials["seed"] == 2)
    trials.loc[lost, "status"] = status
    results = replace(whole, trials=trials)
    missing = missing_runs(results)
    assert missing is not None
    assert len(missing.runs) == 3
    assert set(comparable(results).trials["seed"]) == {0, 1, 3, 4, 5}
    bare = replace(results, manifest={**results.manifest, "config": {"sweep": {}}})
    assert missing_runs(bare) is not None
    assert set(comparable(bare).trials["seed"]) == {0, 1, 3, 4, 5}


def test_the_report_says_it_first_and_in_every_figure(partial: Results) -> None:
    page = report_html(partial)
    (first, *_) = cautions(partial)
    assert first.title == "Not complete"
    assert "9 of 54 runs are missing" in first.text
    assert page.index("Not complete") < page.index('id="summary"')
    for each in each_figure(partial, ["map", "budget", "sweep"]):
        assert each.figure is not None
        title = " ".join(each.figure.get_suptitle().split())
        assert "9 of 54 runs are missing; shown are the 16 of 18 trials that all back ends have" in title
        assert max(map(len, each.figure.get_suptitle().split("\n"))) < 14 * each.figure.get_figwidth()


def test_a_notebook_shows_it(partial: Results) -> None:
    assert "9 of 54 runs are missing" in partial._repr_html_()
    assert "online ATE [m]" in partial._repr_html_()


def test_without_one_common_trial_there_is_a_page_all_the_same(whole: Results) -> None:
    results = whole
    for noise in NOISES:
        results = without(without(results, noise, "ekf", {0, 1, 2}), noise, "isam2", {3, 4, 5})
    assert comparable(results).trials.empty
    assert summary_table(results).empty
    assert terminal_table(results).empty
    assert {each.reason for each in each_figure(results)} == {"no trial has a run of every back end"}
    assert "18 of 54 runs are missing" in report_html(results)
    assert "18 of 54 runs are missing" in results._repr_html_()


def test_recorded_data_has_one_run_of_each(recorded: Results) -> None:
    config = {
        "back_ends": [{"name": "ekf", "label": "ekf"}, {"name": "batch", "label": "batch"}],
        "seeds": [None],
    }
    trials = recorded.trials.assign(seed=pd.array([None, None], dtype="Int64"))
    results = replace(recorded, trials=trials, manifest={**recorded.manifest, "config": config, "seeds": []})
    assert missing_runs(results) is None
    missing = missing_runs(replace(results, trials=trials[trials["label"] == "batch"]))
    assert missing is not None
    assert "1 of 2 runs are missing (ekf: 1 run)" in missing.sentence()


@pytest.mark.parametrize("values", [[None, 3], ["a", 2], [True, False], [[1, 2], [3]], [0.5, float("inf")]])
def test_swept_values_of_every_kind_are_found_in_stored_tables(
    values: list[Any], write_experiment: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the real writer of tables and Parquet, whatever a column makes of mixed values."""
    from slamcmp.experiment.gathering.tables import _cell, _kinds

    class Trial:
        def __init__(self, value: Any) -> None:
            self.swept = {"source.x": value}

    kinds = _kinds([Trial(value) for value in values])  # type: ignore[list-item]
    rows = [
        {"trial": i, "label": "a", "seed": 0, "status": "ok", "source.x": _cell(value, kinds["source.x"])}
        for i, value in enumerate(values)
    ]
    trials = pd.DataFrame(rows).astype({"seed": "Int64"})
    config = {"back_ends": [{"name": "a", "label": "a"}], "sweep": {"source.x": values}, "seeds": [0]}
    results = Results(
        tmp_path, {"config": config, "seeds": [0]}, trials, trials[["trial"]], trials[["trial"]]
    )
    save_results(results)
    assert missing_runs(load_results(tmp_path)) is None
    fewer = replace(results, trials=trials.iloc[1:])
    missing = missing_runs(fewer)
    assert missing is not None
    assert len(missing.runs) == 1
    assert missing.of("a", {"source.x": trials["source.x"].iloc[0]}) == 1


def test_the_command_line_says_it(partial: Results, tmp_path: Path) -> None:
    save_results(partial)
    for command in ("report", "plot"):
        extra = ["--format", "svg"] if command == "plot" else []
        ended = CliRunner().invoke(app, [command, str(partial.folder), *extra])
        assert ended.exit_code == 0, ended.output
        assert "9 of 54 runs are missing" in ended.stderr
    assert json.loads((partial.folder / "manifest.json").read_text())["tables_sha256"]


def test_results_show_themselves(whole: Results) -> None:
    """Counts by status, medians with units, and nothing of a message as markup."""
    page = whole._repr_html_()
    assert "54: 52 ok, 1 diverged, 1 crashed" in page
    assert "online ATE [m]" in page
    assert "missing" not in page
    manifest = {**whole.manifest, "question": "<script>x</script>", "in_session": {"Mine": None}}
    page = replace(whole, manifest=manifest)._repr_html_()
    assert "<script" not in page
    assert "Mine: without a memory limit" in page
    assert "54: 52 ok" in repr(whole)
