"""Nullity and false information on systems whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.metrics.observability import (
    information_along,
    nullity_over_time,
    observability_matrix,
    observability_nullity,
    observability_rank,
    rigid_motions_planar,
    rigid_motions_spatial,
)
from slamcmp.models.sensors import RelativePosition

Blocks = list[tuple[np.ndarray, np.ndarray]]


def test_matrix_of_a_constant_velocity_model() -> None:
    """Position seen, F = [[1, 1], [0, 1]]: rows (1, k); one frame sees one direction, two see both."""
    F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    blocks = [(np.eye(2), H), (F, H), (F, H)]
    np.testing.assert_array_equal(observability_matrix(blocks), [[1, 0], [1, 1], [1, 2]])
    assert observability_nullity(blocks[:1]) == 1
    assert observability_rank(blocks) == 2
    assert nullity_over_time(blocks).tolist() == [1, 0, 0]


def test_frames_without_sightings_see_nothing() -> None:
    nothing = (np.eye(4), np.empty((0, 4)))
    assert observability_nullity([nothing, nothing]) == 4
    assert nullity_over_time([nothing, (np.eye(4), np.eye(4)[:1])]).tolist() == [4, 3]


def slam_blocks(n: int, wobble: float) -> tuple[Blocks, np.ndarray]:
    """Blocks of SLAM in the body tangent along a drive, Jacobians at the truth or, each by itself, beside it.

    Also the rigid motions of the world at the first frame.
    """
    rng = np.random.default_rng(n)
    sensor = RelativePosition(space_dim=n)
    world = rng.uniform(-5, 5, (4, n))
    p = 3 if n == 2 else 6
    step = geometry.exp(0.2 + 0.3 * rng.random(p))
    T = geometry.exp(rng.normal(size=p))
    motions = (rigid_motions_planar if n == 2 else rigid_motions_spatial)(T, world)
    blocks: Blocks = []
    for k in range(6):
        F = np.eye(p + world.size)
        if k:
            F[:p, :p] = geometry.adjoint(geometry.inverse(step))
            T = T @ step
        seen = np.array([k % 4, (k + 1) % 4])
        at = geometry.retract(T, wobble * rng.normal(size=p))
        H_pose, H_land = sensor.jacobians(at, world[seen] + wobble * rng.normal(size=(2, n)))
        H = np.zeros((2 * n, F.shape[0]))
        H[:, :p] = H_pose.reshape(2 * n, p)
        for i, landmark in enumerate(seen):
            H[i * n : (i + 1) * n, p + n * landmark : p + n * (landmark + 1)] = H_land[i]
        blocks.append((F, H))
    return blocks, motions


@pytest.mark.parametrize(("n", "unobservable"), [(2, 3), (3, 6)])
def test_slam_cannot_see_rigid_motions_of_the_world(n: int, unobservable: int) -> None:
    """FACTS, oracle identity 10: nullity 3 in the plane (6 in space) with Jacobians at the truth."""
    blocks, motions = slam_blocks(n, 0.0)
    assert observability_nullity(blocks) == unobservable
    assert nullity_over_time(blocks)[-1] == unobservable
    np.testing.assert_allclose(observability_matrix(blocks) @ motions, 0, atol=1e-12)
    noise = [0.01 * np.eye(2 * n)] * 6
    np.testing.assert_allclose(information_along(blocks, noise, motions), 0, atol=1e-20)


@pytest.mark.parametrize("n", [2, 3])
def test_jacobians_at_wandering_points_see_what_they_cannot(n: int) -> None:
    blocks, motions = slam_blocks(n, 0.1)
    assert observability_nullity(blocks) < (3 if n == 2 else 6)
    gained = information_along(blocks, [0.01 * np.eye(2 * n)] * 6, motions).sum(axis=0)
    turns = slice(2, 3) if n == 2 else slice(0, 3)
    assert (gained[turns] > 1.0).all()


def test_information_is_summed_in_the_units_of_the_noise() -> None:
    """H = 2, sigma² = 4, F = 3: the direction grows threefold a frame, information is 1, 9, 81."""
    blocks = [(np.eye(1), 2 * np.eye(1)), (3 * np.eye(1), 2 * np.eye(1)), (3 * np.eye(1), 2 * np.eye(1))]
    gained = information_along(blocks, [4 * np.eye(1)] * 3, np.eye(1))
    np.testing.assert_allclose(gained[:, 0], [1.0, 9.0, 81.0])


@pytest.mark.parametrize("n", [2, 3])
def test_rigid_motions_are_central_differences_of_moving_the_world(n: int) -> None:
    rng = np.random.default_rng(1)
    p = 3 if n == 2 else 6
    T, points = geometry.exp(rng.normal(size=p)), rng.normal(size=(3, n))
    h = 1e-6

    def moved(xi: np.ndarray) -> np.ndarray:
        G = geometry.exp(xi)
        return np.concatenate(
            [geometry.local(T, G @ T), geometry.transform(G, points).ravel() - points.ravel()]
        )

    expected = np.stack([(moved(h * unit) - moved(-h * unit)) / (2 * h) for unit in np.eye(p)], axis=1)
    ours = (rigid_motions_planar if n == 2 else rigid_motions_spatial)(T, points)
    np.testing.assert_allclose(ours, expected, atol=1e-8)
