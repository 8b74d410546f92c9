"""The shipped dial from filter to smoother: its ends, and what the committed summary says."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from tests.anchors.reference import assert_reproduces, read


@pytest.mark.slow
def test_the_whole_dial(tmp_path: Path) -> None:
    results = run_experiment(load_experiment(find_experiment("dial")), folder=tmp_path, executor="serial")
    assert (results.trials["status"] == "ok").all()
    assert_reproduces(results, read("dial"))
    ate = results.trials.pivot(index="seed", columns="label", values="online_ate")
    for window in (1, 2, 5, 10, 20, 50):
        assert (ate[f"frozen {window}"] - ate["EKF"]).abs().max() < 1e-6
    assert (ate["latest 1"] - ate["iterated EKF"]).abs().median() < 1e-3
    assert ate["full smoothing"].median() < ate["EKF"].median()
