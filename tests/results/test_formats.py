"""docs/formats.md lists the columns that shipped experiments produce: no more, no fewer, with their units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from slamcmp.experiment.config.experiment import Experiment, load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.metrics import metric_columns
from slamcmp.results.store import TABLES, Results

PAGE = Path(__file__).parents[2] / "docs" / "formats.md"
ROW = re.compile(r"^\| (`[^|]+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)
SHORT = {
    "filter_vs_smoother": ({"steps": 12}, {}),
    "association": ({"steps": 12}, {}),
    "unknown_association": ({"steps": 12}, {}),
    "observability": ({"steps": 12}, {}),
    "outliers": ({"steps": 12}, {}),
    "rendered_room": ({"steps": 3, "width_px": 320, "height_px": 240}, {"followed": 15}),
}
"""Shipped experiments that together show every column, and what makes them short: a run of each back end."""


def documented(page: str) -> dict[str, dict[str, str]]:
    """Units by table and column; those of every table are in each."""
    # A second part of the page is about files that users bring.
    results, _ = page.split("\n# Files of your own logs\n")
    sections = re.split(r"^## ", results, flags=re.MULTILINE)[1:]
    found = {
        section.splitlines()[0]: {
            column: unit.strip()
            for columns, unit, _ in ROW.findall(section)
            for column in re.findall(r"`([^`]+)`", columns)
        }
        for section in sections
    }
    common = found.pop("Columns of every table")
    assert set(found) == set(TABLES)
    return {table: {**common, **columns} for table, columns in found.items()}


def shortened(name: str, of_source: Mapping[str, int], of_front_end: Mapping[str, int]) -> Experiment:
    experiment = load_experiment(find_experiment(name))
    source, front_end = experiment.source, experiment.front_end
    for parameter, value in of_source.items():
        source = source.with_parameter(parameter, value)
    for parameter, value in of_front_end.items():
        front_end = front_end.with_parameter(parameter, value)
    sweep = {path: values[-1:] for path, values in experiment.sweep.items()}
    return replace(experiment, source=source, front_end=front_end, seeds=(0,), sweep=sweep)


@pytest.fixture(scope="module")
def produced(tmp_path_factory: pytest.TempPathFactory) -> list[Results]:
    return [
        run_experiment(shortened(name, *changes), folder=tmp_path_factory.mktemp(name), executor="serial")
        for name, changes in SHORT.items()
    ]


@pytest.mark.parametrize("table", TABLES)
def test_documented_columns_are_those_that_experiments_produce(table: str, produced: list[Results]) -> None:
    columns = {str(column) for results in produced for column in getattr(results, table).columns}
    swept = {column for column in columns if "." in column}
    asked = {path for results in produced for path in results.manifest["config"]["sweep"]}
    assert swept == asked
    assert columns - swept == set(documented(PAGE.read_text(encoding="utf-8"))[table])


def test_units_of_metrics_are_those_of_the_registry() -> None:
    units = documented(PAGE.read_text(encoding="utf-8"))["trials"]
    assert {name: units.get(name) for name in metric_columns()} == {
        name: column.unit for name, column in metric_columns().items()
    }


def test_names_that_carry_a_unit_agree_with_it() -> None:
    """``_deg`` and the like at the end of a name."""
    endings = {"_deg": "deg", "_m": "m", "_s": "s", "_ms": "ms", "_mb": "MB", "_rad": "rad", "_per_dof": "1"}
    for columns in documented(PAGE.read_text(encoding="utf-8")).values():
        for name, unit in columns.items():
            for ending, expected in endings.items():
                if name.endswith(ending) and not name.endswith(("_per_m", "_deg_per_m")):
                    assert unit == expected, name


def test_every_value_of_status_is_documented(produced: list[Results]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    statuses = set(pd.concat([results.trials["status"] for results in produced]))
    assert statuses <= set(re.findall(r"`(\w+)`", text))
