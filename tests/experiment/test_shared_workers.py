"""Jobs of our own plug-ins follow one another in a process; what one does to it harms no other."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.executors.processes import Processes, _Worker
from slamcmp.experiment.job.task import Task, run_path
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.results.runs.run_file import load_run

BACK_ENDS = "[{name: dead_reckoning}, {name: ekf_right_invariant, label: again}, {name: ekf_slam}]"
OWN = "class Mine(DeadReckoning):\n    pass\n"
MEASURED = "update_|estimate_|final_s|peak_memory"


def write(folder: Path, back_ends: str = BACK_ENDS, seeds: int = 3, **more: Any) -> Path:
    path = folder / "e.yaml"
    source = "{name: circle, steps: 30, landmarks: 10}"
    lines = [f"source: {source}", f"seeds: {seeds}", f"back_ends: {back_ends}"]
    path.write_text("\n".join([*lines, *(f"{key}: {value}" for key, value in more.items())]))
    return path


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, Task]]:
    """Which process did which job."""
    seen: list[tuple[int, Task]] = []
    begin = _Worker.begin

    def told(self: _Worker, task: Task) -> bool:
        begun = begin(self, task)
        if begun:
            seen.append((self._pid, task))
        return begun

    monkeypatch.setattr(_Worker, "begin", told)
    return seen


def same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    keep = ~one.columns.str.contains(MEASURED)
    pd.testing.assert_frame_equal(one.loc[:, keep], other.loc[:, keep])


def test_runs_of_a_stream_follow_it_in_its_process(tmp_path: Path, started: list[tuple[int, Task]]) -> None:
    path = write(tmp_path)
    results = run_experiment(path, folder=tmp_path / "r", jobs=2)
    assert set(results.trials["status"]) == {"ok"}
    assert len(started) == 12
    assert len({pid for pid, _ in started}) == 2
    homes: dict[str, set[int]] = {}
    for pid, task in started:
        homes.setdefault(task.stream_key or task.key, set()).add(pid)
    # The last stream's runs are shared out; all others stay where their stream is.
    assert sum(len(each) > 1 for each in homes.values()) <= 1
    alone = run_experiment(path, folder=tmp_path / "serial", executor="serial")
    same(results.trials, alone.trials)
    same(results.frames, alone.frames)


def test_a_user_s_plug_in_has_a_process_to_itself(tmp_path: Path, started: list[tuple[int, Task]]) -> None:
    (tmp_path / "mine.py").write_text("from tests.user_plugins import DeadReckoning\n" + OWN)
    path = write(tmp_path, "[{name: 'mine.py:Mine'}, {name: dead_reckoning}]")
    assert set(run_experiment(path, folder=tmp_path / "r", jobs=1).trials["status"]) == {"ok"}
    mine = [pid for pid, task in started if task.label == "Mine"]
    others = [pid for pid, task in started if task.label != "Mine"]
    assert len(set(mine)) == len(mine) == 3
    assert not set(mine) & set(others)


def test_a_job_that_dies_loses_only_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker of one run is killed while it does its second to last job."""
    path = write(tmp_path, seeds=2)
    victim = load_experiment(path)
    begin, killed = _Worker.begin, list[str]()

    def kill_one(self: _Worker, task: Task) -> bool:
        begun = begin(self, task)
        if task.label == "again" and task.seed == 0:
            self.heartbeat[0] = 1e-9 + self._begin
            os.kill(self._pid, signal.SIGKILL)
            killed.append(task.key)
        return begun

    monkeypatch.setattr(_Worker, "begin", kill_one)
    results = run_experiment(victim, folder=tmp_path / "r", jobs=1)
    rows = results.trials.set_index(["label", "seed"])["status"].to_dict()
    expected = {(label, seed): "ok" for label in ("dead_reckoning", "again", "ekf_slam") for seed in (0, 1)}
    assert rows == {**expected, ("again", 0): "killed"}
    monkeypatch.setattr(_Worker, "begin", begin)
    again = run_experiment(victim, folder=tmp_path / "r", jobs=1)
    assert set(again.trials["status"]) == {"ok"}
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (1, 5)


@pytest.mark.parametrize("when", ["before it is told", "before it begins"])
def test_a_worker_that_is_gone_between_two_jobs_costs_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    path = write(tmp_path, seeds=1)
    begin = _Worker.begin
    gone: list[int] = []

    def after_its_end(self: _Worker, task: Task) -> bool:
        if task.label == "ekf_slam" and not gone:
            gone.append(self._pid)
            # Stopped, it takes the job and never comes to it.
            os.kill(self._pid, signal.SIGKILL if when == "before it is told" else signal.SIGSTOP)
            if when == "before it is told":
                self.process.join()
            begun = begin(self, task)
            if begun:
                os.kill(self._pid, signal.SIGKILL)
            return begun
        return begin(self, task)

    monkeypatch.setattr(_Worker, "begin", after_its_end)
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert gone
    assert results.trials["status"].tolist() == ["ok", "ok", "ok"]


def test_a_file_that_changed_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream at hand is only taken for its file's while that is what it was."""
    path = write(tmp_path, seeds=1)
    finish = Schedule._finish

    def spoil(self: Schedule, ended: Any) -> None:
        finish(self, ended)
        if ended.task.label == "again":
            files = (tmp_path / "r" / "streams").glob("*.npz")
            (file,) = (each for each in files if "truth" not in each.name)
            file.write_bytes(b"spoilt")

    monkeypatch.setattr(Schedule, "_finish", spoil)
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert results.trials["status"].tolist() == ["ok", "ok", "missing"]
    monkeypatch.setattr(Schedule, "_finish", finish)
    again = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert again.trials["status"].tolist() == ["ok", "ok", "ok"]


def test_after_a_job_that_failed_the_next_process_is_a_new_one(
    tmp_path: Path, started: list[tuple[int, Task]]
) -> None:
    back_ends = "[{name: dead_reckoning}, {name: fixed_lag, lag_frames: 5}, {name: ekf_slam}]"
    path = write(tmp_path, back_ends, seeds=1, time_limit_s=0.000001)
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    runs = [(pid, load_run(run_path(task.folder, task.key))) for pid, task in started if task.kind == "run"]
    assert all(stored is not None and stored.run.status == "timed_out" for _, stored in runs)
    assert len({pid for pid, _ in runs}) == 3


def test_idle_workers_end_with_the_executor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[Processes] = []
    close = Processes.close

    def look(self: Processes) -> None:
        places.append(self)
        pids = [worker._pid for worker in self._idle]
        assert pids
        close(self)
        for pid in pids:
            with pytest.raises(ProcessLookupError):
                os.kill(pid, 0)

    monkeypatch.setattr(Processes, "close", look)
    run_experiment(write(tmp_path, seeds=1), folder=tmp_path / "r", jobs=1)
    assert len(places) == 1
