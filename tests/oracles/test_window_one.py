"""Window 1 and one Gauss-Newton step make a factor graph the EKF (FACTS: oracle identities 4 and 6)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.gtsam_smoothers.batch import Batch
from tests.oracles.window_graph import WindowOneGraph, assert_same_all_along
from tests.toy_stream import toy_stream


@pytest.mark.parametrize("axes", ["world", "body"])
@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_ekf_is_the_window_one_graph(sensor_name: str, axes: Literal["world", "body"]) -> None:
    """Mean and joint covariance after each of 200 frames, 20 landmarks joining as they are first seen."""
    stream, _, _ = toy_stream(
        frames=200, landmarks=20, sensor_name=sensor_name, seed=3, prior_sigma=0.05, seen_at_once=4
    )
    ekf = EkfSlam(stream.problem, error_state=axes)
    graph = WindowOneGraph(stream.problem, axes=axes)
    assert_same_all_along(stream, ekf, graph)
    assert len(graph.ids) == 20


def test_window_one_is_not_the_smoother() -> None:
    """The identity above is no accident of an easy world: the same stream's batch solution is elsewhere."""
    stream, _, _ = toy_stream(frames=200, landmarks=20, seed=3, prior_sigma=0.05, seen_at_once=4)
    ekf, batch = EkfSlam(stream.problem), Batch(stream.problem)
    for frame in stream.frames:
        ekf.update(frame)
        batch.update(frame)
    gap = ekf.estimate().T_world_body - batch.trajectory().T_world_body[-1]
    assert np.abs(gap).max() > 1e-4


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_gap_between_filter_and_smoother_falls_quadratically_with_the_noise(sensor_name: str) -> None:
    """Noise and prior scaled together: halving them quarters the gap (slope of log gap by log noise)."""
    scales = np.array([1.0, 0.5, 0.25, 0.125]) / 8
    slopes = []
    for seed in range(6):
        gaps = []
        for scale in scales:
            stream, _, _ = toy_stream(
                frames=80, landmarks=15, sensor_name=sensor_name, seed=seed, noise=scale, prior_sigma=0.05
            )
            ekf, batch = EkfSlam(stream.problem), Batch(stream.problem, optimizer="gauss_newton")
            for frame in stream.frames:
                ekf.update(frame)
                batch.update(frame)
            gap = ekf.estimate().T_world_body - batch.trajectory().T_world_body[-1]
            gaps.append(np.linalg.norm(gap))
        slopes.append(np.polyfit(np.log(scales), np.log(gaps), 1)[0])
    assert np.median(slopes) == pytest.approx(2.0, abs=0.15)
