"""GTSAM's own camera factors against the sensor models, and the graph back ends on camera streams."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.entries import Entries, derivatives, errors
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.factors import landmark_key, observation_factors, pose_key
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.errors import DivergedError
from slamcmp.models.camera import Camera
from slamcmp.models.sensors import entry_sensor
from tests.backends.graph_streams import run
from tests.camera_stream import CAMERAS, Kind, camera_stream, without_returns

KINDS: tuple[Kind, ...] = ("stereo", "mono", "rgbd")
SENSORS: list[Any] = [*CAMERAS.values(), entry_sensor(CAMERAS["mono"])]
NAMES = [*CAMERAS, "entries"]


def whitened(
    camera: Camera, R: np.ndarray, T: np.ndarray, point: np.ndarray, z: np.ndarray
) -> tuple[Any, ...]:
    """b and A of the one factor that the sensor makes for z, linearised at T and the point."""
    sights = Entries(np.array([7]), z[None], R[None], 0)
    (factor,) = observation_factors(camera, lambda model: model).factors(pose_key(0), sights)
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3(T))
    values.insert(landmark_key(7), point)
    A, minus_b = factor.linearize(values).jacobian()
    if factor.keys()[0] != pose_key(0):
        A = np.concatenate([A[:, 3:], A[:, :3]], axis=1)
    return -minus_b, A, 2.0 * factor.error(values)


@pytest.mark.parametrize("camera", SENSORS, ids=NAMES)
def test_whitened_error_and_jacobians_are_those_of_the_sensor_model(camera: Camera) -> None:
    """fx and fy differ, the camera is mounted askew, R is full; random poses and points in front."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        T = geometry.exp(rng.normal(size=6) * [1, 1, 1, 5, 5, 5])
        q = np.array([*rng.uniform(-3, 3, 2), rng.uniform(0.5, 12)])
        point = geometry.transform(T @ camera.T_body_camera, q)
        z = camera.predict(T, point) + rng.normal(size=camera.dim) * 3
        root = rng.normal(size=(camera.dim, camera.dim))
        R = root @ root.T + 0.1 * np.eye(camera.dim)
        b, A, chi2 = whitened(camera, R, T, point, z)
        W = np.linalg.inv(np.linalg.cholesky(R))
        # GTSAM's whitener is an upper triangle: equal up to a rotation of the rows.
        H = np.concatenate(camera.jacobians(T, point), axis=1)
        turn = (A @ np.linalg.pinv(W @ H)) if camera.dim == 3 else None
        residual = -camera.residual(z, camera.predict(T, point))
        information = np.linalg.inv(R)
        assert chi2 == pytest.approx(residual @ information @ residual, rel=1e-9)
        scale = np.abs(A.T @ A).max()
        np.testing.assert_allclose(A.T @ A, H.T @ information @ H, rtol=0, atol=1e-9 * scale)
        expected = H.T @ information @ residual
        np.testing.assert_allclose(A.T @ b, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max()))
        if turn is not None:
            np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)


@pytest.mark.parametrize("camera", SENSORS, ids=NAMES)
def test_with_unit_noise_rows_agree_one_by_one(camera: Camera) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        T = geometry.exp(rng.normal(size=6) * [1, 1, 1, 5, 5, 5])
        q = np.array([*rng.uniform(-3, 3, 2), rng.uniform(0.5, 12)])
        point = geometry.transform(T @ camera.T_body_camera, q)
        z = camera.predict(T, point) + rng.normal(size=camera.dim) * 3
        b, A, _ = whitened(camera, np.eye(camera.dim), T, point, z)
        H = np.concatenate(camera.jacobians(T, point), axis=1)
        np.testing.assert_allclose(b, camera.predict(T, point) - z, rtol=0, atol=1e-9)
        np.testing.assert_allclose(A, H, rtol=0, atol=1e-9 * np.abs(H).max())


@pytest.mark.parametrize("camera", SENSORS, ids=NAMES)
def test_behind_the_camera_the_error_is_constant_and_has_no_derivative(camera: Camera) -> None:
    """GTSAM's convention, and the same of what stands beside it (``errors``, ``derivatives``)."""
    T = geometry.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    point = geometry.transform(T @ camera.T_body_camera, np.array([0.5, -0.2, -3.0]))
    z = np.full(camera.dim, 100.0)
    b, A, _ = whitened(camera, np.eye(camera.dim), T, point, z)
    np.testing.assert_array_equal(b, np.full(camera.dim, 2 * camera.fx_px))
    np.testing.assert_array_equal(A, 0.0)
    np.testing.assert_array_equal(errors(camera, T, point, z), b)
    assert not any(H.any() for H in derivatives(camera, T, point))
    both = np.stack([point, geometry.transform(T @ camera.T_body_camera, np.array([0.5, -0.2, 3.0]))])
    np.testing.assert_array_equal(errors(camera, T, both, np.stack([z, z]))[0], b)
    np.testing.assert_array_equal(derivatives(camera, T, both)[1][1], camera.jacobians(T, both)[1][1])


