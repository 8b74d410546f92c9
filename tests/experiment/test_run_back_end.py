"""The loop around one back end: what it keeps, what it calls a failure."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.experiment.job.collected import first_fault
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.frontend.labelled import labelled
from slamcmp.support.memory import PeakMemory
from slamcmp.types import MeasurementStream, Run
from tests import user_plugins


@pytest.fixture(scope="module")
def stream() -> MeasurementStream:
    return labelled(user_plugins.straight(0, steps=300), 0)


def run(stream: MeasurementStream, name: str, time_limit_s: float = 60.0, **parameters) -> Run:
    make = getattr(user_plugins, name)
    return run_back_end(
        lambda problem: make(problem, **parameters),
        stream,
        label=name,
        parameters=parameters,
        time_limit_s=time_limit_s,
    )


def test_dead_reckoning_is_kept_frame_by_frame(stream: MeasurementStream) -> None:
    result = run(stream, "DeadReckoning")
    assert (result.status, result.message, result.completion) == ("ok", "", 1.0)
    steps = np.array([frame.T_prev_body[0, 2] for frame in stream.frames])
    np.testing.assert_allclose(result.online.T_world_body[:, 0, 2], np.cumsum(steps), atol=1e-9)
    # Along a straight line the variances of the steps add up.
    np.testing.assert_allclose(result.online.P[:, 0, 0], 1e-4 * np.arange(300), rtol=1e-9)
    assert result.final is None
    assert result.digest == stream.digest
    assert (result.update_s > 0).all()


def test_update_and_estimate_are_timed_apart(stream: MeasurementStream) -> None:
    short = labelled(user_plugins.straight(0, steps=10), 0)
    result = run(short, "DeadReckoning", pause_s=0.01)
    assert np.median(result.update_s) >= 0.01
    assert np.median(result.estimate_s) < 0.005


def test_hindsight_is_asked_for(stream: MeasurementStream) -> None:
    result = run(stream, "Hindsight")
    np.testing.assert_array_equal(result.final.T_world_body, result.online.T_world_body)
    assert result.final_s > 0


@pytest.mark.parametrize(
    ("name", "status", "message"),
    [
        ("Raises", "crashed", "frame 200: ValueError: no such landmark (user_plugins.py:"),
        ("Diverges", "diverged", "frame 200: wrong basin"),
        ("DivergesAndSaysWhere", "diverged", "frame 200: wrong basin"),
        ("TurnsNan", "diverged", "frame 200: the estimated pose is not finite"),
        ("TurnsIndefinite", "diverged", "frame 200: the estimated covariance is not positive semi-definite"),
    ],
)
def test_failure_keeps_the_frames_before_it(
    stream: MeasurementStream, name: str, status: str, message: str
) -> None:
    result = run(stream, name, at=200)
    assert result.status == status
    assert result.message.startswith(message)
    assert result.completion == 200 / 300
    assert result.online.t.size == result.update_s.size == 200
    whole = run(stream, "DeadReckoning")
    np.testing.assert_array_equal(result.online.T_world_body, whole.online.T_world_body[:200])


def test_soft_time_limit_keeps_what_is_done(stream: MeasurementStream) -> None:
    result = run(stream, "DeadReckoning", time_limit_s=0.1, pause_s=0.01)
    assert result.status == "timed_out"
    assert 1 <= result.online.t.size <= 11
    assert result.message == f"the time limit passed after frame {result.online.t.size - 1} of 299"


def test_first_fault_judges_correlations_not_units() -> None:
    poses = np.broadcast_to(np.eye(3), (4, 3, 3))
    good = np.diag([1e4, 1e-12, 0.0])
    covariances = np.stack([np.zeros((3, 3)), good, good, good])
    assert first_fault(poses, covariances) is None
    # Indefinite by its small entries: an eigenvalue 1e-17 of the largest, yet a correlation of 1.1.
    worse = np.array([[1e4, 0.0, 0.0], [0.0, 1e-12, 1.1e-12], [0.0, 1.1e-12, 1e-12]])
    assert first_fault(poses, np.stack([good, good, worse, worse]))[0] == 2
    skew = good + np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, 0]])
    assert first_fault(poses, np.stack([good, skew, good, good])) == (
        1,
        "the estimated covariance is not symmetric",
    )
    holey = np.stack([good, good, good, good * np.nan])
    assert first_fault(poses, holey) == (3, "the estimated covariance is not finite")


def test_peak_memory_counts_what_was_taken_and_given_back() -> None:
    memory = PeakMemory()
    block = np.ones(8_000_000)
    del block
    assert 55 <= memory.growth_mb() <= 80  # 64 MB = 61 MiB, and pages that the rest needs
