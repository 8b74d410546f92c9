"""Times that can be believed: processor time beside wall time, and runs that are timed alone."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from slamcmp.experiment.executors.processes import _Worker
from slamcmp.experiment.job.make_stream import make_stream
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.experiment.job.task import Task
from slamcmp.experiment.runner import run_experiment
from slamcmp.report.cautions import cautions
from slamcmp.results.store import Results
from slamcmp.types import Estimate, Frame, Problem

TIMES = "update_|estimate_|final_s|final_solution|peak_memory|timed_alone"


class Waits:
    """Sleeps in some frames and computes in others."""

    def __init__(self, problem: Problem) -> None:
        self._answer = Estimate(problem.T_world_body, np.eye(3))

    def update(self, frame: Frame) -> None:
        if frame.k % 2:
            time.sleep(0.02)
            return
        begin = time.process_time()
        while time.process_time() < begin + 0.01:
            pass

    def estimate(self) -> Estimate:
        return self._answer


def test_processor_time_leaves_out_what_was_waited() -> None:
    stream, _ = make_stream(("circle", {"steps": 10}), ("labelled", {}), 0)
    run = run_back_end(Waits, stream, label="w", parameters={})
    assert run.status == "ok"
    assert 0.05 <= run.processor_s < 0.09
    assert run.wall_s >= 5 * 0.02 + 0.05
    recorded = run_back_end(Waits, stream, label="w", parameters={}, after_frame=lambda *_: {})
    assert math.isnan(recorded.wall_s)
    assert math.isnan(recorded.processor_s)


def write(folder: Path) -> Path:
    path = folder / "e.yaml"
    back_ends = [{"name": "ekf_slam"}, {"name": "dead_reckoning"}]
    source = {"name": "circle", "steps": 20, "landmarks": 6}
    path.write_text(json.dumps({"source": source, "seeds": 2, "back_ends": back_ends}))
    return path


def test_the_timed_part_runs_alone_after_everything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[bool, int]] = []
    begin, look = _Worker.begin, _Worker.look
    running: set[int] = set()

    def begins(self: _Worker, task: Task) -> bool:
        running.add(id(self))
        seen.append((task.alone, len(running)))
        return begin(self, task)

    def looks(self: _Worker) -> Any:
        ended = look(self)
        if ended is not None:
            running.discard(id(self))
        return ended

    monkeypatch.setattr(_Worker, "begin", begins)
    monkeypatch.setattr(_Worker, "look", looks)
    path = write(tmp_path)
    first = run_experiment(path, folder=tmp_path / "r", jobs=2)
    assert not first.trials["timed_alone"].any()
    seen.clear()
    timed = run_experiment(path, folder=tmp_path / "r", jobs=2, times=True)
    assert seen == [(True, 1)] * 4
    assert timed.trials["timed_alone"].all()
    assert timed.manifest["jobs_timed"] == 4
    keep = ~first.trials.columns.str.contains(TIMES)
    pd.testing.assert_frame_equal(first.trials.loc[:, keep], timed.trials.loc[:, keep])
    assert (timed.trials["estimate_processor_s"] > 0).all()
    # Nothing is timed twice, and the times stay.
    seen.clear()
    again = run_experiment(path, folder=tmp_path / "r", jobs=2, times=True)
    assert not seen
    pd.testing.assert_frame_equal(again.trials, timed.trials)
    # A fresh run is timed after all of it.
    seen.clear()
    run_experiment(path, folder=tmp_path / "fresh", jobs=2, times=True)
    assert [alone for alone, _ in seen] == [False] * 6 + [True] * 4
    assert {count for alone, count in seen if alone} == {1}


def results_with(tmp_path: Path, ratios: list[float], *, alone: bool, jobs: int) -> Results:
    made = run_experiment(write(tmp_path), folder=tmp_path / "r", executor="serial")
    trials = made.trials.assign(
        estimate_processor_s=0.1, estimate_wall_s=[0.1 * ratio for ratio in ratios], timed_alone=alone
    )
    return replace(made, trials=trials, manifest={**made.manifest, "jobs": jobs})


@pytest.mark.parametrize(
    ("ratios", "alone", "jobs", "title"),
    [
        ([1.5, 1.4, 1.6, 3.0], False, 2, "2 jobs side by side disturbed the times"),
        ([1.5, 1.4, 1.6, 3.0], True, 2, "Other programs disturbed the times"),
        ([1.01, 1.0, 1.02, 1.4], False, 2, "Times were measured with 2 jobs side by side"),
        ([1.01, 1.0, 1.02, 1.4], True, 2, None),
        ([1.01, 1.0, 1.02, 1.0], False, 1, None),
    ],
)
def test_the_report_says_whether_jobs_disturbed_one_another(
    tmp_path: Path, ratios: list[float], alone: bool, jobs: int, title: str | None
) -> None:
    found = cautions(results_with(tmp_path, ratios, alone=alone, jobs=jobs))
    about = [each for each in found if "times" in each.title.lower()]
    assert [each.title for each in about] == ([] if title is None else [title])
    if title is not None and "disturbed" in title:
        assert "1.55 times its own processor time" in about[0].text
        assert "3.00 times" in about[0].text
