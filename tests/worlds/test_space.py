"""The 3-D world: rigid poses, covariances proportional to the truth with a floor, honest noise."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from slamcmp import geometry as g
from slamcmp.worlds.space import space


def test_poses_are_rigid_and_follow_the_published_course() -> None:
    """Position and ZYX Euler angles of the authors' simulator, at 0.1 rad of the loop a step."""
    steps = 11
    log = space(0, steps=steps, loops=1.0 / (2 * np.pi))
    assert log.truth is not None
    poses = log.truth.T_world_body
    a = 0.1 * np.arange(steps)
    R = poses[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (steps, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)
    place = np.stack([50 * np.cos(3 * a), 40 * np.sin(2 * a), 20 * np.sin(2 * a + 1)], axis=-1)
    np.testing.assert_allclose(poses[:, :3, 3], place, atol=1e-12)
    # The first and last row and column of Rz(yaw) Ry(pitch) Rx(roll) give the angles.
    np.testing.assert_allclose(-R[:, 2, 0], np.sin(-3 * a), atol=1e-14)
    np.testing.assert_allclose(R[:, 1, 0], np.sin(4 * a) * np.cos(-3 * a), atol=1e-14)
    np.testing.assert_allclose(R[:, 2, 1], np.cos(-3 * a) * np.sin(5 * a + 2), atol=1e-14)
    np.testing.assert_allclose(R[:, 2, 2], np.cos(-3 * a) * np.cos(5 * a + 2), atol=1e-14)


def test_the_course_closes() -> None:
    truth = space(0, steps=40, loops=1.0).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_body[0], truth.T_world_body[-1], atol=1e-12)


def test_sigmas_are_shares_of_the_true_components_above_a_floor() -> None:
    log = space(0, steps=60, odometry_share=0.01, observation_share=0.004, noise_scale=5.0)
    poses = log.truth.T_world_body
    step = g.inverse(poses[:-1]) @ poses[1:]
    size = np.abs(np.concatenate([g.so3_log(step[:, :3, :3]), step[:, :3, 3]], axis=1))
    size[:, :3], size[:, 3:] = np.maximum(size[:, :3], 0.01), np.maximum(size[:, 3:], 0.1)
    # Noise before the step, T exp(n) U: its covariance in the axes before it is diagonal.
    back = g.adjoint(log.T_prev_body[1:])
    before = back @ log.Q[1:] @ np.swapaxes(back, 1, 2)
    np.testing.assert_allclose(np.diagonal(before, axis1=1, axis2=2), (0.05 * size) ** 2, rtol=1e-9)
    np.testing.assert_allclose(before - before * np.eye(6), 0.0, atol=1e-12)
    seen = log.detections[30]
    true = log.problem.sensor.predict(poses[30], log.truth.positions[seen.ids])
    expected = 0.02 * np.maximum(np.abs(true), 0.1)
    np.testing.assert_allclose(np.sqrt(np.diagonal(seen.R, axis1=1, axis2=2)), expected, rtol=1e-12)


def test_noise_has_the_covariance_it_states() -> None:
    log = space(3, steps=500)
    poses = log.truth.T_world_body
    errors = g.local(g.inverse(poses[:-1]) @ poses[1:], log.T_prev_body[1:])
    odometry = np.einsum("ki,kij,kj->", errors, np.linalg.inv(log.Q[1:]), errors)
    assert chdtri(errors.size, 1 - 5e-5) < odometry < chdtri(errors.size, 5e-5)
    total, count = 0.0, 0
    for T, seen in zip(poses, log.detections, strict=True):
        residual = seen.z - log.problem.sensor.predict(T, log.truth.positions[seen.ids])
        total += np.einsum("ki,kij,kj->", residual, np.linalg.inv(seen.R), residual)
        count += residual.size
    assert count > 3_000
    assert chdtri(count, 1 - 5e-5) < total < chdtri(count, 5e-5)


def test_what_is_seen_lies_in_range_and_cone() -> None:
    log = space(1, steps=80, field_of_view_deg=120.0, first_look=1)
    assert log.detections[0].ids.size == 0
    for T, seen in zip(log.truth.T_world_body[1:], log.detections[1:], strict=True):
        body = log.problem.sensor.predict(T, log.truth.positions)
        distance = np.linalg.norm(body, axis=1)
        angle = np.degrees(np.arccos(body[:, 2] / distance))
        np.testing.assert_array_equal(seen.ids, np.flatnonzero((distance < 20) & (angle <= 60)))


def test_a_map_seed_fixes_the_map() -> None:
    first, second = (space(seed, steps=5, map_seed=7) for seed in (1, 2))
    np.testing.assert_array_equal(first.truth.positions, second.truth.positions)
    assert not np.array_equal(first.T_prev_body, second.T_prev_body)
