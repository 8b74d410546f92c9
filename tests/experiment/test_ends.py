"""How runs end: with every finished frame, with all that they started, and with tables."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.experiment.executors.processes import _remove_left_behind
from slamcmp.experiment.job import worker
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import load_results
from slamcmp.support.files.log_file import KEPT_BYTES, LIMIT_BYTES, trim
from slamcmp.support.process_tree import is_alive
from slamcmp.support.shared_arrays import SharedArrays
from tests.experiment.test_rows_never_vanish import edge, write_edges

Write = Callable[..., Path]


def test_time_out_within_a_frame_keeps_every_finished_one(tmp_path: Path) -> None:
    path = write_edges(tmp_path, edge("Late"), edge("Late", label="whole", at=1000), time_limit_s=0.5)
    results = run_experiment(path, folder=tmp_path / "r", jobs=2)
    late, whole = (results.trials.iloc[index] for index in (0, 1))
    assert (late["status"], late["completion"], late["frames"]) == ("timed_out", 0.5, 40)
    assert late["message"] == "after 20 of 40 frames: ended 2.5 s after its start: it was stuck"
    assert whole["status"] == "ok"
    frames = {label: table.reset_index(drop=True) for label, table in results.frames.groupby("label")}
    assert len(frames["Late"]) == 20
    for name in ("online_x", "online_sigma_x", "online_position_error_m", "n"):
        if name in frames["Late"]:
            np.testing.assert_array_equal(frames["Late"][name], frames["whole"][name][:20])
    np.testing.assert_array_equal(frames["Late"]["n"], np.arange(1.0, 21.0))
    assert (frames["Late"]["update_s"] > 0).all()
    error = frames["whole"]["online_position_error_m"][:20]
    assert late["online_ate"] == pytest.approx(float(np.sqrt(np.mean(error**2))))


HANGING = """
import time
import numpy as np
from tests.user_plugins import DeadReckoning
from slamcmp.types import Landmarks, Trajectory


class Hangs(DeadReckoning):
    def __init__(self, problem, *, at: str):
        super().__init__(problem)
        self.at, self.stamps, self.answers = at, [], []

    def stop(self, at):
        if at == self.at:
            time.sleep(60)

    def update(self, frame):
        super().update(frame)
        self.stamps.append(frame.t)

    def estimate(self):
        if len(self.stamps) > 30:
            self.stop("estimate")
        self.answers.append(self.T)
        return super().estimate()

    def trajectory(self):
        self.stop("trajectory")
        return Trajectory(np.array(self.stamps), np.array(self.answers))

    def landmarks(self):
        self.stop("landmarks")
        return Landmarks(np.empty(0, int), np.empty((0, 2)), np.empty((0, 2, 2)))

    def joint_covariance(self):
        self.stop("joint_covariance")
        return np.eye(3)
