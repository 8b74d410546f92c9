"""The MSCKF-style filter against full smoothing, where the two must agree, and its consistency."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.msckf import Msckf, triangulate
from slamcmp.backends.sights import Sights
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.errors import DivergedError
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Frame, MeasurementStream, Problem


def passing_by(
    *, seed: int, sensor_name: str, noise: float = 1.0, heading: float = 1.0, frames: int = 14
) -> tuple[MeasurementStream, np.ndarray]:
    """A drive past landmarks, each seen in five frames on end; the last frame sees nothing.

    ``heading`` scales every heading noise apart.
    """
    rng = np.random.default_rng(seed)
    sensor = make_sensor(sensor_name, {})
    world = np.stack([np.arange(frames + 2), rng.choice([-3.0, 3.0], frames + 2)], axis=1)
    sigmas = noise * np.array([0.05, 0.03, 0.02 * heading])
    increment = geometry.se2(1.0, 0.0, 0.05)
    R = noise**2 * np.diag([0.1, 0.03 if sensor_name == "range_bearing" else 0.1]) ** 2
    P = np.diag(sigmas) ** 2
    T = geometry.retract(np.eye(3), rng.normal(size=3) * sigmas)
    made, truth = [], []
    for k in range(frames):
        if k:
            T = T @ geometry.retract(increment, rng.normal(size=3) * sigmas)
        ids = np.arange(max(0, k - 4), k + 1) if k < frames - 1 else np.empty(0, int)
        z = sensor.predict(T, world[ids]) + rng.normal(size=(ids.size, 2)) * np.sqrt(np.diag(R))
        step, Q = (increment, P) if k else (np.eye(3), np.zeros((3, 3)))
        made.append(Frame(k, float(k), step, Q, ids, z, np.broadcast_to(R, (ids.size, 2, 2))))
        truth.append(T)
    return MeasurementStream(Problem(np.eye(3), P, sensor), tuple(made)), np.array(truth)


def both(stream: MeasurementStream) -> tuple[Msckf, SlidingWindow]:
    msckf = Msckf(stream.problem, window=len(stream.frames) + 1)
    full = SlidingWindow(stream.problem, window=None, iterations=50, tolerance=1e-10)
    for frame in stream.frames:
        msckf.update(frame)
        full.update(frame)
    return msckf, full


def test_known_heading_makes_it_the_batch_solution() -> None:
    """Linear, all tracks finished inside the window: poses, map and covariances of full smoothing."""
    stream, _ = passing_by(seed=1, sensor_name="relative_position", heading=1e-6)
    msckf, full = both(stream)
    ours, theirs = msckf.trajectory(), full.trajectory()
    np.testing.assert_allclose(ours.T_world_body, theirs.T_world_body, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-5, atol=1e-10)
    # A landmark seen once says nothing about the poses: it never becomes a constraint, nor part of the map.
    assert set(full.landmarks().ids) - set(msckf.landmarks().ids) == {12}


def test_last_landmarks_are_the_batch_solutions() -> None:
    """Tracks that end with the last frame know all there is; the earlier ones' later news is not added."""
    stream, _ = passing_by(seed=1, sensor_name="relative_position", heading=1e-6)
    msckf, full = both(stream)
    a, b = msckf.landmarks(), full.landmarks()
    for landmark in (9, 10, 11):
        i, j = a.ids.tolist().index(landmark), b.ids.tolist().index(landmark)
        np.testing.assert_allclose(a.positions[i], b.positions[j], rtol=0, atol=1e-6)
        np.testing.assert_allclose(a.covariances[i], b.covariances[j], rtol=1e-5)


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_gap_to_the_batch_solution_falls_quadratically_with_the_noise(sensor_name: str) -> None:
    gaps = []
    for noise in (0.1, 0.05, 0.025):
        worst = []
        for seed in range(5):
            msckf, full = both(passing_by(seed=seed, sensor_name=sensor_name, noise=noise)[0])
            gap = msckf.trajectory().T_world_body - full.trajectory().T_world_body
            worst.append(np.abs(gap).max())
        gaps.append(np.median(worst))
    slope = np.polyfit(np.log([0.1, 0.05, 0.025]), np.log(gaps), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.2)


