"""Each field of a key, by itself: a key that leaves one out gives results of another question."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from slamcmp.experiment import content_key
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.content_key import run_code, run_key, stream_code, stream_key
from slamcmp.experiment.job.task import Task, stream_path, truth_path
from slamcmp.experiment.job.worker import perform
from slamcmp.results.runs.run_file import load_run, load_truth
from slamcmp.support.provenance import code_version
from slamcmp.support.provenance.code_version import LIBRARIES, PACKAGE, import_closure, versions
from tests.conftest import PLUGINS

SOURCE = Component("source", "circle", "circle", {"steps": 20})
FRONT_END = Component("front end", "labelled", "labelled", {"gate_probability": None})
BACK_END = Component("back end", "ekf_slam", "ekf_slam", {})


def user(kind: str, name: str, **parameters: Any) -> Component:
    return Component(kind, f"{PLUGINS.name}:{name}", f"{PLUGINS}:{name}", parameters)


STREAM: dict[str, tuple[Component, Component, int | None]] = {
    "base": (SOURCE, FRONT_END, 0),
    "source's parameter": (SOURCE.with_parameter("steps", 21), FRONT_END, 0),
    "front end's parameter": (SOURCE, FRONT_END.with_parameter("gate_probability", 0.99), 0),
    "seed": (SOURCE, FRONT_END, 1),
    "no seed": (SOURCE, FRONT_END, None),
    # One file, so one code: only the names differ.
    "one function of a file": (user("source", "straight"), FRONT_END, 0),
    "another of the same file": (user("source", "only_even"), FRONT_END, 0),
    "one front end of a file": (SOURCE, user("front end", "straight"), 0),
    "another front end of the same file": (SOURCE, user("front end", "only_even"), 0),
}
RUN: dict[str, dict[str, Any]] = {
    "base": {},
    "stream": {"stream": "t"},
    "one class of a file": {"back_end": user("back end", "Hindsight")},
    "another of the same file": {"back_end": user("back end", "Raises")},
    "parameter": {"back_end": user("back end", "Hindsight", at=3)},
    "own gate": {"back_end": replace(BACK_END, own_gate=0.99)},
    "another own gate": {"back_end": replace(BACK_END, own_gate=0.9)},
    "time limit": {"time_limit_s": 2.0},
    "memory limit": {"memory_limit_mb": 100.0},
    "another memory limit": {"memory_limit_mb": 200.0},
    "observability": {"recording": Record(observability=True).recording()},
    "posteriors": {"recording": Record(divergence_from="batch").recording()},
    "every": {"recording": Record(observability=True, every=3).recording()},
}


def key_of_run(**changed: Any) -> str:
    given = {
        "stream": "s",
        "back_end": BACK_END,
        "time_limit_s": 1.0,
        "memory_limit_mb": None,
        "recording": None,
    }
    return run_key(**(given | changed))


def key_of_stream() -> str:
    return stream_key(SOURCE, FRONT_END, 0)


def test_each_field_of_a_stream_counts_alone() -> None:
    keys = {name: stream_key(*given) for name, given in STREAM.items()}
    assert len(set(keys.values())) == len(keys), keys


def test_each_field_of_a_run_counts_alone() -> None:
    keys = {name: key_of_run(**changed) for name, changed in RUN.items()}
    assert len(set(keys.values())) == len(keys), keys


@pytest.mark.parametrize("key", [key_of_stream, key_of_run])
def test_each_library_and_python_count(key: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> None:
    known = versions()
    assert (
        set(known)
        == {"python", "numpy", "scipy", "gtsam", "opencv-python-headless"}
        == {"python", *LIBRARIES}
    )
    seen = {key()}
    for name in known:
        monkeypatch.setattr(content_key, "versions", lambda name=name: {**known, name: "0"})
        seen.add(key())
    assert len(seen) == 1 + len(known)


@pytest.mark.parametrize("key", [key_of_stream, key_of_run])
def test_a_library_that_only_this_code_needs_counts(
    key: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = {key()}
    for version in ("absent", "0.68.1"):
        monkeypatch.setattr(content_key, "other_libraries", lambda files, v=version: {"numba": v})
        seen.add(key())
    assert len(seen) == 3


def test_versions_are_those_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    found = versions()
    assert found["numpy"] == np.__version__
    assert found["python"] == f"{sys.version_info[0]}.{sys.version_info[1]}"
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"{name} 7")
    assert versions.__wrapped__()["gtsam"] == "gtsam 7"


def follows(key: Callable[[], str], module: str, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the key changes with the text of one module."""
    victim = PACKAGE / module
    assert victim.is_file()
    before, read = key(), code_version._source
    with monkeypatch.context() as patched:
        changed = lambda path: replace(read(path), digest="00" * 32) if path == victim else read(path)  # noqa: E731
        patched.setattr(code_version, "_source", changed)
        return key() != before


