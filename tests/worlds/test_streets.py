"""The town: blocks driven one by one and never left, trees seen from crossings, the data set's noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

from slamcmp import geometry as g
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import UsageError
from slamcmp.types import Log
from slamcmp.worlds.streets import streets


def poses(log: Log) -> np.ndarray:
    assert log.truth is not None
    return log.truth.T_world_body


def test_blocks_are_driven_one_by_one_and_the_town_is_never_left() -> None:
    T = poses(streets(4, steps=2001, blocks=4, turn_probability=0.3, landmarks=16))
    place, along = T[:, :2, 2], T[:, :2, 0]
    crossings = np.arange(0, 2001, 5)
    np.testing.assert_allclose(place[crossings] / 5, np.round(place[crossings] / 5), atol=1e-9)
    assert np.abs(place).max() == pytest.approx(15.0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(place, axis=0), axis=1), 1.0, atol=1e-9)
    # Turned on leaving a crossing, then straight on to the next.
    for offset in range(2, 6):
        np.testing.assert_allclose(along[crossings[:-1] + offset], along[crossings[:-1] + 1], atol=1e-9)
    np.testing.assert_allclose(np.abs(along).max(axis=1), 1.0, atol=1e-9)


def test_it_turns_as_often_as_asked_to_either_side() -> None:
    """Far from the edge of a large town; bounds are 4 standard deviations of a binomial count."""
    T = poses(streets(1, steps=10_001, blocks=800, turn_probability=0.25))
    quarters = np.round(g.wrap(np.diff(g.se2_coordinates(T)[::5, 2])) / (np.pi / 2))
    assert set(quarters) == {-1.0, 0.0, 1.0}
    for side in (-1, 1):
        assert abs((quarters == side).sum() - 250) < 4 * np.sqrt(2000 * 0.125 * 0.875)


def test_trees_stand_in_the_middle_of_blocks_and_are_seen_from_crossings_only() -> None:
    log = streets(1, steps=301)
    assert log.truth is not None
    positions = log.truth.positions
    np.testing.assert_allclose(positions / 5 - 0.5, np.round(positions / 5 - 0.5), atol=1e-12)
    assert len(np.unique(np.round(positions, 3), axis=0)) == 100
    assert np.abs(positions).max() == pytest.approx(47.5)
    for k, (T, seen) in enumerate(zip(poses(log), log.detections, strict=True)):
        distance = np.linalg.norm(log.problem.sensor.predict(T, positions), axis=1)
        expected = np.flatnonzero(distance < 8.0) if k and k % 5 == 0 else []
        np.testing.assert_array_equal(seen.ids, expected)


def test_noise_is_that_of_the_data_set() -> None:
    """Covariances as the file in the wheel has them, and errors to match; bounds of chi-square at 5e-5."""
    log = streets(2, steps=2001)
    graph = read_graph(wheel_file("cityTrees_reduced_1k.g2o"))
    np.testing.assert_allclose(
        log.Q[1:], np.tile(graph.pose_edges[0].covariance, (2000, 1, 1)), rtol=1e-9, atol=1e-15
    )
    T = poses(log)
    errors = g.local(log.T_prev_body[1:], g.inverse(T[:-1]) @ T[1:]) / [0.02, 0.02, 0.01]
    assert chdtri(errors.size, 1 - 5e-5) < (errors**2).sum() < chdtri(errors.size, 5e-5)
    total, count = 0.0, 0
    for pose, seen in zip(T, log.detections, strict=True):
        np.testing.assert_allclose(seen.R, np.tile(graph.landmark_edges[0].covariance, (seen.ids.size, 1, 1)))
        assert log.truth is not None
        residual = seen.z - log.problem.sensor.predict(pose, log.truth.positions[seen.ids])
        total, count = total + float((residual**2).sum()) / 0.01, count + residual.size
    assert count > 1000
    assert chdtri(count, 1 - 5e-5) < total < chdtri(count, 5e-5)


def test_it_is_as_rich_as_the_data_set() -> None:
    """Observations a pose: 4443 in 10 000 there, 406 in its first thousand; 4 maps of our own."""
    seen = [sum(each.ids.size for each in streets(seed).detections) for seed in range(4)]
    assert np.mean(seen) == pytest.approx(4443, rel=0.1)


def test_another_noise_leaves_route_and_map() -> None:
    one, other = streets(3, steps=200), streets(3, steps=200, position_sigma_m=0.3)
    np.testing.assert_array_equal(poses(one), poses(other))
    np.testing.assert_array_equal(one.T_prev_body, other.T_prev_body)
    assert one.detections[5].ids.size
    assert not np.array_equal(one.detections[5].z, other.detections[5].z)


def test_a_map_seed_fixes_the_map() -> None:
    one, other = streets(1, steps=20, map_seed=7), streets(2, steps=20, map_seed=7)
    assert one.truth is not None
    assert other.truth is not None
    np.testing.assert_array_equal(one.truth.positions, other.truth.positions)
    assert not np.array_equal(one.T_prev_body, other.T_prev_body)


def test_more_trees_than_blocks_are_refused() -> None:
    with pytest.raises(UsageError, match="17 landmarks in 16 blocks"):
        streets(0, steps=20, landmarks=17, blocks=4)
