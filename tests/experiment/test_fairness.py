"""The README's rules of a fair comparison: for each, a test that fails when the rule is broken."""

from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from slamcmp.errors import DataError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.executors.fork_server import THREAD_VARIABLES
from slamcmp.experiment.gathering.tables import gather
from slamcmp.experiment.job.make_stream import make_stream
from slamcmp.experiment.job.recorder import Recorder
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.experiment.job.task import run_path
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.experiment.runner import run_experiment
from slamcmp.frontend.labelled import labelled
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.metrics import metric_columns, score_run
from slamcmp.registry import metrics
from slamcmp.results.runs.run_file import load_run, save_run
from slamcmp.types import Estimate, MeasurementStream, Problem, Run, Trajectory
from tests import user_plugins
from tests.user_plugins import DeadReckoning, Hindsight

Write = Callable[..., Path]


@pytest.fixture(scope="module")
def stream() -> MeasurementStream:
    return labelled(user_plugins.straight(0, steps=12), 0)


def run(make: Callable[[Problem], Any], stream: MeasurementStream, **options: Any) -> Run:
    return run_back_end(make, stream, label="probe", parameters={}, **options)


def test_every_back_end_of_a_trial_gets_the_same_stream(tmp_path: Path) -> None:
    """Each hashes what it is fed; the digest of the rows is that of the frozen stream."""
    (tmp_path / "probe.py").write_text(
        "import hashlib\n"
        "from tests.user_plugins import DeadReckoning\n"
        "class One(DeadReckoning):\n"
        "    def __init__(self, problem):\n"
        "        super().__init__(problem)\n"
        "        self.fed = hashlib.sha256(problem.T_world_body.tobytes() + problem.P.tobytes())\n"
        "    def update(self, frame):\n"
        "        super().update(frame)\n"
        "        for each in (frame.T_prev_body, frame.Q, frame.ids, frame.z, frame.R):\n"
        "            self.fed.update(each.tobytes())\n"
        "    def diagnostics(self):\n"
        "        return {'fed': float(int(self.fed.hexdigest()[:12], 16))}\n"
        "class Two(One):\n    pass\n"
    )
    (tmp_path / "e.yaml").write_text(
        "source: {name: circle, steps: 20}\nseeds: 2\n"
        "back_ends: [{name: 'probe.py:One'}, {name: 'probe.py:Two'}]\n"
    )
    results = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", jobs=2)
    last = results.frames[results.frames["k"] == 19]
    for seed in (0, 1):
        made, _ = make_stream(("circle", {"steps": 20}), ("labelled", {}), seed)
        rows = results.trials[results.trials["seed"] == seed]
        assert set(rows["digest"]) == {made.digest}
        assert last[last["seed"] == seed]["fed"].nunique() == 1
    assert last["fed"].nunique() == 2


def test_rows_of_different_streams_do_not_get_into_one_table(write_experiment: Write, tmp_path: Path) -> None:
    path = write_experiment(back_ends=["DeadReckoning", "Hindsight"])
    run_experiment(path, folder=tmp_path / "r", jobs=1)
    trials = make_trials(load_experiment(path))
    other = run_path(tmp_path / "r", trials[0].runs[1].key)
    stored = load_run(other)
    save_run(replace(stored, run=replace(stored.run, digest="0" * 64)), other)
    tables = gather(trials, tmp_path / "r", None, {})
    assert "ran on different streams" in str(tables.fault)
    assert tables.trials["status"].tolist() == ["ok", "missing"]
    assert tables.trials["online_ate"].notna().tolist() == [True, False]
    assert set(tables.frames["label"]) == {tables.trials["label"][0]}


def test_back_end_cannot_change_what_it_is_fed(stream: MeasurementStream) -> None:
    for frame in stream.frames[:2]:
        for array in (frame.T_prev_body, frame.Q, frame.ids, frame.z, frame.R):
            assert not array.flags.writeable
    assert not stream.problem.T_world_body.flags.writeable
    assert not stream.problem.P.flags.writeable


