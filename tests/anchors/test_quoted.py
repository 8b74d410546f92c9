"""The shipped experiments that pages of ``docs/`` quote, and the tables that the quotes are derived from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.grid import at_point
from tests.anchors.reference import FOLDER, QUOTED, assert_reproduces, read, read_runs
from tests.recorded_data import recorded


@pytest.mark.parametrize("name", QUOTED)
def test_tables_of_runs_and_summaries_are_of_the_same_runs(name: str) -> None:
    """Each median of the summary is that of the table; both hold every run of the shipped experiment."""
    runs, summary, experiment = read_runs(name), read(name), load_experiment(find_experiment(name))
    assert summary["experiment"] == f"experiments/{name}.yaml"
    assert summary["status"] == runs["status"].value_counts().to_dict()
    assert set(runs["label"]) == {back_end.label for back_end in experiment.back_ends}
    assert not runs.drop(columns="status").duplicated().any()
    for value in summary["values"]:
        own = at_point(runs[(runs["label"] == value["label"]) & (runs["status"] == "ok")], value["at"])
        assert len(own) == value["runs"], value
        assert own[value["metric"]].median() == pytest.approx(value["measured"], rel=1e-4), value
    assert json.dumps(summary).count("NaN") == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in QUOTED if name != "dial"])
def test_quoted_experiments_give_what_is_quoted(name: str, tmp_path: Path) -> None:
    if name.startswith(("victoria_park_gps", "kitti06")):
        # Not in gtsam's wheel.
        recorded("victoria_park" if name == "victoria_park_gps" else "kitti06_first51")
    results = run_experiment(load_experiment(find_experiment(name)), folder=tmp_path, executor="serial")
    assert_reproduces(results, read(name))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("anchors_*.json")), ids=lambda path: path.stem)
def test_a_recorded_order_is_held_only_where_each_pair_is(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    for order in content["orders"]:
        pairs = [pair["verdict"] for pair in order["pairs"]]
        assert (order["verdict"] == "held") == all(each == "held" for each in pairs), order
        assert set(pairs) <= {"held", "tie", "violated", "too few runs"}
        assert f": {order['verdict']}" in content["sentence"]