"""


def test_time_out_within_a_covariance_keeps_the_online_part(tmp_path: Path) -> None:
    """Of the causal estimate, or of what is asked after the last frame: as of who comes through."""
    (tmp_path / "mine.py").write_text(HANGING)
    where = ("never", "estimate", "trajectory", "landmarks", "joint_covariance")
    source = {"name": f"{Path(__file__).parents[1] / 'user_plugins.py'}:straight"}
    back_ends = [{"name": "mine.py:Hangs", "label": at, "at": at} for at in where]
    path = tmp_path / "e.yaml"
    path.write_text(json.dumps({"source": source, "back_ends": back_ends, "time_limit_s": 0.3}))
    results = run_experiment(path, folder=tmp_path / "r", jobs=4)
    rows = results.trials.set_index("label")
    frames = {label: table.reset_index(drop=True) for label, table in results.frames.groupby("label")}
    assert rows["status"].to_dict() == {"never": "ok", **dict.fromkeys(where[1:], "timed_out")}
    assert rows["completion"].to_dict() == {**dict.fromkeys(where, 1.0), "estimate": 0.75}
    for at in where[1:]:
        done = 30 if at == "estimate" else 40
        assert len(frames[at]) == done
        for name in ("online_x", "online_sigma_0", "online_position_error_m", "online_nees"):
            np.testing.assert_array_equal(frames[at][name], frames["never"][name][:done])
        if at != "estimate":
            for name in ("online_ate", "online_heading_rmse_deg", "online_max_error"):
                assert rows.loc[at, name] == rows.loc["never", name]
            assert "what it is asked after the last frame took longer than" in rows.loc[at, "message"]


def test_shared_arrays_outlive_their_writer() -> None:
    shared = SharedArrays()
    pid = os.fork()
    if pid == 0:
        poses = shared.new("poses", (5, 3, 3), np.nan)
        shared.new("nothing", (0, 3), 0.0)
        flags = shared.new("flags", (7,), False, "bool")
        poses[2], flags[3] = np.eye(3), True
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(pid, 0)
    found = shared.read()
    assert set(found) == {"poses", "flags"}
    np.testing.assert_array_equal(found["poses"][2], np.eye(3))
    assert np.isnan(found["poses"][[0, 1, 3, 4]]).all()
    assert list(np.flatnonzero(found["flags"])) == [3]
    # More names than the directory holds are arrays of the process alone.
    for index in range(5000):
        shared.new(f"a series with quite a long name {index}", (1,), 0.0)
    assert set(SharedArrays().read()) == set()
    shared.close()


def test_keeping_frames_costs_the_loop_nothing(tmp_path: Path) -> None:
    """Writing a frame into the shared arrays, against one of the process alone."""
    shared = SharedArrays()
    arrays = [shared.new("a", (2000, 6, 6), 0.0), np.zeros((2000, 6, 6))]
    value = np.eye(6)

    def fastest(array: np.ndarray) -> float:
        times = []
        for _ in range(15):
            begin = time.perf_counter()
            for k in range(2000):
                array[k] = value
            times.append(time.perf_counter() - begin)
        return min(times)

    both = [fastest(array) for array in arrays]
    # Of a frame that takes 100 µs, 1 % is 1 µs.
    assert (both[0] - both[1]) / 2000 < 1e-6
    shared.close()


def test_limits_count_estimation_not_scoring_or_saving(write_experiment: Write, tmp_path: Path) -> None:
    """A plug-in cannot slow the scores down, so the worker's own module is told to, in its process."""
    (tmp_path / "slow.py").write_text(
        "import time\nfrom slamcmp.experiment.job import worker\n"
        "from tests.user_plugins import DeadReckoning\n"
        "score = worker.score_run\n"
        "def slow(*arguments, **options):\n    time.sleep(3.5)\n    return score(*arguments, **options)\n"
        "class Slow(DeadReckoning):\n"
        "    def __init__(self, problem):\n"
        "        super().__init__(problem)\n"
        "        worker.score_run = slow\n"
    )
    path = tmp_path / "e.yaml"
    source = {"name": f"{Path(__file__).parents[1] / 'user_plugins.py'}:straight"}
    fields = {"source": source, "back_ends": [{"name": "slow.py:Slow"}], "time_limit_s": 0.5}
    path.write_text(json.dumps(fields))
    assert worker.score_run.__name__ == "score_run"
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["ok"]


def test_thread_that_is_left_behind_ends_at_once(tmp_path: Path) -> None:
    path = write_edges(tmp_path, edge("LeavesAThread"), time_limit_s=100)
    begin = time.monotonic()
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["ok"]
    assert results.trials["message"][0] == ""
    assert time.monotonic() - begin < 60


