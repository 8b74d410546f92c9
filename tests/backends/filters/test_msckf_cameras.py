"""The MSCKF-style filter on camera streams: what it was made for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.msckf import Msckf
from slamcmp.backends.filters.triangulation import triangulate
from slamcmp.backends.sights import Sights
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import MeasurementStream
from tests.backends.graph_streams import run
from tests.camera_stream import CAMERAS, Kind, camera_stream, without_returns


def finished(kind: Kind, **settings: float) -> MeasurementStream:
    """Each landmark is seen in frames on end, and the last frame sees nothing: every track has ended."""
    stream = without_returns(camera_stream(kind, frames=10, landmarks=40, seen_at_once=8, **settings)[0])  # type: ignore[arg-type]
    last = stream.frames[-1]
    blind = replace(last, ids=last.ids[:0], z=last.z[:0], R=last.R[:0], entries=None)
    return replace(stream, frames=(*stream.frames[:-1], blind))


@pytest.mark.parametrize("kind", ["stereo", "mono", "rgbd"])
def test_gap_to_the_batch_solution_falls_quadratically_with_the_noise(kind: Kind) -> None:
    scales, gaps = (0.08, 0.04, 0.02), []
    for noise in scales:
        found = []
        for seed in range(4):
            stream = finished(kind, noise=noise, seed=seed)
            msckf = run(Msckf(stream.problem, window=20), stream)
            full = run(SlidingWindow(stream.problem, window=None, iterations=30, tolerance=1e-10), stream)
            assert msckf.diagnostics()["dropped"] == 0
            gap = msckf.trajectory().T_world_body - full.trajectory().T_world_body
            found.append(np.abs(gap).max())
        gaps.append(np.median(found))
    assert np.polyfit(np.log(scales), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_nis_counts_measurements_less_landmarks(kind: Kind) -> None:
    """Everything arrives with the last frame but one's end: the tracks' rows less 3 for each landmark."""
    stream = finished(kind)
    msckf = Msckf(stream.problem, window=20)
    total = 0
    for frame in stream.frames:
        msckf.update(frame)
        total += msckf.diagnostics()["nis_dof"]
    rows = sum(frame.z.size for frame in stream.frames)
    sights: dict[int, int] = {}
    for frame in stream.frames:
        entries = [] if frame.entries is None else frame.entries.ids.tolist()
        rows += 3 * len(entries)
        for landmark in [*frame.ids.tolist(), *entries]:
            sights[landmark] = sights.get(landmark, 0) + 1
    # One sight alone says nothing about the poses.
    once = sum(count == 1 for count in sights.values())
    assert total == rows - 3 * len(sights)
    assert len(msckf.landmarks().ids) == len(sights) - once


def test_a_second_track_of_one_camera_begins_where_the_first_ended() -> None:
    """A window of 4 cuts every track: what follows has pixels only, and is still used."""
    stream, truth = camera_stream("mono", frames=20, landmarks=50, noise=0.3)
    msckf = Msckf(stream.problem, window=4)
    used = 0
    for frame in stream.frames:
        msckf.update(frame)
        used += msckf.diagnostics()["tracks_used"]
    assert used > 1.5 * msckf.diagnostics()["landmarks"]
    estimate = msckf.estimate()
    error = geometry.local(estimate.T_world_body, truth.T_world_body[-1])
    # chi-square with 6 dof: 22.5 at 99.9 %.
    assert error @ np.linalg.solve(estimate.P, error) < 22.5


def test_pixels_alone_triangulate_to_the_least_squares_point() -> None:
    """From exact pixels the exact point, from noisy ones a residual orthogonal to the Jacobian."""
    rng = np.random.default_rng(3)
    camera = CAMERAS["mono"]
    poses = geometry.exp(np.column_stack([0.05 * rng.normal(size=(5, 3)), rng.normal(size=(5, 3))]))
    point = np.array([9.0, 1.0, 0.5])
    points = np.tile(point, (5, 1))
    sights = Sights(camera, entry_sensor(camera), np.zeros(5, dtype=bool))
    W = np.broadcast_to(np.diag([1.0, 1.0, 0.0]), (5, 3, 3))
    exact = np.pad(camera.predict(poses, points), ((0, 0), (0, 1)))
    found = triangulate(sights, poses, exact, W, point + np.array([0.8, -0.3, 0.2]))
    np.testing.assert_allclose(found, point, atol=1e-9)
    noisy = exact + rng.normal(size=exact.shape) * [0.5, 0.5, 0.0]
    found = triangulate(sights, poses, noisy, W, point)
    assert found is not None
    H = camera.jacobians(poses, np.tile(found, (5, 1)))[1].reshape(10, 3)
    r = (noisy[:, :2] - camera.predict(poses, np.tile(found, (5, 1)))).ravel()
    np.testing.assert_allclose(H.T @ r, 0, atol=1e-5)
    assert triangulate(sights, poses, exact, W, np.array([-9.0, 1.0, 0.5])) is None