def test_back_end_gets_the_problem_and_then_one_frame_at_a_time(tmp_path: Path) -> None:
    """Through what it is handed it reaches neither a later frame nor the truth."""
    made, _ = make_stream(("circle", {"steps": 15}), ("labelled", {}), 0)
    save_stream(made, tmp_path / "s.npz")
    stream = load_stream(tmp_path / "s.npz")
    handed: list[tuple[Any, ...]] = []

    class Probe(DeadReckoning):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            handed.append(arguments)

        def update(self, *arguments: Any) -> None:
            super().update(*arguments)
            handed.append(arguments)

    assert run(Probe, stream).status == "ok"
    assert [len(arguments) for arguments in handed] == [1] * 16
    assert handed[0] == (stream.problem,)
    assert [frame.k for (frame,) in handed[1:]] == list(range(15))
    for k, (frame,) in enumerate(handed[1:]):
        assert frame is stream.frames[k]
        for array in (frame.T_prev_body, frame.Q, frame.ids, frame.z, frame.R):
            # The whole log's array behind a slice would be the future.
            assert array.base is None or array.base.size == array.size
    others = {id(frame) for frame in stream.frames}
    for (thing,) in handed:
        inside = [thing]
        for _ in range(3):
            inside = [each for one in inside for each in gc.get_referents(one) if not isinstance(each, type)]
            assert not {id(each) for each in inside if each is not thing} & others
            assert "GroundTruth" not in {type(each).__name__ for each in inside}


def test_stream_file_holds_no_truth(write_experiment: Write, tmp_path: Path) -> None:
    run_experiment(write_experiment(back_ends=["LooksForTruth"]), folder=tmp_path / "r", jobs=1)
    (file,) = [each for each in (tmp_path / "r" / "streams").iterdir() if ".truth." not in each.name]
    with np.load(file) as stored:
        known = {"header", "prior_T", "prior_P", "t", "T_prev_body", "Q", "size", "ids", "z", "R"}
        assert set(stored.files) <= known | {"counts", "kept", "kept_size"}


PAUSE_S = 0.02


class Sleepy(Hindsight):
    """Sleeps in one of its methods."""

    def __init__(self, problem: Problem, where: str) -> None:
        self.where = ""
        super().__init__(problem)
        self.where = where
        self.sleep("construction")

    def sleep(self, where: str) -> None:
        if where == self.where:
            time.sleep(PAUSE_S)

    def update(self, frame) -> None:
        self.sleep("update")
        super().update(frame)

    def estimate(self) -> Estimate:
        self.sleep("estimate")
        return super().estimate()

    def diagnostics(self) -> dict[str, float]:
        self.sleep("diagnostics")
        return {"n": 1.0}

    def kept_observations(self) -> np.ndarray:
        self.sleep("kept")
        return np.empty(0, dtype=bool)

    def trajectory(self) -> Trajectory:
        self.sleep("trajectory")
        return super().trajectory()

    def landmarks(self):
        self.sleep("landmarks")
        from slamcmp.types import Landmarks

        return Landmarks(np.empty(0, dtype=int), np.empty((0, 2)), np.empty((0, 2, 2)))


@pytest.mark.parametrize(
    "where", ["construction", "update", "estimate", "diagnostics", "kept", "trajectory", "landmarks"]
)
def test_each_time_holds_its_own_call_and_no_other(stream: MeasurementStream, where: str) -> None:
    result = run(lambda problem: Sleepy(problem, where), stream)
    assert result.status == "ok", result.message
    slow = {
        "update": bool(np.median(result.update_s) >= PAUSE_S),
        "estimate": bool(np.median(result.estimate_s) >= PAUSE_S),
        "trajectory": result.final_s >= PAUSE_S,
    }
    assert slow == {name: name == where for name in slow}


def test_run_that_is_looked_at_tells_no_times(stream: MeasurementStream) -> None:
    recorder = Recorder(Record(observability=True), len(stream.frames))
    result = run(lambda problem: Sleepy(problem, "update"), stream, after_frame=recorder.after_frame)
    assert np.isnan(result.update_s).all()
    assert np.isnan(result.estimate_s).all()
    assert np.isnan(result.final_s)
    assert np.isnan(result.peak_memory_mb)


@pytest.mark.parametrize("shift_s", [1.0, 0.5, 1e-3, 1e-6])
def test_stamps_must_be_those_of_the_frames(stream: MeasurementStream, shift_s: float) -> None:
    class Late(Hindsight):
        def trajectory(self) -> Trajectory:
            exact = super().trajectory()
            return Trajectory(exact.t + np.where(exact.t == 7, shift_s, 0.0), exact.T_world_body)

    result = run(Late, stream)
    assert (result.status, result.final) == ("crashed", None)
    assert "t[7]" in result.message
    assert "where frame 7 is at 7.0 s" in result.message


