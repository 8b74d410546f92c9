"""Sweeps of many trials: few files, nothing read twice, and every rule of small ones."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from slamcmp.experiment import packing
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.gathering import tables
from slamcmp.experiment.job.task import run_path
from slamcmp.experiment.planning.plan import plan_experiment
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.runs.gathered import GatheredParts
from slamcmp.results.runs.stored_runs import stored_run
from slamcmp.results.runs.streams import known_streams
from slamcmp.results.store import Results, load_results
from slamcmp.support.files.packed_files import packed_files

TEXT = """\
name: sweep
source: {name: circle, steps: 8, landmarks: 4}
back_ends: [{name: ekf_slam}, {name: dead_reckoning, label: "%s"}]
sweep: {source.noise_scale: [0.5, 1.0]}
seeds: %d
"""


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a few runs, so that some are enough."""
    monkeypatch.setattr(tables, "BLOCK_RUNS", 8)
    monkeypatch.setattr(packing, "PACK_FILES", 12)


def write(folder: Path, seeds: int = 6, label: str = "wheels") -> Path:
    path = folder / "e.yaml"
    path.write_text(TEXT % (label, seeds))
    return path


def run(path: Path, folder: Path, **options: Any) -> Results:
    return run_experiment(path, folder=folder, executor="serial", **options)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Results]:
    """A finished sweep in packs and parts, to be copied; and its tables without either."""
    folder = tmp_path_factory.mktemp("swept")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "BLOCK_RUNS", 10**6)
        plain = run(write(folder), folder / "r")
        assert not (folder / "r" / "store").exists()
        patch.setattr(tables, "BLOCK_RUNS", 8)
        run(write(folder), folder / "r")
    return folder, plain


@pytest.fixture
def copied(swept: tuple[Path, Results], tmp_path: Path) -> tuple[Path, Path, Results]:
    folder, plain = swept
    shutil.copytree(folder / "r", tmp_path / "r")
    return write(tmp_path), tmp_path / "r", plain


def same(found: Results, expected: Results) -> None:
    for name in ("trials", "frames", "landmarks"):
        pd.testing.assert_frame_equal(getattr(found, name), getattr(expected, name))


def test_tables_of_parts_are_those_of_the_runs(copied: tuple[Path, Path, Results]) -> None:
    path, folder, plain = copied
    assert len(os.listdir(folder / "runs")) + len(os.listdir(folder / "streams")) == 0
    again = run(path, folder)
    same(again, plain)
    same(load_results(folder), load_results(folder))
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (0, 24)
    for key in ("front_end_totals", "warnings", "jobs_missing"):
        assert again.manifest[key] == plain.manifest[key]
    assert len(known_streams(folder)) == 12
    assert stored_run(again, "ekf_slam", 3).digest == plain.trials["digest"].iloc[6]


