"""The 3-D world: rigid poses, covariances proportional to the truth with a floor, honest noise."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from slamcmp import geometry as g
from slamcmp.worlds.space import space


def test_poses_are_rigid_and_look_along_the_path() -> None:
    poses = space(0, steps=400, loops=1.0).truth.T_world_body
    R = poses[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (400, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)
    moved = poses[2:, :3, 3] - poses[:-2, :3, 3]
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    assert np.einsum("ki,ki->k", moved, R[1:-1, :, 0]).min() > 0.9999
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-12)


def test_sigmas_are_shares_of_the_true_components_above_a_floor() -> None:
    log = space(0, steps=60, odometry_share=0.01, observation_share=0.004, noise_scale=5.0)
    poses = log.truth.T_world_body
    size = np.abs(g.log(g.inverse(poses[:-1]) @ poses[1:]))
    size[:, :3], size[:, 3:] = np.maximum(size[:, :3], 0.01), np.maximum(size[:, 3:], 0.1)
    sigmas = np.sqrt(np.diagonal(log.Q[1:], axis1=1, axis2=2))
    np.testing.assert_allclose(sigmas, 0.05 * size, rtol=1e-9)
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
    assert count > 10_000
    assert chdtri(count, 1 - 5e-5) < total < chdtri(count, 5e-5)


def test_what_is_seen_lies_in_range_and_cone() -> None:
    log = space(1, steps=80)
    assert log.detections[0].ids.size == 0
    for T, seen in zip(log.truth.T_world_body[1:], log.detections[1:], strict=True):
        body = log.problem.sensor.predict(T, log.truth.positions)
        distance = np.linalg.norm(body, axis=1)
        angle = np.degrees(np.arccos(body[:, 0] / distance))
        np.testing.assert_array_equal(seen.ids, np.flatnonzero((distance < 20) & (angle <= 60)))


def test_a_map_seed_fixes_the_map() -> None:
    first, second = (space(seed, steps=5, map_seed=7) for seed in (1, 2))
    np.testing.assert_array_equal(first.truth.positions, second.truth.positions)
    assert not np.array_equal(first.T_prev_body, second.T_prev_body)
