"""Swept values of every kind reach the tables, the files and the figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.errors import DataError
from slamcmp.experiment.runner import run_experiment
from slamcmp.report.figures.draw import each_figure
from slamcmp.results.store import load_results, save_results

Write = Callable[..., Path]
PATH = "back_ends.Anything.value"


def sweep(write: Write, folder: Path, values: list[Any]) -> pd.DataFrame:
    path = write(back_ends=[{"name": "Anything"}], sweep={PATH: values})
    run_experiment(path, folder=folder, executor="serial")
    results = load_results(folder)
    assert len(results.frames) == 40 * len(values)
    for name in ("sweep", "map", "dial"):
        (drawn,) = each_figure(results, [name])
        assert (drawn.figure is None) == (name == "dial"), drawn.reason
        if name == "sweep":
            (ticks,) = {tuple(t.get_text() for t in axes.get_xticklabels()) for axes in drawn.figure.axes}
            assert len(ticks) == len(values)
    return results.trials[PATH]


def test_null_among_numbers_is_a_missing_number(write_experiment: Write, tmp_path: Path) -> None:
    column = sweep(write_experiment, tmp_path / "r", [None, 0.99, 1])
    assert column.dtype == "float64"
    assert math.isnan(column[0])
    assert list(column[1:]) == [0.99, 1.0]


def test_values_of_several_kinds_are_text(write_experiment: Write, tmp_path: Path) -> None:
    column = sweep(write_experiment, tmp_path / "r", [None, 2, "auto", True, [1, 2]])
    assert pd.isna(column[0])
    assert list(column[1:]) == ["2", "auto", "true", "[1, 2]"]


def test_only_null_and_text(write_experiment: Write, tmp_path: Path) -> None:
    column = sweep(write_experiment, tmp_path / "r", ["a", None])
    assert column[0] == "a"
    assert pd.isna(column[1])


def test_table_that_parquet_cannot_hold_is_named(write_experiment: Write, tmp_path: Path) -> None:
    results = run_experiment(
        write_experiment(back_ends=["DeadReckoning"]), folder=tmp_path / "r", executor="serial"
    )
    results.trials["odd"] = [{1: object()}]
    with pytest.raises(DataError, match=r"trials\.parquet: the table of trials has a column that Parquet"):
        save_results(results)


def test_diagnostics_named_like_keys_do_not_stop_the_tables(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["TellsItsSeed"], sweep={"source.steps": [4, 5]}, seeds=[3])
    frames = run_experiment(path, folder=tmp_path / "r", executor="serial").frames
    assert set(frames["seed"]) == {3}
    assert set(frames["source.steps"]) == {4, 5}
    assert set(frames["seed_diagnostic"]) == set(frames["source.steps_diagnostic"]) == {-1.0}
