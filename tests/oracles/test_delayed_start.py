"""Landmarks that enter by a delayed start: identities between the families, and consistency."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.frontend.delayed_start import delayed_start
from slamcmp.geometry import local
from slamcmp.registry import back_ends
from slamcmp.types import Log, MeasurementStream, Run
from slamcmp.worlds.planar import random as walk

SENSORS = ("range_only", "bearing_only")
SEEDS = range(10)
EXACT = {"isam2": {"relinearize_skip": 1, "relinearize_threshold": 0.0}}


@functools.cache
def world(sensor: str, seed: int) -> tuple[Log, MeasurementStream]:
    log = walk(seed, sensor=sensor, steps=60, landmarks=8, half_size_m=10.0, range_max_m=12.0)
    return log, delayed_start(log, seed)


def run(name: str, stream: MeasurementStream, **parameters: Any) -> Run:
    make = back_ends.get(name).target
    done = run_back_end(
        lambda problem: make(problem, **parameters), stream, label=name, parameters=parameters
    )
    assert done.status == "ok", done.message
    return done


@pytest.mark.parametrize("sensor", SENSORS)
def test_window_one_with_one_iteration_is_the_ekf(sensor: str) -> None:
    _, stream = world(sensor, 3)
    ekf, window = EkfSlam(stream.problem), SlidingWindow(stream.problem, window=1, iterations=1)
    # The window perturbs in the body, whose covariance is then turned; the filter's means are the same.
    for frame in stream.frames:
        ekf.update(frame)
        window.update(frame)
        ours, theirs = window.estimate(), ekf.estimate()
        np.testing.assert_allclose(ours.T_world_body, theirs.T_world_body, rtol=0, atol=1e-8)
        np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-6, atol=1e-10)
    np.testing.assert_array_equal(window.landmarks().ids, ekf.landmarks().ids)
    np.testing.assert_allclose(window.landmarks().positions, ekf.landmarks().positions, rtol=0, atol=1e-7)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_whole_window_to_convergence_is_gtsams_solution(sensor: str) -> None:
    _, stream = world(sensor, 4)
    ours = run("sliding_window", stream, window=None, iterations=100, tolerance=1e-11)
    theirs = run("batch", stream)
    assert ours.final is not None
    assert theirs.final is not None
    apart = local(ours.final.T_world_body, theirs.final.T_world_body)
    np.testing.assert_allclose(apart, 0.0, rtol=0, atol=2e-5)
    np.testing.assert_allclose(ours.final.P, theirs.final.P, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("sensor", SENSORS)
def test_every_back_end_knows_the_same_landmarks(sensor: str) -> None:
    _, stream = world(sensor, 5)
    entered = sorted(
        i for frame in stream.frames if frame.entries is not None for i in frame.entries.ids.tolist()
    )
    for name in ("ekf_slam", "ekf_right_invariant", "ekf_fej", "ekf_oc", "ekf_robocentric", "iterated_ekf",
                 "ukf_slam", "sliding_window", "isam2", "batch"):  # fmt: skip
        landmarks = run(name, stream).landmarks
        assert landmarks is not None
        assert sorted(landmarks.ids.tolist()) == entered, name
    for name in ("msckf", "fixed_lag"):
        run(name, stream)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", ["ekf_right_invariant", "isam2"])
def test_poses_are_as_uncertain_as_they_say(sensor: str, name: str) -> None:
    """Pose NEES of 3 within the 95 % of 10 runs at the end (chi-square with 30 degrees), and on average."""
    last, mean = [], []
    for seed in SEEDS:
        log, stream = world(sensor, seed)
        online = run(name, stream, **EXACT.get(name, {})).online
        assert log.truth is not None
        e = local(online.T_world_body, log.truth.T_world_body)[1:]
        nees = np.einsum("ki,ki->k", e, np.linalg.solve(online.P[1:], e[:, :, None])[:, :, 0])
        last.append(nees[-1])
        mean.append(nees.mean())
    assert 16.8 / 10 < np.mean(last) < 47.0 / 10
    assert 1.5 < np.mean(mean) < 4.5
