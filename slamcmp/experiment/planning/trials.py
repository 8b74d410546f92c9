"""Grid × seeds: the trials of an experiment, and the jobs they need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from slamcmp.experiment.config.component import Component, swept_target
from slamcmp.experiment.config.experiment import Experiment, grid
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.content_key import Snapshot, run_code, run_keys, stream_code, stream_keys


@dataclass(frozen=True, slots=True)
class StreamJob:
    """Make the measurement stream of a trial, and put its truth aside."""

    key: str
    source: Component
    front_end: Component
    seed: int | None
    code: Mapping[str, str] = field(default_factory=dict)
    """sha256 of each source file that the key names, by path."""
    data: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """What each declared data file looked like when it was hashed."""

    @property
    def stream_key(self) -> str:
        """Of the stream that it waits for: none."""
        return ""


@dataclass(frozen=True, slots=True)
class RunJob:
    """Run one back end over the stream of a trial."""

    key: str
    stream_key: str
    back_end: Component
    seed: int | None
    time_limit_s: float
    memory_limit_mb: float | None
    record: Record | None = None
    code: Mapping[str, str] = field(default_factory=dict)
    """sha256 of each source file that the key names, by path."""
    data: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """What each declared data file looked like when it was hashed."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One grid point with one seed or recording: one stream, and a run of each back end on it."""

    number: int
    seed: int | None
    """Of paired samples the number: the seed, or which of several recordings this is."""
    swept: Mapping[str, Any]
    stream: StreamJob
    runs: tuple[RunJob, ...]
    recording: str = ""
    """Of several recordings the name of this one."""


def make_trials(experiment: Experiment) -> list[Trial]:
    """Every trial, grid points in the order of the file and seeds (or recordings) innermost."""
    trials: list[Trial] = []
    snapshot = Snapshot()
    limits = experiment.time_limit_s, experiment.memory_limit_mb
    record = experiment.record
    recording = None if record is None else record.recording()
    for swept, (number, recording_of) in product(grid(experiment), enumerate(experiment.recordings or ({},))):
        source, front_end, back_ends = _apply(experiment, swept)
        for parameter, value in recording_of.items():
            source = source.with_parameter(parameter, value)
        made_by = snapshot.code(stream_code(source, front_end))
        run_by = [snapshot.code(run_code(each)) for each in back_ends]
        key_of_stream = stream_keys(source, front_end, snapshot)
        data = {**snapshot.data(source).stamps, **snapshot.data(front_end).stamps}
        of_runs = [
            (run_keys(each, *limits, recording, snapshot), each, code, snapshot.data(each).stamps)
            for each, code in zip(back_ends, run_by, strict=True)
        ]
        for seed in experiment.seeds:
            key = key_of_stream(seed)
            stream = StreamJob(key, source, front_end, seed, made_by, data)
            runs = tuple(
                RunJob(key_on(key), key, each, seed, *limits, record, code, stamps)
                for key_on, each, code, stamps in of_runs
            )
            sample = number if recording_of else seed
            name = next(iter(recording_of.values()), "")
            trials.append(Trial(len(trials), sample, swept, stream, runs, name))
    return trials


def _apply(experiment: Experiment, swept: Mapping[str, Any]) -> tuple[Component, Component, list[Component]]:
    source, front_end = experiment.source, experiment.front_end
    back_ends = {choice.label: choice for choice in experiment.back_ends}
    for path, value in swept.items():
        section, label, parameter = swept_target(path)
        if section == "source":
            source = source.with_parameter(parameter, value)
        elif section == "front_end":
            front_end = front_end.with_parameter(parameter, value)
        else:
            back_ends[label] = back_ends[label].with_parameter(parameter, value)
    return source, front_end, list(back_ends.values())
