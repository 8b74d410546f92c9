"""The program of an ensemble against the ordinary back ends, metrics and world, run by run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp.backends import far_points
from slamcmp.backends.filters import loops
from slamcmp.ensembles.ensemble import run_ensemble
from slamcmp.ensembles.kernels import settings as at
from slamcmp.ensembles.sample import deviation, sample_run
from slamcmp.geometry import inverse, log
from slamcmp.metrics.consistency import nees_series
from slamcmp.types import Trajectory
from tests.ensembles.worlds import ALL, problem

WORLDS: dict[str, dict[str, Any]] = {
    "relative positions": {},
    "range and bearing": {"sensor": "range_bearing", "field_of_view_deg": 200.0},
    "a map a run": {"map_seed": None, "landmarks": 12},
    "a ring": {"layout": "ring", "ring_offset_m": 2.0},
    "parts of a step, side slip, an uncertain start": {
        "process_substeps": 3,
        "lateral_sigma_m": 0.02,
        "prior_position_sigma_m": 0.1,
        "prior_heading_sigma_rad": 0.05,
    },
}


@pytest.mark.parametrize("order", ["join_first", "update_first"])
@pytest.mark.parametrize("world", WORLDS)
def test_every_filter_is_the_ordinary_one(tmp_path: Path, world: str, order: str) -> None:
    filters = [{"name": name, "new_landmarks": order} for name in ALL]
    filters.append({"name": "ekf_fej", "label": "FEJ, updated", "new_landmark_jacobian": "updated"})
    of = problem(tmp_path, WORLDS[world], filters)
    assert len(of.filters) == 7
    streams = set()
    for which in of.filters:
        sample = sample_run(of, which, 11)
        streams.add(sample.stream.digest)
        assert sum(frame.ids.size for frame in sample.stream.frames) > 60
        assert deviation(sample, which) < 1e-9, which.label
    assert len(streams) == 1, "every filter has the same noise"


def test_scores_are_the_metrics_of_the_ordinary_run(tmp_path: Path) -> None:
    of = problem(tmp_path, WORLDS["range and bearing"], ["ekf_right_invariant"])
    (which,) = of.filters
    (runs,) = run_ensemble(of, 3).runs
    sample = sample_run(of, which, 2)
    online = Trajectory(sample.truth.t, sample.T_world_body, sample.P)
    error = log(inverse(sample.T_world_body) @ sample.truth.T_world_body)
    offset = sample.truth.T_world_body[:, :2, 2] - sample.T_world_body[:, :2, 2]
    late = np.arange(len(error)) >= at.NEES_FROM
    # Of the offset, as the tables' ensemble_nees_position has it, not of the logarithm's translation.
    in_body = np.einsum("kji,kj->ki", sample.T_world_body[:, :2, :2], offset)
    solved = np.linalg.solve(sample.P[late, :2, :2], in_body[late, :, None])[..., 0]
    expected = [
        (offset**2).sum(axis=1).mean(),
        (error[:, 2] ** 2).mean(),
        np.where(late, nees_series(online, sample.truth, "heading"), 0.0).mean(),
        (in_body[late] * solved).sum() / len(error) / 2,
        np.where(late, nees_series(online, sample.truth), 0.0).mean() / 3,
    ]
    np.testing.assert_allclose(runs.scores[2], expected, rtol=1e-9)


def test_the_world_has_the_noise_that_it_states(tmp_path: Path) -> None:
    """Errors of odometry and sensor, whitened by what the stream says of them, are standard normal.

    Within five standard errors; a wrong share of a part's noise, or a Q in other axes, is far outside.
    """
    source = WORLDS["parts of a step, side slip, an uncertain start"] | {"sensor": "range_bearing"}
    of = problem(tmp_path, source | {"turn_sigma_deg_s": 4.0}, ["ekf_slam"])
    steps, looks, starts = [], [], []
    for seed in range(60):
        sample = sample_run(of, of.filters[0], seed)
        truth, stream = sample.truth, sample.stream
        T = truth.T_world_body
        starts.append(log(inverse(stream.problem.T_world_body) @ T[0]) / np.sqrt(np.diag(stream.problem.P)))
        for k, frame in enumerate(stream.frames[1:], start=1):
            error = log(inverse(frame.T_prev_body) @ inverse(T[k - 1]) @ T[k])
            steps.append(np.linalg.solve(np.linalg.cholesky(frame.Q), error))
            expected = stream.problem.sensor.predict(T[k], truth.positions[frame.ids])
            looks.extend((frame.z - expected) / np.sqrt(np.diagonal(frame.R, axis1=1, axis2=2)))
    for whitened in (np.array(steps), np.array(looks), np.array(starts)):
        n, d = whitened.shape
        assert np.abs(whitened.mean(axis=0)).max() < 5 / np.sqrt(n)
        covariance = whitened.T @ whitened / n
        assert np.abs(covariance - np.eye(d)).max() < 5 * np.sqrt(2 / n)


def test_what_is_seen_is_what_the_sensor_can_see(tmp_path: Path) -> None:
    limits = {"range_min_m": 1.5, "range_max_m": 4.0, "field_of_view_deg": 120.0, "first_look": 2}
    of = problem(tmp_path, {"map_seed": None, "landmarks": 12} | limits, ["ekf_slam"])
    for seed in range(5):
        sample = sample_run(of, of.filters[0], seed)
        for k, frame in enumerate(sample.stream.frames):
            body = (sample.truth.positions - sample.truth.T_world_body[k, :2, 2]) @ (
                sample.truth.T_world_body[k, :2, :2]
            )
            away, bearing = np.hypot(*body.T), np.arctan2(body[:, 1], body[:, 0])
            seen = (away >= 1.5) & (away <= 4.0) & (np.abs(bearing) <= np.radians(60)) & (k >= 2)
            np.testing.assert_array_equal(frame.ids, np.flatnonzero(seen))


def test_maps_of_a_run_each_are_spread_as_the_source_says(tmp_path: Path) -> None:
    of = problem(tmp_path, {"map_seed": None, "landmarks": 10}, ["ekf_slam"])
    radius = 0.5 / np.radians(20.0)
    places = np.concatenate([sample_run(of, of.filters[0], s).truth.positions for s in range(60)])
    offset = places - [0.0, radius]
    # Inside, gaps of up to 5 m lead beyond the centre of so small a circle: there the sign is lost.
    distance = np.hypot(*offset.T)
    outside = distance[distance > 5.0 - radius] - radius
    assert (np.abs(outside) <= 5.0).all()
    assert abs((distance > radius).mean() - (0.5 + 0.5 * (5 - 2 * radius) / 4.5)) < 5 * np.sqrt(0.25 / 600)
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    assert np.hypot(np.cos(angle).mean(), np.sin(angle).mean()) < 5 / np.sqrt(600)


def test_a_filter_that_gives_up_is_a_failure_at_the_same_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (loops, far_points):
        monkeypatch.setattr(module, "FARTHEST", 0.15)
    monkeypatch.setattr("slamcmp.ensembles.problem.FARTHEST_POINT", 0.15)
    of = problem(tmp_path, {"noise_scale": 1.0}, ["ekf_slam", "ekf_fej"])
    runs = run_ensemble(of, 12).runs[1]
    assert 0 < runs.failures < 12
    assert np.isnan(runs.scores[runs.failed >= 0]).all()
    assert np.isfinite(runs.scores[runs.failed < 0]).all()
    assert runs.runs_of_batch.sum() == 12 - runs.failures
    seed = int(np.flatnonzero(runs.failed >= 0)[0])
    sample = sample_run(of, of.filters[1], seed)
    assert sample.failed_at == runs.failed[seed]
    assert deviation(sample, of.filters[1]) < 1e-9


SIMULATED = """
import sys
from pathlib import Path
import numpy as np
from slamcmp.ensembles import targets
from slamcmp.backends import far_points
from slamcmp.backends.filters import loops
from slamcmp.ensembles.ensemble import run_ensemble
from slamcmp.ensembles.outcome import BATCHES, BLOCK
from tests.ensembles.worlds import problem

source = {"steps": 12, "landmarks": 4, "first_look": 1, "process_substeps": 2}
filters = ["ekf_oc", {"name": "ekf_right_invariant", "new_landmarks": "update_first"}]
of = problem(Path(sys.argv[1]), source, filters)
for which, on_core in zip(of.filters, run_ensemble(of, 2).runs):
    scores, curves, failed, counts = targets.load("cuda").launch(
        1, 1, of.numbers, which.options, of.path, of.controls, of.landmarks, of.most, BATCHES, BLOCK, 3
    )
    np.testing.assert_allclose(scores[0], on_core.scores[1], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(curves[0, :, 0].mean()) ** 2, scores[0, 0], rtol=1e-9)
    assert failed.tolist() == [-1] and counts.tolist() == [1] + [0] * (BATCHES - 1)
print("the same")
"""


def test_threads_of_a_block_give_the_numbers_of_a_core(tmp_path: Path) -> None:
    """In numba's simulator of CUDA, where each thread is one of Python's: barriers and shared memory."""
    pytest.importorskip("numba.cuda", reason="this numba has no CUDA target")
    there = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", SIMULATED, str(tmp_path)],
        env=there,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.stdout.strip().endswith("the same"), ended.stderr[-2000:]