@pytest.mark.parametrize("shift_s", [1.0, 1e-3, 1e-6])
def test_scores_are_refused_where_the_stamps_of_the_truth_differ(
    stream: MeasurementStream, shift_s: float
) -> None:
    truth = user_plugins.straight(0, steps=12).truth
    result = run(Hindsight, stream)
    assert np.isfinite(score_run(result, truth)["online_ate"])
    with pytest.raises(DataError, match="stamps"):
        score_run(result, replace(truth, t=truth.t + shift_s))


class Learns(DeadReckoning):
    """Online it stands a metre to the left, in hindsight two metres to the right."""

    def estimate(self) -> Estimate:
        T = np.array(self.T)
        T[1, 2] += 1.0
        return Estimate(T, self.P)

    def trajectory(self) -> Trajectory:
        poses = np.stack(self.poses)
        poses[:, 1, 2] -= 2.0
        return Trajectory(np.arange(len(poses), dtype=float), poses)


def test_online_and_final_are_told_apart_in_every_column() -> None:
    for plugin in metrics:
        columns = [name for name in metric_columns() if name.endswith(plugin.name)]
        if plugin.traits["scope"] == "trajectory":
            assert {f"online_{plugin.name}", f"final_{plugin.name}"} <= set(columns)
            assert plugin.name not in columns
    truth = user_plugins.straight(0, steps=12, sigma_m=1e-9).truth
    exact = labelled(user_plugins.straight(0, steps=12, sigma_m=1e-9), 0)
    scores = score_run(run(Learns, exact), truth)
    assert scores["online_ate"] == pytest.approx(1.0, abs=1e-6)
    assert scores["final_ate"] == pytest.approx(2.0, abs=1e-6)
    # A filter has no final trajectory: its column stays empty rather than showing the online one.
    assert np.isnan(score_run(run(DeadReckoning, exact), truth)["final_ate"])


def test_frames_table_tells_online_and_final_apart(tmp_path: Path) -> None:
    (tmp_path / "learns.py").write_text("from tests.experiment.test_fairness import Learns\n")
    source = f"{{name: '{user_plugins.__file__}:straight', steps: 12, sigma_m: 0.000000001}}"
    (tmp_path / "e.yaml").write_text(f"source: {source}\nback_ends: [{{name: 'learns.py:Learns'}}]\n")
    frames = run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", executor="serial").frames
    np.testing.assert_allclose(frames["online_y"], 1.0, atol=1e-6)
    np.testing.assert_allclose(frames["final_y"], -2.0, atol=1e-6)
    np.testing.assert_allclose(frames["online_position_error_m"], 1.0, atol=1e-6)
    np.testing.assert_allclose(frames["final_position_error_m"], 2.0, atol=1e-6)


def test_every_worker_has_one_thread_of_every_library(tmp_path: Path) -> None:
    (tmp_path / "probe.py").write_text(
        "import json, os\n"
        "from tests.user_plugins import DeadReckoning\n"
        "class Probe(DeadReckoning):\n"
        "    def misbehave(self):\n"
        f"        print(json.dumps([os.environ.get(name) for name in {THREAD_VARIABLES!r}]))\n"
    )
    (tmp_path / "e.yaml").write_text(
        f"source: {{name: '{user_plugins.__file__}:straight'}}\nback_ends: [{{name: 'probe.py:Probe'}}]\n"
    )
    run_experiment(tmp_path / "e.yaml", folder=tmp_path / "r", jobs=1)
    (log,) = (tmp_path / "r" / "logs").iterdir()
    assert json.loads(log.read_text()) == ["1"] * len(THREAD_VARIABLES)
    # Of every library that brings a pool of its own.
    pools = ("OPENBLAS", "OMP", "MKL", "BLIS", "NUMEXPR")
    assert {f"{name}_NUM_THREADS" for name in pools} | {"VECLIB_MAXIMUM_THREADS"} <= set(THREAD_VARIABLES)


def test_order_of_back_ends_makes_no_difference(write_experiment: Write, tmp_path: Path) -> None:
    """Nothing is left behind by one run for the next, also where all run in one process."""
    names = ["DeadReckoning", "Raises", "Hindsight"]
    tables = []
    for order in (names, names[::-1]):
        path = write_experiment(back_ends=order, seeds=2)
        results = run_experiment(path, folder=tmp_path / order[0], executor="serial")
        found = results.trials.sort_values(["seed", "label"]).reset_index(drop=True)
        tables.append(found[["seed", "label", "digest", "status", "message", "online_ate", "final_ate"]])
    pd.testing.assert_frame_equal(*tables, check_exact=True)