@pytest.mark.parametrize("then_hang", [False, True])
def test_children_end_with_their_worker(tmp_path: Path, then_hang: bool) -> None:
    """By itself or by its limit: in its group, in a session of their own, or as orphans."""
    told = tmp_path / "pids"
    back_end = edge("LeavesChildren", pids=str(told), then_hang=then_hang)
    results = run_experiment(write_edges(tmp_path, back_end, time_limit_s=4.0), folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["timed_out" if then_hang else "ok"]
    pids = [int(pid) for pid in told.read_text().split()]
    assert len(pids) == 3
    deadline = time.monotonic() + 20
    while any(map(_runs, pids)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in pids if _runs(pid)]


def _runs(pid: int) -> bool:
    """Whether it is more than an entry that nobody has fetched yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_temporary_files_go_with_their_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    told = tmp_path / "name"
    path = write_edges(tmp_path, edge("LeavesFiles", told=str(told)))
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    name = Path(told.read_text())
    assert name.is_relative_to(place)
    assert not name.exists()
    assert list(place.glob("slamcmp-*")) == []
    # What a run left that was killed itself is removed by the next.
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    (place / f"slamcmp-{gone.pid}-x").mkdir()
    (place / f"slamcmp-{os.getpid()}-x").mkdir()
    _remove_left_behind()
    assert [each.name for each in place.glob("slamcmp-*")] == [f"slamcmp-{os.getpid()}-x"]


def test_half_written_files_of_killed_writers_are_removed(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning"])
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    (tmp_path / "r" / "runs").mkdir(parents=True)
    left = tmp_path / "r" / "runs" / f".abc.npz.{gone.pid}"
    left.write_bytes(b"half")
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert not left.exists()


def test_logs_keep_their_beginning_and_their_end(tmp_path: Path) -> None:
    """Forty megabytes are printed."""
    results = run_experiment(write_edges(tmp_path, edge("PrintsALot")), folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["ok"]
    (log,) = (tmp_path / "r" / "logs").iterdir()
    text = log.read_bytes()
    assert len(text) <= LIMIT_BYTES
    assert text.startswith(b"xxx")
    assert text.endswith(b"the last words\n")
    assert b"left out" in text


def test_trimming_keeps_both_ends(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(b"a" * KEPT_BYTES + b"b" * LIMIT_BYTES + b"c" * KEPT_BYTES)
    trim(path)
    text = path.read_bytes()
    assert text.startswith(b"a" * KEPT_BYTES + b"\n[...")
    assert text.endswith(b"\n" + b"c" * KEPT_BYTES)
    assert b"b" not in text
    trim(tmp_path / "absent")


@pytest.mark.parametrize("sent", [["SIGTERM"], ["SIGHUP"], ["SIGINT", "SIGINT", "SIGINT"]], ids=str)
@pytest.mark.parametrize("executor", ["processes", "serial"])
def test_signals_end_a_run_with_tables(
    write_experiment: Write, tmp_path: Path, sent: list[str], executor: str
) -> None:
    """What batch systems send, the end of a terminal, and impatience."""
    path = write_experiment(back_ends=[{"name": "DeadReckoning", "pause_s": 0.02}], seeds=400)
    folder = tmp_path / "r"
    words = ["run", str(path), "--results", str(folder), "--jobs", "1", "--no-report", "--executor", executor]
    run = subprocess.Popen(
        [sys.executable, "-m", "slamcmp", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 300
    while not list((folder / "runs").glob("[!.]*.npz")) and time.monotonic() < deadline:
        time.sleep(0.02)
    for name in sent:
        run.send_signal(getattr(signal, name))
        time.sleep(0.05)
    _, errors = run.communicate(timeout=300)
    assert run.returncode == 130, errors
    assert "Traceback" not in errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith("slamcmp: interrupted: ")
    assert "the same command goes on from there" in last
    results = load_results(folder)
    assert 1 <= len(results.trials) < 400
    assert set(results.trials["status"]) <= {"ok"}
    assert results.manifest["jobs_missing"] > 0
    done = len(results.trials)
    again = run_experiment(path, folder=folder, jobs=1, seeds=range(done), executor="serial")
    assert again.manifest["jobs_reused"] >= done - 1


def test_ignored_signal_stays_ignored(write_experiment: Write, tmp_path: Path) -> None:
    """As under nohup."""
    path = write_experiment(back_ends=["DeadReckoning"])
    code = (
        "import os, signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from slamcmp.support.interruption import interruptions\n"
        "with interruptions() as stop:\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
        "    assert not stop.is_set()\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    assert stop.is_set()\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "print(signal.getsignal(signal.SIGTERM) == signal.SIG_DFL)\n"
    )
    assert path.is_file()
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (told.returncode, told.stdout) == (0, "True\n"), told.stderr


def test_closed_pipe_ends_no_run(write_experiment: Write, tmp_path: Path) -> None:
    """The reader of standard error goes away, as with ``2>&1 | head -1``."""
    path = write_experiment(back_ends=["DeadReckoning"], seeds=2)
    words = ["run", str(path), "--results", str(tmp_path / "r"), "--jobs", "1", "--no-report"]
    read, write = os.pipe()
    run = subprocess.Popen([sys.executable, "-m", "slamcmp", *words], stderr=write, stdout=subprocess.DEVNULL)
    os.close(write)
    os.close(read)
    run.wait(timeout=400)
    assert list(load_results(tmp_path / "r").trials["status"]) == ["ok"] * 2


def test_long_folder_of_temporary_files(write_experiment: Write, tmp_path: Path) -> None:
    """The path of a socket has 108 bytes."""
    long = tmp_path / ("x" * 100) / ("y" * 100)
    long.mkdir(parents=True)
    path = write_experiment(back_ends=["DeadReckoning"])
    words = ["run", str(path), "--results", str(tmp_path / "r"), "--no-report"]
    told = subprocess.run(
        [sys.executable, "-m", "slamcmp", *words],
        env={**os.environ, "TMPDIR": str(long)},
        capture_output=True,
        text=True,
    )
    assert told.returncode == 0, told.stderr
    assert isinstance(load_results(tmp_path / "r").trials, pd.DataFrame)
    assert list(long.iterdir()) == []
    assert is_alive(os.getpid())
