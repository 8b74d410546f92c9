"""The linear start of pose graphs: exact without noise, the same optimum with it, cheap when large."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.graph import poses_in
from slamcmp.backends.gtsam_smoothers.linear_start import Edges
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.frontend.labelled import labelled
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import TANGENT_DIM, Frame, MeasurementStream, Problem, RelativePoses
from tests.backends.graph_streams import run


def loops(n: int, noise: float, landmarks: int = 0) -> tuple[MeasurementStream, np.ndarray, np.ndarray]:
    """Three turns of 20 poses on a spiral, each closed to the one before; landmarks seen from three poses."""
    rng = np.random.default_rng(n)
    p = TANGENT_DIM[n]
    step = np.array([0.6, 0.1, 0.31]) if n == 2 else np.array([0.02, -0.04, 0.31, 0.6, 0.1, 0.05])
    truth = [g.exp(rng.normal(size=p))]
    for _ in range(59):
        truth.append(truth[-1] @ g.exp(step))
    world = 3 * rng.normal(size=(landmarks, n))
    sensor = RelativePosition(space_dim=n)
    sigma = np.linspace(0.01, 0.03, p)
    Q = np.diag(sigma**2)

    def measured(i: int, j: int) -> np.ndarray:
        return g.inverse(truth[i]) @ truth[j] @ g.exp(noise * sigma * rng.normal(size=p))

    frames = []
    for k in range(60):
        ids = np.arange(landmarks) if k in (7, 30, 55) else np.empty(0, dtype=int)
        z = sensor.predict(truth[k], world[ids]) if ids.size else np.empty((0, n))
        R = np.broadcast_to(1e-2 * np.eye(n), (ids.size, n, n))
        related = None
        if k >= 20 and k % 3 == 0:
            related = RelativePoses([k - 20], measured(k - 20, k)[None], (4 * Q)[None])
        motion = measured(k - 1, k) if k else np.eye(n + 1)
        frames.append(Frame(k, float(k), motion, Q if k else 0 * Q, ids, z, R, relative_poses=related))
    return (
        MeasurementStream(Problem(truth[0], 1e-8 * np.eye(p), sensor), tuple(frames)),
        np.stack(truth),
        world,
    )


@pytest.mark.parametrize("n", [2, 3])
def test_without_noise_it_is_the_truth(n: int) -> None:
    stream, truth, _ = loops(n, 0.0)
    edges = Edges()
    for frame in stream.frames:
        edges.add(frame)
    np.testing.assert_allclose(edges.poses(truth[0]), truth, atol=1e-9)


@pytest.mark.parametrize("n", [2, 3])
def test_landmarks_come_along_and_the_optimum_is_the_same(n: int) -> None:
    stream, truth, world = loops(n, 1.0, landmarks=4)
    chi2 = {}
    for start in ("isam2", "linear"):
        batch = run(Batch(stream.problem, warm_start=start), stream)
        found = batch.trajectory()
        chi2[start] = batch.diagnostics()["chi2"]
        # Thirteen closures, twelve sights of four landmarks.
        assert batch.diagnostics()["dof"] == 13 * TANGENT_DIM[n] + (12 - 4) * n
    assert chi2["linear"] == pytest.approx(chi2["isam2"], rel=1e-9)
    assert np.linalg.norm(found.T_world_body[:, :n, n] - truth[:, :n, n], axis=1).max() < 0.5

    quiet, truth, world = loops(n, 0.0, landmarks=4)
    batch = run(Batch(quiet.problem, warm_start="linear"), quiet)
    start = batch._start()
    np.testing.assert_allclose(poses_in(start, 60, n), truth, atol=1e-9)
    assert batch._graph.error(start) < 1e-12
    batch.trajectory()
    np.testing.assert_allclose(batch.landmarks().positions, world, atol=1e-6)


def test_without_closures_it_is_the_odometry_chain() -> None:
    stream, _, _ = loops(2, 1.0)
    open_ones = [Frame(f.k, f.t, f.T_prev_body, f.Q, f.ids, f.z, f.R) for f in stream.frames]
    chain = MeasurementStream(stream.problem, tuple(open_ones))
    batch = run(Batch(chain.problem, warm_start="linear"), chain)
    assert batch._start() is batch._chain


@pytest.mark.slow
def test_w10000_takes_seconds() -> None:
    """64 311 edges; gtsam's optimum from its own reader is 289.7348 (test_pose_graphs.py)."""
    stream = labelled(graph_file(path="w10000.graph"), 0)
    before = perf_counter()
    batch = run(Batch(stream.problem, warm_start="linear", final_covariances=False), stream)
    batch.trajectory()
    assert batch.diagnostics()["chi2"] == pytest.approx(289.7347632815, abs=1e-6)
    assert batch.diagnostics()["iterations"] < 15
    # Five here; iSAM2's start takes minutes.
    assert perf_counter() - before < 60