def test_no_run_of_a_settled_trial_is_read(
    copied: tuple[Path, Path, Results], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, folder, plain = copied

    def read(file: Path) -> None:
        raise AssertionError(file)

    monkeypatch.setattr(tables, "load_run", read)
    monkeypatch.setattr(tables, "load_truth", read)
    same(run(path, folder), plain)


def test_files_are_packed_while_others_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    most = []
    done = packing.Packing.run_done

    def look(self: packing.Packing, task: Any) -> None:
        done(self, task)
        most.append(len(list(tmp_path.glob("r/runs/*.npz"))) + len(list(tmp_path.glob("r/streams/*.npz"))))

    monkeypatch.setattr(packing.Packing, "run_done", look)
    assert set(run_experiment(write(tmp_path, 12), folder=tmp_path / "r", jobs=2).trials["status"]) == {"ok"}
    assert len(most) == 48
    assert max(most) < 12 + 4 * 4


def test_what_is_new_is_run_and_what_is_there_is_not(copied: tuple[Path, Path, Results]) -> None:
    """More seeds move the numbers of trials; another label asks for its rows anew, and for no run."""
    path, folder, plain = copied
    more = run(write(path.parent, 8), folder)
    assert (more.manifest["jobs_run"], more.manifest["jobs_reused"]) == (12, 24)
    assert more.trials["trial"].tolist() == [trial for trial in range(16) for _ in range(2)]
    keys = ["source.noise_scale", "seed", "label"]
    old = more.trials.merge(plain.trials[keys], on=keys)
    drop = ["trial"]
    pd.testing.assert_frame_equal(old.drop(columns=drop), plain.trials.drop(columns=drop))
    fresh = run_experiment(path, folder=path.parent / "fresh", executor="serial")
    measured = more.trials.columns.str.contains("_ms$|_s$|memory")
    pd.testing.assert_frame_equal(more.trials.loc[:, ~measured], fresh.trials.loc[:, ~measured])
    renamed = run(write(path.parent, 8, "odometry"), folder)
    assert renamed.manifest["jobs_run"] == 0
    assert set(renamed.trials["label"]) == {"ekf_slam", "odometry"}


def test_a_result_that_is_gone_or_damaged_is_computed_again(copied: tuple[Path, Path, Results]) -> None:
    path, folder, plain = copied
    trial = make_trials(load_experiment(path))[3]
    name = f"runs/{trial.runs[0].key}.npz"
    packs = packed_files(folder)
    packs.forget(name)
    plan = plan_experiment(load_experiment(path), folder)
    assert list(plan.runs) == [trial.runs[0].key]
    again = run(path, folder)
    assert (again.manifest["jobs_run"], again.manifest["jobs_reused"]) == (1, 23)
    assert run_path(folder, trial.runs[0].key).is_file()
    steady = ~plain.trials.columns.str.contains("_ms$|_s$|memory")
    pd.testing.assert_frame_equal(again.trials.loc[:, steady], plain.trials.loc[:, steady])
    # A part whose table is damaged: its runs are read again.
    spoilt = sorted((folder / "store").glob("gathered-*.frames.parquet"))[0]
    spoilt.write_bytes(spoilt.read_bytes()[:-10] + b"0123456789")
    third = run(path, folder)
    assert third.manifest["jobs_run"] == 0
    same(third, again)


@pytest.mark.parametrize("what", ["store", "packs", "parts", "one pack cut"])
def test_rows_never_vanish_with_the_store(copied: tuple[Path, Path, Results], what: str) -> None:
    path, folder, plain = copied
    if what == "store":
        shutil.rmtree(folder / "store")
    elif what == "one pack cut":
        (pack,) = (folder / "store").glob("*.pack")
        pack.write_bytes(pack.read_bytes()[: pack.stat().st_size // 2])
    else:
        for file in (folder / "store").glob("*.pack" if what == "packs" else "gathered-*"):
            file.unlink()
    again = run(path, folder)
    assert set(again.trials["status"]) == {"ok"}
    assert len(again.trials) == 24
    runs = again.manifest["jobs_run"]
    assert runs == (0 if what == "parts" else runs) < 37
    assert (runs > 0) == (what != "parts")
    steady = ~plain.frames.columns.str.endswith("_s")
    pd.testing.assert_frame_equal(again.frames.loc[:, steady], plain.frames.loc[:, steady])


def test_failed_runs_are_settled_until_they_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text((TEXT % ("wheels", 4)).replace("seeds", "time_limit_s: 0.0000001\nseeds"))
    first = run(path, tmp_path / "r")
    assert set(first.trials["status"]) == {"timed_out"}
    same(run(path, tmp_path / "r"), first)
    parts = GatheredParts(tmp_path / "r")
    assert parts.trials
    assert not any(settled.is_ok for settled in parts.trials.values())
    again = run(path, tmp_path / "r", rerun_failed=True)
    assert again.manifest["jobs_run"] == 16


def test_a_run_that_is_killed_in_the_middle_loses_no_finished_job(tmp_path: Path) -> None:
    """kill -9 at three moments, each while files are packed; what is left is run once."""
    path, folder = write(tmp_path, 12), tmp_path / "r"
    known: set[str] = set()
    for _ in range(3):
        before, begin = len(known), time.monotonic()
        child = os.fork()
        if child == 0:
            with contextlib.suppress(BaseException):
                run(path, folder)
            os._exit(0)
        while time.monotonic() < begin + 60:
            names = {name for name in packed_files(folder).names() if name.startswith("runs/")}
            names |= {f"runs/{name.name}" for name in folder.glob("runs/*.npz")}
            if len(names) >= before + 9:
                break
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        there = {name for name in packed_files(folder).names() if name.startswith("runs/")}
        there |= {f"runs/{name.name}" for name in folder.glob("runs/*.npz")}
        assert known <= there
        known = there
    results = run(path, folder)
    assert set(results.trials["status"]) == {"ok"}
    assert results.manifest["jobs_reused"] >= len(known)
    assert len(results.trials) == 48