@pytest.mark.parametrize("kind", KINDS)
def test_smoothers_agree_at_the_optimum(kind: Kind) -> None:
    """Batch by Levenberg-Marquardt, iSAM2 iterated, and fixed lag with a lag of the whole run."""
    stream, _ = camera_stream(kind, frames=16, landmarks=50)
    batch = run(Batch(stream.problem), stream)
    best = batch.trajectory()
    exact = {"relinearize_threshold": 0.0, "relinearize_skip": 1, "extra_updates": 12}
    isam2 = run(Isam2(stream.problem, **exact), stream)  # type: ignore[arg-type]
    lag = run(FixedLag(stream.problem, lag_frames=99, mode="batch"), stream)
    for other in (isam2, lag):
        np.testing.assert_allclose(other.trajectory().T_world_body, best.T_world_body, rtol=0, atol=1e-5)
        np.testing.assert_allclose(other.estimate().P, best.P[-1], rtol=1e-3, atol=1e-9)
        np.testing.assert_allclose(other.landmarks().positions, batch.landmarks().positions, atol=1e-3)
    assert batch.diagnostics()["behind_camera"] == 0
    assert isam2.diagnostics()["chi2"] == pytest.approx(batch.diagnostics()["chi2"], rel=1e-6)
    rows = sum(frame.z.size for frame in stream.frames)
    rows += sum(frame.entries.z.size for frame in stream.frames if frame.entries is not None)
    assert batch.diagnostics()["dof"] == rows - 3 * batch.diagnostics()["landmarks"]


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_batch_chi_square_and_errors_are_what_the_noise_makes_them(kind: Kind) -> None:
    """12 worlds: sum of chi-square in its 99.9 % band, mean NEES of the last pose (6) too."""
    chi2, dof, nees = 0.0, 0.0, []
    for seed in range(12):
        stream, truth = camera_stream(kind, frames=20, landmarks=60, seed=seed, noise=0.3)
        batch = run(Batch(stream.problem), stream)
        final = batch.trajectory()
        error = geometry.local(final.T_world_body[-1], truth.T_world_body[-1])
        nees.append(error @ np.linalg.solve(final.P[-1], error))
        chi2 += batch.diagnostics()["chi2"]
        dof += batch.diagnostics()["dof"]
    assert abs(chi2 / dof - 1.0) < 3.3 * np.sqrt(2.0 / dof)
    # chi-square with 72 dof over 12: 99.9 % within 3.1 and 10.1.
    assert 3.1 < np.mean(nees) < 10.1


@pytest.mark.parametrize("mode", ["incremental", "batch"])
def test_what_returns_after_it_left_the_window_is_dropped_where_one_pixel_does_not_place_it(
    mode: Any,
) -> None:
    stream = without_returns(camera_stream("mono", frames=14)[0])
    victim = int(stream.frames[3].ids[0])
    frames = []
    for frame in stream.frames:
        keep = frame.ids != victim if 4 <= frame.k <= 8 else np.ones(frame.ids.size, dtype=bool)
        frames.append(replace(frame, ids=frame.ids[keep], z=frame.z[keep], R=frame.R[keep]))
    assert victim in frames[9].ids
    back_end = FixedLag(stream.problem, lag_frames=2, mode=mode, landmarks="drop")
    for frame in frames:
        back_end.update(frame)
        assert back_end.diagnostics()["dropped"] == (frame.k > 8 and victim in frame.ids)
    # As it left, remembered but not improved.
    assert victim in back_end.landmarks().ids
    kept = run(FixedLag(stream.problem, lag_frames=2, mode=mode), replace(stream, frames=tuple(frames)))
    assert kept.diagnostics()["dropped"] == 0


@pytest.mark.parametrize("make", [Batch, Isam2, FixedLag])
def test_a_solution_behind_the_camera_is_no_result(make: Any) -> None:
    """A robot that is told it turned round: most of what it sees cannot be in front of it."""
    stream, _ = camera_stream("stereo", frames=6)
    turned = geometry.exp(np.array([0, 0, np.pi, 0, 0, 0.0]))
    frames = [
        replace(frame, T_prev_body=frame.T_prev_body @ turned if frame.k == 3 else frame.T_prev_body)
        for frame in stream.frames
    ]
    back_end = make(stream.problem)
    for frame in frames:
        back_end.update(frame)
    with pytest.raises(DivergedError, match="behind the camera"):
        back_end.trajectory()


@pytest.mark.parametrize("make", [Batch, Isam2])
def test_a_far_landmark_that_a_step_sends_behind_the_camera_ends_no_run(make: Any) -> None:
    """It enters with a disparity of 0.3 px and then shows 4: from 533 m one step goes to some -3000 m."""
    stream, truth = camera_stream("stereo", frames=8, landmarks=1200, seen_at_once=120)
    camera = CAMERAS["stereo"]
    far = geometry.transform(camera.T_body_camera, np.array([0.5, -0.5, 40.0]))
    frames = []
    for frame in stream.frames:
        z = camera.predict(truth.T_world_body[frame.k], far)
        if frame.k == 0:
            z = np.array([z[0], z[0] - 0.3, z[2]])
        frames.append(
            replace(
                frame,
                ids=np.append(frame.ids, 900),
                z=np.vstack([frame.z, z]),
                R=np.concatenate([frame.R, frame.R[:1]]),
            )
        )
    settings = {"relinearize_threshold": 0.0, "relinearize_skip": 1} if make is Isam2 else {}
    without, with_it = make(stream.problem, **settings), make(stream.problem, **settings)
    for frame, more in zip(stream.frames, frames, strict=True):
        without.update(frame)
        with_it.update(more)
    plain, other = without.trajectory(), with_it.trajectory()
    sigma = np.sqrt(np.diag(plain.P[-1]))
    difference = geometry.local(plain.T_world_body[-1], other.T_world_body[-1])
    assert (np.abs(difference) < 0.5 * sigma).all()
    if make is Batch:
        assert with_it.diagnostics()["behind_camera"] == 0
        # A landmark whose first sight was an outlier of 3.7 px on 0.7: it costs, but not 2 fx a component.
        assert with_it.diagnostics()["chi2"] - without.diagnostics()["chi2"] < 2 * (3.7 / 0.7) ** 2
