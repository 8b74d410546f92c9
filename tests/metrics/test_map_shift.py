"""Divergence is told early without truth: filters made to diverge are found, healthy ones are let be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from slamcmp.backends.dead_reckoning import DeadReckoning
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.geometry import exp, log
from slamcmp.metrics.divergence import Departure, explain, first_departure
from slamcmp.metrics.map_shift import FEWEST, map_departure
from slamcmp.types import Frame, MeasurementStream, Run
from tests.backends.spoilt import ghosts, of_frames
from tests.toy_stream import toy_stream

FAULT_AT = 40


def run_ekf(stream: MeasurementStream, **parameters: str) -> Run:
    make = lambda problem: EkfSlam(problem, **parameters)  # type: ignore[arg-type]  # noqa: E731
    return run_back_end(make, stream, label="EKF", parameters=parameters)


def without_truth(stream: MeasurementStream, run: Run) -> Departure | None:
    """What a log without truth is told by: innovations and the map."""
    found = [each for each in (first_departure(run, None), map_departure(stream, run)) if each is not None]
    return min(found, key=lambda each: each.k, default=None)


def too_long(frame: Frame) -> Frame:
    """Odometry 40 % long, five times what its covariance says (13 % are within it, and no divergence)."""
    twist = log(frame.T_prev_body)
    return replace(frame, T_prev_body=exp(twist * [1.4, 1.0, 1.0])) if frame.k >= FAULT_AT else frame


def too_sure(frame: Frame) -> Frame:
    """A third of the true standard deviations."""
    return replace(frame, R=frame.R / 9.0) if frame.k >= FAULT_AT else frame


def swapped(frame: Frame) -> Frame:
    """Labels change places in pairs."""
    return replace(frame, ids=frame.ids ^ 1) if frame.k >= FAULT_AT else frame


@pytest.mark.parametrize("fault", [too_long, too_sure, swapped])
@pytest.mark.parametrize("seed", range(2))
def test_a_filter_made_to_diverge_is_found_soon(fault: Callable[[Frame], Frame], seed: int) -> None:
    clean, _, _ = toy_stream(frames=100, seed=seed)
    stream = of_frames(clean, map(fault, clean.frames))
    departure = without_truth(stream, run_ekf(stream))
    assert departure is not None
    assert FAULT_AT <= departure.k < FAULT_AT + 60


def test_poses_that_move_away_from_their_map_are_found_by_the_map_alone() -> None:
    """Odometry that turns by 4 degrees a frame unseen; the covariance of a right one does not allow it."""
    clean, _, _ = toy_stream(frames=120, seed=3)
    bent = exp(np.array([0.0, 0.0, np.radians(4.0)]))

    def turned(frame: Frame) -> Frame:
        return replace(frame, T_prev_body=frame.T_prev_body @ bent) if frame.k >= FAULT_AT else frame

    stream = of_frames(clean, map(turned, clean.frames))
    run = run_back_end(DeadReckoning, stream, label="odometry", parameters={})
    departure = map_departure(stream, run)
    assert departure is not None
    assert departure.test == "MAP"
    assert FAULT_AT < departure.k < FAULT_AT + 40
    assert departure.value > departure.limit
    assert departure.dof >= FEWEST
    text = explain(run, departure, None)
    assert f"The map shifted at frame {departure.k} (t = " in text
    right = run_back_end(DeadReckoning, clean, label="odometry", parameters={})
    assert map_departure(clean, right) is None


def test_healthy_runs_are_let_be() -> None:
    """By the limits at most 1 in 100 for NIS; none is expected of the map, whose test is conservative."""
    alarms = shifts = 0
    for seed in range(12):
        stream, _, _ = toy_stream(frames=60, seed=100 + seed, noise=0.5)
        run = run_ekf(stream)
        alarms += without_truth(stream, run) is not None
        shifts += map_departure(stream, run) is not None
    # More than 2 of 12 at 1 % has a chance of 2 in 10 000.
    assert alarms <= 2
    assert shifts == 0


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_outliers_that_a_kernel_bears_are_no_divergence(share: float) -> None:
    """Three seeds; the same stream's least-squares filter is found."""
    found = 0
    for seed in range(3):
        clean, _, _ = toy_stream(frames=60, landmarks=12, seen_at_once=6, seed=seed)
        stream = ghosts(clean, share, seed)
        found += without_truth(stream, run_ekf(stream, robust="gnc")) is not None
    assert found == 0
    assert without_truth(stream, run_ekf(stream)) is not None


def test_a_run_without_covariances_tells_nothing() -> None:
    stream, _, _ = toy_stream(frames=20)
    run = run_ekf(stream)
    assert map_departure(stream, replace(run, online=replace(run.online, P=None))) is None
