"""What goes wrong after the last frame costs the answers given there, never the online part."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from slamcmp.experiment.job import worker
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import Results

Write = Callable[..., Path]


def by_label(results: Results) -> pd.DataFrame:
    return results.trials.set_index("label")


def test_answers_of_the_wrong_shape_are_named(write_experiment: Write, tmp_path: Path) -> None:
    expected = {
        "OtherStamps": "ValueError: trajectory() has t[1] = 0.1 s where frame 1 is at 1.0 s",
        "SpatialPoses": "ValueError: trajectory() has poses of shape (4, 4) where (3, 3) is needed",
        "SpatialMap": "ValueError: landmarks() has positions of shape (1, 3) where (any, 2) is needed",
        "NoMap": "TypeError: landmarks() gave dict where Landmarks are needed",
    }
    path = write_experiment(back_ends=["DeadReckoning", *expected])
    results = run_experiment(path, folder=tmp_path / "r", jobs=2)
    rows = by_label(results)
    for label, message in expected.items():
        assert rows.loc[label, "status"] == "crashed"
        assert rows.loc[label, "message"].startswith(f"after the last frame: {message}")
        assert rows.loc[label, "online_ate"] == rows.loc["DeadReckoning", "online_ate"]
        assert (results.frames["label"] == label).sum() == 40
    logs = [log.read_text() for log in (tmp_path / "r" / "logs").iterdir()]
    assert sum("Traceback (most recent call last)" in text for text in logs) == len(expected)


def test_scoring_that_fails_keeps_the_online_part(
    write_experiment: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    score = worker.score_run

    def fail_with_hindsight(run, truth):
        if run.final is not None:
            raise KeyError("a metric's mistake")
        return score(run, truth)

    monkeypatch.setattr(worker, "score_run", fail_with_hindsight)
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    rows = by_label(run_experiment(path, folder=tmp_path / "r", executor="serial"))
    assert rows.loc["Hindsight", "status"] == "crashed"
    assert rows.loc["Hindsight", "message"].startswith(
        'it could not be scored: KeyError: "a metric\'s mistake" (test_after_the_last_frame.py:'
    )
    assert rows.loc["Hindsight", "online_ate"] == rows.loc["DeadReckoning", "online_ate"]
    assert np.isnan(rows.loc["Hindsight", "final_ate"])


def test_fault_outside_the_back_end_leaves_a_traceback_in_the_log(
    write_experiment: Write, tmp_path: Path
) -> None:
    """A stream that vanished under the worker: nothing of the back end's doing."""
    path = write_experiment(back_ends=["DeadReckoning"])
    folder = tmp_path / "r"
    run_experiment(path, folder=folder, jobs=1)
    (stream,) = [each for each in (folder / "streams").iterdir() if "truth" not in each.name]
    stored = np.load(stream, allow_pickle=False)
    np.savez(stream, **{name: stored[name] for name in stored.files if name != "z"})
    results = run_experiment(
        write_experiment(back_ends=[{"name": "DeadReckoning", "at": 3}]), folder=folder, jobs=1
    )
    message = by_label(results).loc["DeadReckoning", "message"]
    assert "the worker process ended with exit code 1 and left no result; its output is in" in message
    (log,) = (folder / "logs").iterdir()
    assert "DataError" in log.read_text()


def test_end_phase_has_its_own_budget_and_keeps_the_online_part(
    write_experiment: Write, tmp_path: Path
) -> None:
    names = ["DeadReckoning", "SlowFramesAndMap", "EndlessMap", "MapSegfaults"]
    path = write_experiment(back_ends=names, time_limit_s=1.5)
    results = run_experiment(path, folder=tmp_path / "r", jobs=4)
    rows = by_label(results)
    assert list(rows["status"]) == ["ok", "ok", "timed_out", "crashed"]
    assert rows.loc["EndlessMap", "message"] == (
        "after 40 of 40 frames: what it is asked after the last frame took longer than 3.5 s"
    )
    assert rows.loc["MapSegfaults", "message"].startswith(
        "after 40 of 40 frames: the worker process was killed by SIGSEGV and left no result"
    )
    assert set(rows["completion"]) == {1.0}
    assert rows["online_ate"].nunique() == 1
    assert (results.frames["label"].value_counts() == 40).all()
    assert not [each.name for each in (tmp_path / "r" / "runs").iterdir() if each.name.startswith(".")]


def test_covariances_that_hang_inside_a_library_cost_no_online_figure(
    write_experiment: Write, tmp_path: Path
) -> None:
    """Of every pose, of pose and map together, and of the newest pose at frame 30: each timed out, with the
    numbers that a run without a time-out has for the same frames."""
    hanging = ["FinalCovariancesHang", "JointCovarianceHangs", "CovarianceHangsAt"]
    path = write_experiment(back_ends=["DeadReckoning", *hanging], time_limit_s=0.8)
    results = run_experiment(path, folder=tmp_path / "r", jobs=4)
    rows = by_label(results)
    assert list(rows["status"]) == ["ok", "timed_out", "timed_out", "timed_out"], rows["message"]
    clean = rows.loc["DeadReckoning"]
    for label in hanging[:2]:
        assert rows.loc[label, "message"].startswith("after 40 of 40 frames: what it is asked after the last")
        for column in ("online_ate", "online_max_error", "online_last_pose_error", "online_pose_nees"):
            assert rows.loc[label, column] == clean[column]
        assert rows.loc[label, "completion"] == 1.0
    assert rows.loc["CovarianceHangsAt", "completion"] == 30 / 40
    frames = results.frames.set_index(["label", "k"])
    for column in ("online_position_error_m", "online_nees"):
        np.testing.assert_array_equal(
            frames.loc["CovarianceHangsAt"][column], frames.loc["DeadReckoning"][column].iloc[:30]
        )


def test_complete_result_outlives_the_death_of_its_process(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "DiesInTheEnd"])
    results = run_experiment(path, folder=tmp_path / "r", jobs=1)
    rows = by_label(results)
    assert list(rows["status"]) == ["ok", "ok"]
    assert rows.loc["DiesInTheEnd", "message"] == "afterwards the worker process was killed by SIGSEGV"
    assert rows.loc["DiesInTheEnd", "online_ate"] == rows.loc["DeadReckoning", "online_ate"]