def test_is_consistent_over_independent_runs() -> None:
    """Pose NEES at the end over 100 runs, windows shorter than the drive: 99.9 % band of chi-square / 100."""
    total = 0.0
    for seed in range(100):
        stream, truth = passing_by(seed=seed, sensor_name="range_bearing", noise=0.3)
        msckf = Msckf(stream.problem, window=7)
        for frame in stream.frames:
            msckf.update(frame)
        error = geometry.local(msckf.estimate().T_world_body, truth[-1])
        total += float(error @ np.linalg.solve(msckf.estimate().P, error))
    assert 2.29 < total / 100 < 3.86


def test_online_estimate_waits_for_tracks_to_end() -> None:
    """While every landmark is still in view the filter is dead reckoning; then all arrive at once."""
    stream, _ = passing_by(seed=3, sensor_name="range_bearing")
    msckf = Msckf(stream.problem, window=20)
    online = []
    for frame in stream.frames[:5]:
        msckf.update(frame)
        online.append(msckf.estimate().T_world_body)
    expected = geometry.dead_reckoning(
        np.eye(3), np.stack([frame.T_prev_body for frame in stream.frames[:5]])
    )
    np.testing.assert_allclose(online, expected, atol=1e-12)
    assert msckf.landmarks().ids.size == 0
    msckf.update(stream.frames[5])
    assert msckf.landmarks().ids.tolist() == [0]
    # Five planar sightings of one landmark: ten numbers, two of them spent on the landmark.
    assert msckf.diagnostics()["nis_dof"] == 8


@pytest.mark.parametrize("seen", [5, 9, 13])
def test_hindsight_is_the_batch_solution_while_tracks_still_run(seen: int) -> None:
    """Linear, and the log ends with landmarks in view: every observation counts, and counts once."""
    stream, _ = passing_by(seed=1, sensor_name="relative_position", heading=1e-6)
    cut = MeasurementStream(stream.problem, stream.frames[:seen])
    msckf, full = both(cut)
    ours, theirs = msckf.trajectory(), full.trajectory()
    np.testing.assert_allclose(ours.T_world_body, theirs.T_world_body, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-5, atol=1e-10)
    # Its own answer online is another one: it has not used the tracks that run.
    assert np.abs(ours.T_world_body[-1] - msckf.estimate().T_world_body).max() > 1e-3
    a, b = msckf.landmarks(), full.landmarks()
    # Tracks of two sightings and more, as the batch solution has them.
    for landmark in range(max(0, seen - 5), seen - 1):
        i, j = a.ids.tolist().index(landmark), b.ids.tolist().index(landmark)
        np.testing.assert_allclose(a.positions[i], b.positions[j], rtol=0, atol=1e-6)
        np.testing.assert_allclose(a.covariances[i], b.covariances[j], rtol=1e-5)


def test_asking_for_hindsight_ends_no_track_of_the_filter() -> None:
    """Asked after every frame or never, it answers the same; and as if the next frame had seen nothing."""
    stream, _ = passing_by(seed=2, sensor_name="range_bearing")
    asked, never = Msckf(stream.problem, window=6), Msckf(stream.problem, window=6)
    for frame in stream.frames:
        asked.update(frame)
        never.update(frame)
        assert asked.diagnostics() == pytest.approx(never.diagnostics(), abs=0, nan_ok=True)
        hindsight = asked.trajectory()
        np.testing.assert_array_equal(asked.estimate().T_world_body, never.estimate().T_world_body)
        np.testing.assert_array_equal(asked.estimate().P, never.estimate().P)
        blind = copy.deepcopy(never)
        standing = Frame(
            frame.k + 1, frame.t + 1, np.eye(3), np.zeros((3, 3)), [], np.empty((0, 2)), np.empty((0, 2, 2))
        )
        blind.update(standing)
        np.testing.assert_allclose(hindsight.T_world_body[-1], blind.estimate().T_world_body, atol=1e-12)
        np.testing.assert_allclose(hindsight.P[-1], blind.estimate().P, atol=1e-13)
        np.testing.assert_array_equal(asked.landmarks().ids, blind.landmarks().ids)


