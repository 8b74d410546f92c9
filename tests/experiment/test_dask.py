"""The same experiment on a Dask cluster: a real scheduler and two workers on this machine's loopback."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.executors import dask_cluster, remote_job
from slamcmp.experiment.executors.dask_cluster import DaskCluster
from slamcmp.experiment.executors.processes import ExecutorLostError
from slamcmp.experiment.executors.remote_job import do, for_elsewhere, package_version
from slamcmp.experiment.job.task import Task
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.results.store import Results, load_results
from tests.command import Command
from tests.experiment.test_rows_never_vanish import EDGES, edge

distributed = pytest.importorskip("distributed", reason="extra [dask] is not installed")
MEASURED = "update_|estimate_|final_s|final_solution|peak_memory"


class Cluster:
    """A scheduler and two workers, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
        # Plug-ins of these tests import one another; folders of results are nobody's but the client's.
        quiet["env"] = {**os.environ, "PYTHONPATH": str(EDGES.parents[2])}
        dask = [sys.executable, "-m", "dask"]
        where = ["--scheduler-file", str(self.file)]
        words = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *where]
        self.scheduler = subprocess.Popen(words, **quiet)
        words = [*dask, "worker", "--nworkers", "2", "--nthreads", "1", "--no-dashboard", *where]
        self.workers = subprocess.Popen(words, **quiet)
        begin = time.monotonic()
        while not self.file.exists() and time.monotonic() < begin + 120:
            time.sleep(0.05)
        self.address = str(json.loads(self.file.read_text())["address"])

    def end(self) -> None:
        for process in (self.workers, self.scheduler):
            with contextlib.suppress(OSError):
                process.terminate()
        for process in (self.workers, self.scheduler):
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.end()


def write(folder: Path, seeds: int = 3, back_ends: list[Any] | None = None, **more: Any) -> Path:
    path = folder / "e.yaml"
    content = {
        "source": {"name": "circle", "steps": 20, "landmarks": 6},
        "seeds": seeds,
        "back_ends": back_ends or [{"name": "ekf_slam"}, {"name": "dead_reckoning"}],
        **more,
    }
    path.write_text(json.dumps(content))
    return path


def same(one: Results, other: Results) -> None:
    for name in ("trials", "frames", "landmarks"):
        tables = [getattr(each, name) for each in (one, other)]
        keep = ~tables[0].columns.str.contains(MEASURED)
        pd.testing.assert_frame_equal(*(table.loc[:, keep] for table in tables))


def after(monkeypatch: pytest.MonkeyPatch, jobs: int, action: Callable[[], object]) -> None:
    """Do something once, when so many jobs came back."""
    finish, ended = Schedule._finish, list[Any]()

    def finish_and_act(self: Schedule, how: Any) -> None:
        finish(self, how)
        ended.append(how)
        if len(ended) == jobs:
            action()

    monkeypatch.setattr(Schedule, "_finish", finish_and_act)


def test_results_are_those_of_this_machine_digest_by_digest(cluster: Cluster, tmp_path: Path) -> None:
    """Also of a user's plug-in, of one that ends its process, and of one that takes too long."""
    back_ends = [{"name": "ekf_slam"}, edge("Late"), edge("Late", label="whole", at=1000)]
    back_ends.append({"name": f"{EDGES.parents[1] / 'user_plugins.py'}:Segfaults", "label": "Dies"})
    source = {"name": f"{EDGES.parents[1] / 'user_plugins.py'}:straight"}
    path = write(tmp_path, 2, back_ends, time_limit_s=0.3, source=source)
    there = run_experiment(path, folder=tmp_path / "there", executor="dask", scheduler=cluster.address)
    here = run_experiment(path, folder=tmp_path / "here", jobs=2)
    statuses = {"ekf_slam": "ok", "Late": "timed_out", "whole": "ok", "Dies": here.trials["status"].iloc[3]}
    assert there.trials["status"].tolist() == [statuses[label] for label in here.trials["label"]]
    assert statuses["Dies"] in ("crashed", "killed")
    assert there.trials["digest"].tolist() == here.trials["digest"].tolist()
    well = here.trials["label"].isin(["ekf_slam", "whole"])
    keep = ~here.trials.columns.str.contains(MEASURED)
    pd.testing.assert_frame_equal(there.trials.loc[well, keep], here.trials.loc[well, keep])
    assert (there.frames["label"] == "Late").sum() == (here.frames["label"] == "Late").sum() == 2 * 20
    again = run_experiment(path, folder=tmp_path / "there", jobs=1)
    assert again.manifest["jobs_run"] == (2 if statuses["Dies"] == "killed" else 0)


