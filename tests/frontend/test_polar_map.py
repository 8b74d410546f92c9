"""The chart that a wrong heading does not bend: closed forms of a robot that turned by more than was told."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.frontend.own_map import SCALES, OwnMap
from slamcmp.frontend.polar_map import PolarMap
from slamcmp.geometry import inverse, se2, transform
from slamcmp.types import FloatArray

POINTS = np.array([[5.0, 1.0], [-3.0, 4.0], [2.0, -6.0], [-4.0, -2.0]])
SMALL = 1e-6 * np.eye(2)


def turned(own_map: OwnMap, by: float) -> FloatArray:
    """The map of POINTS after a turn that was told as none, to 0.5 rad; where the points really are."""
    for point in POINTS:
        own_map.add(point, SMALL)
    own_map.predict(np.eye(3), np.diag([1e-12, 1e-12, 0.25]))
    return transform(inverse(se2(0.0, 0.0, by)), POINTS)


@pytest.mark.parametrize("by", [-1.2, 0.4, 0.9])
def test_one_sighting_after_a_turn_places_all_the_others(by: float) -> None:
    own_map = PolarMap(0.0)
    true = turned(own_map, by)
    innovations = own_map.innovations(true, np.tile(SMALL, (4, 1, 1)), np.arange(4))
    own = np.arange(4)
    # An error of the heading alone, by its own sigma: (by / 0.5)^2, at every range.
    assert innovations.squared_distances[own, own] == pytest.approx((by / 0.5) ** 2, rel=1e-3)
    own_map.correct(np.array([0]), true[:1], SMALL[None])
    assert own_map.q == pytest.approx(true, abs=2e-3)
    # Of the heading the sighting left 1e-3 m over 5.1 m, from both its ends; the others' doubt across.
    left = np.sqrt(2e-6) / np.linalg.norm(POINTS[0])
    for point, row in zip(own_map.q[1:], range(1, 4), strict=True):
        r = np.linalg.norm(point)
        across = np.array([-point[1], point[0]]) / r
        block = own_map.P[SCALES + 2 * row : SCALES + 2 * row + 2, SCALES + 2 * row : SCALES + 2 * row + 2]
        assert across @ block @ across == pytest.approx(1e-6 + (r * left) ** 2, rel=1e-2)
        assert point @ block @ point / r**2 == pytest.approx(1e-6, rel=0.05)


def test_straight_deviations_would_miss_them() -> None:
    own_map = OwnMap(2, 0.0)
    true = turned(own_map, 0.9)
    innovations = own_map.innovations(true, np.tile(SMALL, (4, 1, 1)), np.arange(4))
    assert innovations.squared_distances[np.arange(4), np.arange(4)].min() > 1e3


def test_small_deviations_are_those_of_the_straight_map() -> None:
    """Both charts agree to first order: their difference falls with the square of the deviation."""
    rng = np.random.default_rng(3)
    step, Q = se2(0.3, 0.1, 0.2), np.diag([0.01, 0.01, 0.02]) ** 2
    gaps: list[float] = []
    noise = rng.normal(size=POINTS.shape)
    for size in (1e-2, 1e-3):
        maps: list[OwnMap] = [OwnMap(2, 0.1), PolarMap(0.1)]
        for each in maps:
            for point in POINTS:
                each.add(point, 0.01 * np.eye(2))
            each.predict(step, Q)
            each.correct(np.arange(3), each.q[:3] + size * noise[:3], np.tile(0.02 * np.eye(2), (3, 1, 1)))
        gaps.append(np.abs(maps[0].q - maps[1].q).max())
        assert maps[1].a == pytest.approx(maps[0].a, abs=10 * size**2)
    assert gaps[1] < gaps[0] / 50


def test_near_the_robot_landmarks_move_straight() -> None:
    own_map = PolarMap(0.0)
    own_map.add(np.array([0.01, 0.0]), np.eye(2))
    own_map.correct(np.array([0]), np.array([[0.0, 0.2]]), 1e-6 * np.eye(2)[None])
    assert np.isfinite(own_map.q).all()
    assert np.linalg.norm(own_map.q[0]) < 0.5
    assert np.linalg.eigvalsh(own_map.P).min() >= -1e-12


def test_two_landmarks_that_are_one_are_joined() -> None:
    """By the closed form of two measurements of one point."""
    own_map = PolarMap(0.0)
    own_map.add(np.array([3.0, 0.0]), np.diag([0.04, 0.01]))
    own_map.add(np.array([5.0, 5.0]), 0.01 * np.eye(2))
    own_map.add(np.array([3.01, 0.0]), np.diag([0.01, 0.01]))
    y, S = own_map.separations()
    assert y[0, 2] == pytest.approx([-0.01, 0.0])
    assert S[0, 2] == pytest.approx(np.diag([0.05, 0.02]))
    own_map.join(0, 2)
    assert len(own_map.q) == 2
    assert own_map.q[0] == pytest.approx([3.008, 0.0], abs=1e-5)
    assert own_map.P[SCALES : SCALES + 2, SCALES : SCALES + 2] == pytest.approx(
        np.diag([0.008, 0.005]), abs=1e-5
    )
    assert own_map.q[1] == pytest.approx([5.0, 5.0])
