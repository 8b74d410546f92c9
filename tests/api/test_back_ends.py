"""Streams, single runs, scores and checks from a program, against the experiment's own tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slamcmp
from slamcmp.metrics import metric_columns
from tests.api.conftest import WORLD, Reckoner


def test_stream_run_and_score_are_what_an_experiment_gives(here: Path) -> None:
    entry = {"name": "sliding_window", "window": 4, "iterations": 2}
    front_end = {"name": "labelled", "gate_probability": None}
    experiment = {"source": WORLD, "front_end": front_end, "back_ends": [entry], "seeds": [5]}
    row = slamcmp.run(experiment, executor="serial", progress=False).trials.iloc[0]
    stream = slamcmp.make_stream("circle", 5, front_end=front_end, landmarks=8, steps=25)
    run = slamcmp.run_back_end("sliding_window", stream, window=4, iterations=2)
    assert (stream.digest, run.digest, run.seed) == (row["digest"], row["digest"], 5)
    scores = slamcmp.score(run, stream.truth)
    assert set(scores) == set(metric_columns())
    for name, value in scores.items():
        # Not kept in run files, or told by the clock.
        if not name.startswith(("update_", "estimate_", "final_solution")) and name != "peak_memory_mb":
            assert value == row[name] or (math.isnan(value) and math.isnan(row[name])), name


def test_a_stream_has_the_truth_beside_it_and_the_back_end_never_sees_it() -> None:
    seen: list[Any] = []

    class Curious(Reckoner):
        def __init__(self, problem: slamcmp.Problem) -> None:
            super().__init__(problem)
            seen.append(problem)

        def update(self, frame: slamcmp.Frame) -> None:
            super().update(frame)
            seen.append(frame)

    stream = slamcmp.make_stream("circle", 1, landmarks=4, steps=6)
    assert stream.truth is not None
    assert stream.truth.T_world_body.shape == (6, 3, 3)
    assert slamcmp.run_back_end(Curious, stream).status == "ok"
    assert seen == [stream.problem, *stream.frames]


def test_a_back_end_that_asks_for_the_truth_is_told_it_or_refused() -> None:
    stream = slamcmp.make_stream("circle", 1, landmarks=4, steps=6)
    assert slamcmp.run_back_end("ekf_ideal", stream).status == "ok"
    bare = slamcmp.MeasurementStream(stream.problem, stream.frames)
    with pytest.raises(slamcmp.UsageError, match="ekf_ideal needs the truth, and this stream has none"):
        slamcmp.run_back_end("ekf_ideal", bare)


def test_what_a_back_end_does_wrong_is_in_its_run() -> None:
    class Late(Reckoner):
        def update(self, frame: slamcmp.Frame) -> None:
            super().update(frame)
            if frame.k == 3:
                raise RuntimeError("no more")

    run = slamcmp.run_back_end(Late, slamcmp.make_stream("circle", 1, landmarks=4, steps=6))
    assert (run.status, run.online.t.size) == ("crashed", 3)
    assert "frame 3: RuntimeError: no more" in run.message
    assert repr(run).startswith("<Run 'Late': crashed, 3 of 6 frames: frame 3")
    assert "crashed: frame 3: RuntimeError: no more" in run._repr_html_()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda s: slamcmp.make_stream("circel"), "unknown source 'circel'; did you mean 'circle'?"),
        (
            lambda s: slamcmp.make_stream("circle", step=3),
            "circle['step']: unknown key 'step'; did you mean 'steps'?",
        ),
        (
            lambda s: slamcmp.make_stream("circle", steps="3"),
            "circle['steps']: steps: input should be a valid integer",
        ),
        (
            lambda s: slamcmp.make_stream("circle", front_end={"name": "labelled", "gate_probabilty": 0.9}),
            "labelled['gate_probabilty']: unknown key 'gate_probabilty'; did you mean 'gate_probability'?",
        ),
        (
            lambda s: slamcmp.make_stream("circle", front_end={"nam": "labelled"}),
            "front_end: a name, or a mapping",
        ),
        (lambda s: slamcmp.run_back_end("isam", s), "unknown back end 'isam'; did you mean 'isam2'?"),
        (
            lambda s: slamcmp.run_back_end("isam2", s, relinearise_skip=1),
            "isam2['relinearise_skip']: unknown key 'relinearise_skip'; did you mean 'relinearize_skip'?",
        ),
        (
            lambda s: slamcmp.run_back_end(Reckoner, s, scall=2),
            "Reckoner['scall']: unknown key 'scall'; did you mean",
        ),
        (lambda s: slamcmp.run_back_end("isam2", "circle"), "a measurement stream is needed, not str"),
        (lambda s: slamcmp.check("isam2", relinearise_skip=1), "did you mean 'relinearize_skip'?"),
        (lambda s: slamcmp.check(3), "a back end is a class or its name, not 3"),
        (lambda s: slamcmp.score(s, s.truth), "score: a Run is needed, not SourceStream"),
        (
            lambda s: slamcmp.score(slamcmp.run_back_end(Reckoner, s), s),
            "truth is a GroundTruth, not SourceStream; its truth is stream.truth",
        ),
    ],
)
def test_a_mistake_is_one_line_that_says_what_would_be_right(call: Any, told: str) -> None:
    stream = slamcmp.make_stream("circle", 1, landmarks=4, steps=6)
    with pytest.raises(slamcmp.UsageError) as error:
        call(stream)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_truth_of_another_length_is_refused() -> None:
    run = slamcmp.run_back_end(Reckoner, slamcmp.make_stream("circle", 1, landmarks=4, steps=6))
    other = slamcmp.make_stream("circle", 1, landmarks=4, steps=5)
    with pytest.raises(slamcmp.DataError):
        slamcmp.score(run, other.truth)


def test_numpy_parameters_are_plain_ones() -> None:
    stream = slamcmp.make_stream("circle", np.int64(1), landmarks=np.int64(4), steps=6)
    run = slamcmp.run_back_end(Reckoner, stream, scale=np.float64(2.0))
    assert run.parameters == {"scale": 2.0}


def test_check_names_what_a_class_lacks() -> None:
    class Skewed(Reckoner):
        def estimate(self) -> slamcmp.Estimate:
            return slamcmp.Estimate(self.T * np.nan, self.P)

    findings = slamcmp.check(Skewed)
    assert [finding.passed for finding in findings] == [True, False]
    assert not findings.passed
    assert "finite" in findings[-1].check
    assert "FAIL" in findings._repr_html_()