def test_a_worker_that_is_killed_costs_nothing(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pids: list[int] = []

    def kill() -> None:
        with distributed.Client(cluster.address, set_as_default=False) as client:
            pids.extend(client.run(os.getpid).values())
        os.kill(pids[0], signal.SIGKILL)

    after(monkeypatch, 2, kill)
    path = write(tmp_path, 5)
    found = run_experiment(path, folder=tmp_path / "r", executor="dask", scheduler=cluster.address)
    assert len(set(pids)) == 2
    assert (len(found.trials), set(found.trials["status"])) == (10, {"ok"})
    assert found.manifest["jobs_run"] == 15
    monkeypatch.undo()
    same(found, run_experiment(path, folder=tmp_path / "s", executor="serial"))


def test_files_go_to_another_worker_where_the_first_was_lost(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scheduler hears of a killed worker a moment later, and offers it until then."""
    monkeypatch.setattr(dask_cluster, "HEARTBEAT_S", 0.01)
    executor = DaskCluster(scheduler=cluster.address)
    scatter, refused = executor._client.scatter, [OSError("Stream is closed")] * 2

    def once_more(*arguments: Any, **options: Any) -> Any:
        if refused:
            raise refused.pop()
        return scatter(*arguments, **options)

    monkeypatch.setattr(executor._client, "scatter", once_more)
    assert executor._scattered({"a": b"1"}).result() == {"a": b"1"}
    refused.extend([OSError("Stream is closed")] * 3)
    with pytest.raises(ExecutorLostError, match="is gone"):
        executor._scattered({"a": b"1"})
    executor.close()


def test_a_client_that_is_killed_goes_on_where_it_was(cluster: Cluster, tmp_path: Path) -> None:
    path, folder = write(tmp_path, 12), tmp_path / "r"
    code = "import sys; from slamcmp.experiment.runner import run_experiment as r; "
    code += "r(sys.argv[1], folder=sys.argv[2], executor='dask', scheduler=sys.argv[3])"
    words = [sys.executable, "-c", code, str(path), str(folder), cluster.address]
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    begin = time.monotonic()
    while len(list(folder.glob("runs/*.npz"))) < 3 and time.monotonic() < begin + 100:
        time.sleep(0.02)
    child.kill()
    child.wait()
    there = len(list(folder.glob("runs/*.npz")))
    assert there >= 3
    rest = run_experiment(path, folder=folder, executor="dask", scheduler=cluster.address)
    assert rest.manifest["jobs_reused"] == there
    assert (len(rest.trials), set(rest.trials["status"])) == (24, {"ok"})


def test_a_scheduler_that_is_killed_leaves_what_came_back(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last of these tests: nobody starts another."""
    after(monkeypatch, 4, cluster.scheduler.kill)
    path = write(tmp_path, 8)
    with pytest.raises(ExecutorLostError, match=r"is gone; what finished is kept"):
        run_experiment(path, folder=tmp_path / "r", executor="dask", scheduler=cluster.address)
    part = load_results(tmp_path / "r")
    done = part.manifest["jobs_run"]
    assert 4 <= done < 24
    assert part.manifest["jobs_missing"] == 24 - done
    monkeypatch.undo()
    rest = run_experiment(path, folder=tmp_path / "r", executor="serial")
    assert rest.manifest["jobs_run"] == 24 - done
    assert (len(rest.trials), set(rest.trials["status"])) == (16, {"ok"})
    same(rest, run_experiment(path, folder=tmp_path / "s", executor="serial"))


def test_what_another_machine_does_not_have_is_not_done_there(tmp_path: Path) -> None:
    own = tmp_path / "mine.py"
    own.write_text("text = 1\n")
    task = Task("run", "k", tmp_path, (("x", {}),), 0, code={str(own): "0" * 64})
    assert do(task, package_version(), 1).not_here
    assert do(for_elsewhere(task), "another", 1).status == "missing"
    inside = str(remote_job.PACKAGE / "geometry.py")
    sent = for_elsewhere(Task("run", "k", tmp_path, (("x", {}),), 0, code={inside: "d", str(own): "e"}))
    assert sent.code == {"slamcmp/geometry.py": "d", str(own): "e"}
    assert remote_job._at_home(sent, tmp_path).code == {inside: "d", str(own): "e"}


def test_jobs_that_come_back_undone_are_done_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a cluster whose workers have none of the user's files."""

    class Future:
        status = "finished"

        def __init__(self, sent: remote_job.Sent) -> None:
            self._sent = sent

        def result(self, timeout: float) -> remote_job.Sent:
            return self._sent

        def add_done_callback(self, call: Callable[[Any], None]) -> None:
            call(self)

    class Client:
        def submit(self, function: Any, task: Task, *arguments: Any, **options: Any) -> Future:
            return Future(remote_job.Sent(not_here=True))

        def scatter(self, values: list[Any], **options: Any) -> list[Future]:
            return [Future(remote_job.Sent()) for _ in values]

        def nthreads(self) -> dict[str, int]:
            return {"a": 2}

        def close(self, timeout: float) -> None:
            pass

    monkeypatch.setattr(dask_cluster, "_connected", lambda *_: Client())
    monkeypatch.setattr(dask_cluster.DaskCluster, "_await_workers", lambda self: None)
    path = write(tmp_path, 1)
    found = run_experiment(path, folder=tmp_path / "r", executor="dask", scheduler="tcp://nowhere:1")
    assert found.trials["status"].tolist() == ["ok", "ok"]


def test_what_cannot_be_is_said_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    call = Command(tmp_path, monkeypatch, capsys)
    path = str(write(tmp_path, 1))
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.5)
    code, _, said = call("run", path, "--executor", "dask", "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "no Dask scheduler answers there" in said
    for words in (("--scheduler", "tcp://127.0.0.1:9"), ("--scheduler", "x", "--executor", "serial")):
        code, _, said = call("run", path, *words)
        assert code == 2
        assert "knows no scheduler" in said
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, _, said = call("run", path, "--executor", "dask")
    assert code == 2
    assert "pip install 'slamcmp[dask]'" in said
    assert len(said.strip().splitlines()) == 1
    with pytest.raises(UsageError):
        run_experiment(load_experiment(path), folder=tmp_path / "r", executor="dask")