@pytest.mark.parametrize(
    "module",
    [
        "backends/filters/ekf_slam.py",
        "backends/own_gate.py",
        "experiment/job/recorder.py",
        "experiment/job/run_back_end.py",
        "experiment/job/worker.py",
        "frontend/stream_file.py",
        "geometry.py",
        "metrics/accuracy.py",
        "metrics/consistency.py",
        "metrics/gating.py",
        "metrics/tables.py",
        "models/camera.py",
        "models/sensors.py",
        "registry.py",
        "results/runs/posteriors.py",
        "results/runs/run_file.py",
        "types/stream.py",
    ],
)
def test_run_follows_each_module_that_computes_it(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert follows(key_of_run, module, monkeypatch)


@pytest.mark.parametrize(
    "module",
    [
        "experiment/job/make_stream.py",
        "frontend/labelled.py",
        "frontend/stream_file.py",
        "models/camera.py",
        "models/motion.py",
        "randomness.py",
        "results/runs/run_file.py",
        "types/stream.py",
        "worlds/planar.py",
        "worlds/simulate.py",
    ],
)
def test_stream_follows_each_module_that_makes_it(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert follows(key_of_stream, module, monkeypatch)


@pytest.mark.parametrize(
    "module", ["backends/gtsam_smoothers/batch.py", "experiment/runner.py", "report/html.py", "cli/run.py"]
)
def test_keys_follow_nothing_else(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = module if (PACKAGE / module).is_file() else "report/__init__.py"
    assert not follows(key_of_run, module, monkeypatch)
    assert not follows(key_of_stream, module, monkeypatch)


def executed(action: Callable[[], object]) -> set[Path]:
    """The files of the package whose functions ran."""
    found: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            found.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
    return {path for path in map(Path, found) if path.is_relative_to(PACKAGE)}


def test_whatever_runs_in_a_job_is_in_its_key(tmp_path: Path) -> None:
    """The imports that were followed against the functions that were called."""
    beat = [0.0] * 8
    plugins = ((SOURCE.spec, dict(SOURCE.parameters)), (FRONT_END.spec, {"gate_probability": 0.999}))
    stream = Task("stream", "s", tmp_path, plugins, 0)
    ran = executed(lambda: perform(stream, beat))
    assert PACKAGE / "worlds" / "simulate.py" in ran
    # The worker only chooses which of the two jobs is done.
    assert ran - import_closure(stream_code(SOURCE, FRONT_END)) <= {
        PACKAGE / "experiment" / "job" / "worker.py"
    }
    known = load_truth(truth_path(tmp_path, "s"))
    assert known is not None
    assert stream_path(tmp_path, known.digest).is_file()
    record = Record(observability=True, divergence_from="ekf_slam", every=5)
    for name in ("ekf_slam", "batch"):
        back_end = Component("back end", name, name, {}, own_gate=0.999 if name == "ekf_slam" else None)
        run = Task(
            "run",
            name,
            tmp_path,
            ((name, {}),),
            0,
            label=name,
            stream_key="s",
            digest=known.digest,
            record=record,
            own_gate=back_end.own_gate,
        )
        ran = executed(lambda run=run: perform(run, beat))
        assert {PACKAGE / "metrics" / "accuracy.py", PACKAGE / "experiment" / "job" / "recorder.py"} <= ran
        assert ran <= import_closure(run_code(back_end))
        stored = load_run(run.result)
        assert stored is not None
        assert stored.run.status == "ok"


def test_keys_of_many_seeds_are_those_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the seed is written and hashed once; no file is looked at again for a further key."""
    of_streams, of_runs = (
        content_key.stream_keys(SOURCE, FRONT_END),
        content_key.run_keys(BACK_END, 600.0, None),
    )
    singly = {seed: stream_key(SOURCE, FRONT_END, seed) for seed in (None, 0, 1, 2**53)}
    runs = {key: run_key(key, BACK_END, 600.0, None) for key in singly.values()}
    for name in ("stream_code", "run_code", "data_files"):
        monkeypatch.setattr(content_key, name, lambda *_: pytest.fail("looked again"))
    assert {seed: of_streams(seed) for seed in singly} == singly
    assert {key: of_runs(key) for key in runs} == runs
    assert len({*singly.values(), *runs.values()}) == 8
