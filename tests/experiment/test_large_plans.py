"""A sweep of thousands of trials is planned in seconds: nothing is read, listed or held once for each."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from slamcmp.experiment import content_key
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.experiment.planning import plan as planning
from slamcmp.experiment.planning.plan import plan_experiment


def test_what_a_plan_looks_at_does_not_grow_with_its_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: dict[str, int] = {}

    def counted(module: Any, name: str) -> None:
        original = getattr(module, name)

        def call(*arguments: Any) -> Any:
            looks[name] = looks.get(name, 0) + 1
            return original(*arguments)

        monkeypatch.setattr(module, name, call)

    for name in ("stream_code", "run_code", "data_files", "file_digest"):
        counted(content_key, name)
    for name in ("load_truth", "load_run"):
        counted(planning, name)
    shipped = load_experiment(shipped_experiments()["quickstart"])
    seen = []
    for seeds in (2, 2000):
        looks.clear()
        plan = plan_experiment(shipped.with_seeds(range(seeds)), tmp_path)
        assert len(plan.streams) == seeds
        seen.append(dict(looks))
    assert seen[0] == seen[1]


def test_a_trial_takes_little_memory(tmp_path: Path) -> None:
    """500 MB for 100 000 trials are 5 kB for each with all its jobs; these have six."""
    experiment = load_experiment(shipped_experiments()["anchors/p1"]).with_seeds(range(2000))
    # What is known of the code's text is kept for the process, however many trials there are.
    plan_experiment(experiment.with_seeds(range(2)), tmp_path)
    tracemalloc.start()
    plan = plan_experiment(experiment, tmp_path)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(plan.runs) == 5 * 2000
    assert held / 2000 < 4000


def test_one_look_at_a_folder_finds_what_is_there(tmp_path: Path) -> None:
    """A name that is no result, a damaged result and one that is missing are all still to be done."""
    experiment = load_experiment(shipped_experiments()["quickstart"]).with_seeds(range(3))
    first = plan_experiment(experiment, tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / f"{first.trials[0].runs[0].key}.npz").write_bytes(b"PK\x03\x04 no archive")
    os.mkdir(tmp_path / "streams")
    (tmp_path / "streams" / "other.truth.npz").touch()
    again = plan_experiment(experiment, tmp_path)
    assert set(again.runs) == set(first.runs)
    assert set(again.streams) == set(first.streams)