def test_a_track_ends_when_its_first_pose_leaves() -> None:
    stream, _ = passing_by(seed=3, sensor_name="range_bearing")
    msckf = Msckf(stream.problem, window=3)
    used = []
    for frame in stream.frames[:6]:
        msckf.update(frame)
        used.append(msckf.diagnostics()["nis_dof"])
    # Frame 2: landmark 0 has three sightings. Frame 3: landmark 1. Frame 4: landmark 2. Frame 5: landmark 0's
    # second track (frames 3 and 4) ends for want of a sighting, and landmarks 0, 3 start with frame 3.
    assert used == [0, 0, 4, 4, 4, 6]


def test_triangulation_is_the_least_squares_point() -> None:
    """At the answer the whitened residual is orthogonal to the Jacobian; from exact data it is exact."""
    rng = np.random.default_rng(0)
    sensor = make_sensor("range_bearing", {})
    sights = Sights(sensor, sensor)
    poses = geometry.exp(rng.normal(size=(6, 3)) * [1, 1, 0.5])
    point = np.array([4.0, -3.0])
    exact = sensor.predict(poses, np.tile(point, (6, 1)))
    W = np.broadcast_to(np.diag([10.0, 50.0]), (6, 2, 2))
    found = triangulate(sights, poses, exact, W, sensor.invert(poses[0], exact[0]))
    np.testing.assert_allclose(found, point, atol=1e-10)
    noisy = exact + rng.normal(size=exact.shape) * [0.1, 0.02]
    found = triangulate(sights, poses, noisy, W, sensor.invert(poses[0], noisy[0]))
    assert found is not None
    points = np.tile(found, (6, 1))
    r = (W @ sensor.residual(noisy, sensor.predict(poses, points))[..., None]).ravel()
    H = (W @ sensor.jacobians(poses, points)[1]).reshape(12, 2)
    np.testing.assert_allclose(H.T @ r, 0, atol=1e-6)


def test_a_spoilt_measurement_is_reported_as_divergence() -> None:
    stream, _ = passing_by(seed=0, sensor_name="relative_position")
    msckf = Msckf(stream.problem)
    for frame in stream.frames[:5]:
        z = frame.z.copy()
        if frame.k == 2:
            z[0, 0] = np.nan
        msckf.update(Frame(frame.k, frame.t, frame.T_prev_body, frame.Q, frame.ids, z, frame.R))
    with pytest.raises(DivergedError, match=r"frame 5: .* the innovation not finite"):
        msckf.update(stream.frames[5])


def test_poses_that_left_stay_in_the_trajectory_as_they_left() -> None:
    stream, truth = passing_by(seed=2, sensor_name="range_bearing", frames=16)
    msckf = Msckf(stream.problem, window=6)
    for frame in stream.frames[:12]:
        msckf.update(frame)
    early = msckf.trajectory()
    for frame in stream.frames[12:]:
        msckf.update(frame)
    late = msckf.trajectory()
    assert early.t.tolist() == [frame.t for frame in stream.frames[:12]]
    assert late.t.tolist() == [frame.t for frame in stream.frames]
    # Of twelve poses six were in the window, or five where the next frame's place is free already.
    np.testing.assert_array_equal(late.T_world_body[:6], early.T_world_body[:6])
    np.testing.assert_array_equal(late.P[:6], early.P[:6])
    errors = geometry.local(late.T_world_body, truth)
    assert np.einsum("ki,kij,kj->k", errors[1:], np.linalg.inv(late.P[1:]), errors[1:]).mean() < 10.0
