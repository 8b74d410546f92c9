"""Whole experiments: failures become rows, results are reused, nothing depends on the number of workers."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.errors import MissingDataError, SlamcmpError, StorageError, UsageError
from slamcmp.experiment import runner
from slamcmp.experiment.planning.plan import plan_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.experiment.schedule import Schedule
from slamcmp.results.runs.run_file import load_truth, save_truth
from slamcmp.results.store import TABLES, Results, load_results
from slamcmp.support.files.lock import locked
from slamcmp.types import GroundTruth
from tests.conftest import PLUGINS

Write = Callable[..., Path]
MEASURED = ("update", "estimate", "final_s", "peak_memory")
"""Starts of the names of columns that hold times and memory: they differ between any two runs."""


def repeatable(table: pd.DataFrame) -> pd.DataFrame:
    """The columns that must be the same whenever the same experiment is run."""
    return table[[name for name in table.columns if not name.startswith(MEASURED)]]


def assert_same(one: Results, other: Results) -> None:
    for name in TABLES:
        pd.testing.assert_frame_equal(
            repeatable(getattr(one, name)), repeatable(getattr(other, name)), check_exact=True
        )


def row(results: Results, label: str) -> pd.Series:
    (found,) = [each for _, each in results.trials.iterrows() if each["label"] == label]
    return found


def test_each_kind_of_failure_is_a_row_and_takes_nothing_else_with_it(
    write_experiment: Write, tmp_path: Path
) -> None:
    names = [
        "DeadReckoning",
        "Raises",
        "Diverges",
        "TurnsNan",
        "IsKilled",
        "Segfaults",
        "Exits",
        "Loops",
        "Hog",
    ]
    path = write_experiment(back_ends=names, time_limit_s=1.0, memory_limit_mb=150)
    results = run_experiment(path, folder=tmp_path / "r", jobs=2)
    assert list(results.trials["label"]) == names
    expected = {
        "DeadReckoning": ("ok", 1.0, ""),
        "Raises": ("crashed", 0.5, "frame 20: ValueError: no such landmark"),
        "Diverges": ("diverged", 0.5, "frame 20: wrong basin"),
        "TurnsNan": ("diverged", 0.5, "frame 20: the estimated pose is not finite"),
        "IsKilled": ("killed", 0.5, "after 20 of 40 frames: the worker process was killed by SIGKILL"),
        "Segfaults": ("crashed", 0.5, "after 20 of 40 frames: the worker process was killed by SIGSEGV"),
        "Exits": ("crashed", 0.5, "after 20 of 40 frames: the worker process ended with exit code 0"),
        "Loops": ("timed_out", 0.5, "after 20 of 40 frames: ended 3 s after its start: it was stuck"),
        "Hog": ("crashed", 0.5, "frame 20: "),
    }
    for label, (status, completion, message) in expected.items():
        found = row(results, label)
        assert (label, found["status"], found["completion"]) == (label, status, completion)
        assert found["message"].startswith(message), found["message"]
        assert found["digest"] == results.trials["digest"][0]
    assert "MemoryError" in row(results, "Hog")["message"]
    # The frames before the failure are kept, whether the worker lived to tell or not.
    counts = results.frames.groupby("label").size()
    assert counts["DeadReckoning"] == 40
    assert set(counts[names[1:]]) == {20}
    ates = [row(results, label)["online_ate"] for label in names[1:]]
    assert len(set(ates)) == 1
    # A kill comes from outside: only that run is done again, by the same command.
    assert results.manifest["jobs_missing"] == 1
    again = run_experiment(path, folder=tmp_path / "r", jobs=2)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (1, len(names) - 1)


def test_scores_and_tables_of_a_known_world(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"], seeds=2)
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["seed"]) == [0, 0, 1, 1]
    assert results.trials["seed"].dtype == "Int64"
    assert set(results.trials["reference"]) == {"truth"}
    for seed in (0, 1):
        steps = 1 + 0.01 * np.array([0.0, *np.random.default_rng(seed).normal(size=39)])
        error = np.cumsum(steps) - 1 - np.arange(40)
        found = results.trials[results.trials["seed"] == seed]
        np.testing.assert_allclose(found["online_ate"], np.sqrt(np.mean(error**2)), rtol=1e-9)
        np.testing.assert_allclose(found["final_ate"].iloc[1], np.sqrt(np.mean(error**2)), rtol=1e-9)
        assert np.isnan(found["final_ate"].iloc[0])
        frames = results.frames[(results.frames["seed"] == seed) & (results.frames["label"] == "Hindsight")]
        np.testing.assert_allclose(frames["online_position_error_m"], np.abs(error), atol=1e-12)
    loaded = load_results(tmp_path / "r")
    assert_same(results, loaded)
    assert loaded.manifest["jobs_run"] == 6
    wanted = "name question description created finished command versions commit cpu platform python config"
    assert {*wanted.split(), "seeds", "wall_s", "jobs"} <= loaded.manifest.keys()


def test_one_worker_two_workers_and_none_agree_exactly(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(
        back_ends=["DeadReckoning", "Hindsight", "TurnsNan"],
        seeds=3,
        sweep={"source.sigma_m": [0.01, 0.1]},
    )
    one = run_experiment(path, folder=tmp_path / "one", jobs=1)
    two = run_experiment(path, folder=tmp_path / "two", jobs=2)
    serial = run_experiment(path, folder=tmp_path / "serial", executor="serial")
    assert len(one.trials) == 18
    assert list(one.trials["source.sigma_m"].unique()) == [0.01, 0.1]
    assert_same(one, two)
    assert_same(one, serial)


def test_real_estimators_agree_between_one_and_two_workers(tmp_path: Path) -> None:
    path = tmp_path / "real.yaml"
    path.write_text(
        "source: {name: circle, steps: 60}\nseeds: 2\n"
        "back_ends: [{name: ekf_slam}, {name: isam2}, {name: batch}]\n"
    )
    one = run_experiment(path, folder=tmp_path / "one", jobs=1)
    two = run_experiment(path, folder=tmp_path / "two", jobs=2)
    assert set(one.trials["status"]) == {"ok"}
    assert len(one.landmarks) > 100
    assert_same(one, two)


def test_finished_jobs_are_reused_and_only_changed_ones_run(write_experiment: Write, tmp_path: Path) -> None:
    folder = tmp_path / "r"

    def run(back_ends: list, **options) -> Results:
        return run_experiment(write_experiment(back_ends=back_ends, seeds=2), folder=folder, **options)

    first = run(["DeadReckoning", "Raises"])
    assert first.manifest["jobs_run"] == 2 + 4
    again = run(["DeadReckoning", "Raises"])
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 4)
    pd.testing.assert_frame_equal(again.trials, first.trials, check_exact=True)
    changed = run([{"name": "DeadReckoning", "at": 3}, "Raises"])
    assert (changed.manifest["jobs_run"], changed.manifest["jobs_reused"]) == (2, 2)
    failed = run([{"name": "DeadReckoning", "at": 3}, "Raises"], rerun_failed=True)
    assert (failed.manifest["jobs_run"], failed.manifest["jobs_reused"]) == (2, 2)
    one_seed = run(["DeadReckoning"], seeds=[7])
    assert one_seed.manifest["jobs_run"] == 2
    assert list(one_seed.trials["seed"]) == [7]
    # A damaged result is computed again.
    victim = sorted((folder / "runs").glob("*.npz"))
    for path in victim:
        path.write_bytes(path.read_bytes()[:100])
    repaired = run(["DeadReckoning", "Raises"])
    assert repaired.manifest["jobs_run"] == 4
    assert_same(repaired, first)


def test_plan_tells_what_is_left(write_experiment: Write, tmp_path: Path) -> None:
    from slamcmp.experiment.config.experiment import load_experiment

    experiment = load_experiment(write_experiment(back_ends=["DeadReckoning", "Hindsight"], seeds=2))
    plan = plan_experiment(experiment, tmp_path / "r")
    assert (len(plan.trials), len(plan.streams), len(plan.runs), plan.reused) == (2, 2, 4, 0)
    assert not (tmp_path / "r").exists()
    run_experiment(experiment, folder=tmp_path / "r", seeds=[1])
    plan = plan_experiment(experiment, tmp_path / "r")
    assert (len(plan.trials), len(plan.streams), len(plan.runs), plan.reused) == (2, 1, 2, 2)


def test_reference_plays_truth_where_there_is_none(write_experiment: Write, tmp_path: Path) -> None:
    source = {"name": f"{PLUGINS}:straight", "truth": False}
    back_ends = ["DeadReckoning", {"name": "Hindsight", "label": "H"}]
    path = write_experiment(source=source, back_ends=back_ends, reference="H")
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert set(results.trials["reference"]) == {"H (final)"}
    # Both add up the same odometry, so their difference is exactly nothing.
    np.testing.assert_allclose(results.trials["online_ate"], 0.0, atol=1e-12)
    assert results.trials["online_pose_nees"].isna().all()
    np.testing.assert_array_equal(results.frames["true_x"], results.frames["online_x"])
    alone = write_experiment(source=source, back_ends=back_ends)
    results = run_experiment(alone, folder=tmp_path / "r", jobs=1)
    assert set(results.trials["reference"]) == {"none"}
    assert results.trials["online_ate"].isna().all()


def test_back_end_never_shares_a_process_with_the_truth(write_experiment: Write, tmp_path: Path) -> None:
    results = run_experiment(write_experiment(back_ends=["LooksForTruth"]), folder=tmp_path / "r", jobs=1)
    assert row(results, "LooksForTruth")["message"] == ""


def test_source_that_breaks_gives_failed_rows(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(
        source={"name": f"{PLUGINS}:broken_source"}, back_ends=["DeadReckoning", "Hindsight"], seeds=2
    )
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert list(results.trials["status"]) == ["crashed"] * 4
    assert results.trials["message"][2].startswith("no stream: ZeroDivisionError: seed 1 (user_plugins.py:")
    assert list(results.trials["completion"]) == [0.0] * 4


def test_missing_data_ends_the_experiment(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(source={"name": f"{PLUGINS}:sourceless"}, back_ends=["DeadReckoning"], seeds=3)
    with pytest.raises(MissingDataError, match=r"park\.txt: there is no such file"):
        run_experiment(path, folder=tmp_path / "r", jobs=1)


@pytest.mark.parametrize("kind", ["source", "front_end"])
def test_what_is_no_log_or_stream_is_said_to_be_none(
    kind: str, write_experiment: Write, tmp_path: Path
) -> None:
    (tmp_path / "empty.py").write_text(
        "def source(seed):\n    pass\ndef front_end(log, seed):\n    return log\n"
    )
    path = write_experiment(back_ends=["DeadReckoning"], **{kind: {"name": f"empty.py:{kind}"}})
    told = {
        "source": r"source 'empty\.py:source' returned NoneType; a Log is needed",
        "front_end": r"front end 'empty\.py:front_end' returned Log; a MeasurementStream is needed",
    }
    with pytest.raises(UsageError, match=told[kind]):
        run_experiment(path, folder=tmp_path / "r", jobs=1)


def test_impossible_grid_point_costs_only_itself(write_experiment: Write, tmp_path: Path) -> None:
    source = {"name": f"{PLUGINS}:only_even"}
    path = write_experiment(
        source=source, back_ends=["DeadReckoning"], sweep={"source.steps": [4, 5, 6]}, seeds=2
    )
    trials = run_experiment(path, folder=tmp_path / "r", jobs=1).trials
    assert list(trials["status"]) == ["ok"] * 2 + ["crashed"] * 2 + ["ok"] * 2
    assert set(trials["message"][2:4]) == {"no stream: steps is 5: an even number is needed"}
    alone = write_experiment(source={**source, "steps": 5}, back_ends=["DeadReckoning", "Hindsight"])
    with pytest.raises(UsageError, match="steps is 5: an even number is needed") as caught:
        run_experiment(alone, folder=tmp_path / "alone", jobs=1)
    assert caught.value.exit_code == 2
    assert list(load_results(tmp_path / "alone").trials["status"]) == ["crashed"] * 2


def test_streams_that_differ_are_never_compared(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    (truth_file,) = (tmp_path / "r" / "streams").glob("*.truth.npz")
    known = load_truth(truth_file)
    save_truth(type(known)("0" * 64, known.frames, known.truth, known.front_end), truth_file)
    with pytest.raises(SlamcmpError, match="ran on different streams"):
        run_experiment(path, folder=tmp_path / "r", jobs=1)
    # What there is stays in the tables, marked.
    assert load_results(tmp_path / "r").trials["status"].tolist() == ["missing"] * 2


def test_truth_file_round_trip(tmp_path: Path) -> None:
    from slamcmp.results.runs.run_file import StoredTruth

    masks = (np.array([True, False]), np.array([], dtype=bool), np.array([False]))
    truth = GroundTruth(np.arange(3.0), np.stack([np.eye(3)] * 3), np.array([4]), np.ones((1, 2)), masks)
    save_truth(StoredTruth("d", 3, truth, {"kept": 2}), tmp_path / "t.npz")
    loaded = load_truth(tmp_path / "t.npz")
    assert (loaded.digest, loaded.frames, loaded.front_end) == ("d", 3, {"kept": 2})
    assert [list(mask) for mask in loaded.truth.outliers] == [[True, False], [], [False]]
    np.testing.assert_array_equal(loaded.truth.positions, [[1.0, 1.0]])


def test_two_runs_into_one_folder_are_refused(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning"])
    message = rf"another run is writing here \(process {os.getpid()}\)"
    with locked(tmp_path / "r"), pytest.raises(UsageError, match=message):
        run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).manifest["jobs_run"] == 2


def test_full_disk_is_one_clear_error_and_loses_nothing(write_experiment: Write, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    first = run_experiment(write_experiment(back_ends=["DeadReckoning"]), folder=folder, jobs=1)
    kept = {each.name: each.read_bytes() for each in (folder / "runs").iterdir()}
    more = write_experiment(back_ends=["DeadReckoning", "MeetsAFullDisk", "Hindsight"])
    with pytest.raises(StorageError, match=r"cannot write .*/runs/.*: File too large; what finished before"):
        run_experiment(more, folder=folder, jobs=1)
    assert {each.name: each.read_bytes() for each in (folder / "runs").iterdir()} == kept
    assert_same(load_results(folder), first)
    rest = run_experiment(write_experiment(back_ends=["DeadReckoning", "Hindsight"]), folder=folder, jobs=1)
    assert (rest.manifest["jobs_run"], rest.manifest["jobs_reused"]) == (1, 1)


@pytest.mark.parametrize("executor", ["processes", "serial"])
def test_folder_that_cannot_be_written_is_named(
    write_experiment: Write, tmp_path: Path, executor: str
) -> None:
    path = write_experiment(back_ends=["DeadReckoning"])
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(StorageError, match=r"cannot write .*/file/r/\.lock: Not a directory"):
        run_experiment(path, folder=tmp_path / "file" / "r", jobs=1, executor=executor)
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "streams").write_text("not a folder")
    with pytest.raises(StorageError, match=r"cannot write .*/streams/"):
        run_experiment(path, folder=tmp_path / "r", jobs=1, executor=executor)


def test_tables_that_cannot_be_written_leave_the_old_ones(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_experiment(back_ends=["DeadReckoning"])
    folder = tmp_path / "r"
    first = run_experiment(path, folder=folder, jobs=1)

    def full(self, file, **options) -> None:
        file.write(b"PAR1")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(pd.DataFrame, "to_parquet", full)
        with pytest.raises(StorageError, match=r"trials\.parquet: No space left on device; what finished"):
            run_experiment(write_experiment(back_ends=["Hindsight"]), folder=folder, jobs=1)
    assert_same(load_results(folder), first)
    assert not [each for each in folder.iterdir() if each.name.startswith(".trials")]
    assert run_experiment(write_experiment(back_ends=["Hindsight"]), folder=folder).manifest["jobs_run"] == 0


def test_interrupted_run_keeps_what_is_done(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_experiment(back_ends=["DeadReckoning"], seeds=3)
    finish = Schedule._finish

    def interrupt_after_three(self, ended) -> None:
        finish(self, ended)
        if self.done == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Schedule, "_finish", interrupt_after_three)
        with pytest.raises(runner.Interrupted, match="3 jobs are left") as caught:
            run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert caught.value.exit_code == 130
    assert 1 <= len(load_results(tmp_path / "r").trials) < 3
    rest = run_experiment(path, folder=tmp_path / "r", jobs=1)
    assert rest.manifest["jobs_run"] == 3
    assert_same(rest, run_experiment(path, folder=tmp_path / "fresh", jobs=1))


def test_workers_have_one_blas_thread_and_no_traces_of_the_caller(tmp_path: Path) -> None:
    (tmp_path / "probe.py").write_text(
        "import json, os, sys\n"
        "from tests.user_plugins import DeadReckoning\n"
        "class Probe(DeadReckoning):\n"
        "    def misbehave(self):\n"
        "        names = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS')\n"
        "        main = getattr(sys.modules['__main__'], '__file__', '') or ''\n"
        "        cv2 = sys.modules.get('cv2')\n"
        "        print(json.dumps([[os.environ.get(n) for n in names], cv2 and cv2.getNumThreads()]))\n"
    )
    (tmp_path / "e.yaml").write_text(
        f"source: {{name: '{PLUGINS}:straight'}}\nback_ends: [{{name: 'probe.py:Probe'}}]\n"
    )
    results = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", jobs=1)
    assert row(results, "Probe")["message"] == ""
    (log,) = (tmp_path / "r" / "logs").iterdir()
    variables, cv2_threads = json.loads(log.read_text())
    assert variables == ["1", "1"]
    assert cv2_threads in (None, 1)


def test_source_that_does_not_end_is_ended(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(
        source={"name": f"{PLUGINS}:endless_source"}, back_ends=["DeadReckoning"], stream_time_limit_s=0.5
    )
    found = row(run_experiment(path, folder=tmp_path / "r", jobs=1), "DeadReckoning")
    assert found["status"] == "crashed"
    assert found["message"] == "no stream: ended 2.5 s after its start: it was stuck"
