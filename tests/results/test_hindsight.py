"""Who is told that final columns are the smoothers' alone, and the line for runs that left their band."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.judgements.departures import departure_lines
from slamcmp.results.judgements.hindsight import filters_without_hindsight


def results(tmp_path: Path, back_ends: str) -> Any:
    (tmp_path / "e.yaml").write_text(f"source: {{name: circle, steps: 8}}\nback_ends: [{back_ends}]\n")
    return run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial")


@pytest.mark.parametrize(
    ("back_ends", "told"),
    [
        ("{name: ekf_slam, label: EKF}, {name: isam2}", ["EKF"]),
        ("{name: ekf_slam, label: EKF}, {name: ekf_world, smooth: true}, {name: isam2}", []),
        ("{name: ekf_slam, label: EKF}, {name: dead_reckoning}", []),
    ],
)
def test_filters_beside_smoothers_final_columns(tmp_path: Path, back_ends: str, told: list[str]) -> None:
    found = results(tmp_path, back_ends)
    assert filters_without_hindsight(found) == told
    assert departure_lines(found) == []
    trials = found.trials
    trials.loc[1:, ["departure_test", "departure_frame"]] = ["NIS", 5.0]
    (line, *_) = departure_lines(found)
    assert line == f"{trials.loc[1, 'label']}: the run, at frame 5 (its innovations)"


@pytest.mark.parametrize("name", ["quickstart", "mrclam", "outliers"])
def test_experiments_that_ask_what_hindsight_is_worth_list_the_filters(name: str) -> None:
    experiment = load_experiment(find_experiment(name))
    assert any(each.parameters.get("smooth") for each in experiment.back_ends)
