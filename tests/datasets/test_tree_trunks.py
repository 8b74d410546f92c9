"""Trunks in scans that are cast against circles and walls, where the right answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.datasets.tree_trunks import TrunkSize, find_trunks

BEARINGS = np.radians(0.5 * np.arange(361) - 90.0)
NONE = 81.91
Trunk = tuple[float, float, float]
"""Range and bearing of its middle, and its diameter."""


def cast(trunks: list[Trunk], walls: list[tuple[float, float]] = []) -> np.ndarray:  # noqa: B006
    """Ranges of a scan; a wall is a line at a distance, square to a bearing."""
    u = np.stack([np.cos(BEARINGS), np.sin(BEARINGS)], axis=1)
    r = np.full(BEARINGS.size, np.inf)
    for away, bearing, diameter in trunks:
        middle = away * np.array([np.cos(bearing), np.sin(bearing)])
        along = u @ middle
        across2 = away**2 - along**2
        hit = (across2 < (diameter / 2) ** 2) & (along > 0)
        surface = along - np.sqrt(np.maximum((diameter / 2) ** 2 - across2, 0.0))
        r = np.where(hit, np.minimum(r, surface), r)
    for away, bearing in walls:
        cosine = np.cos(BEARINGS - bearing)
        with np.errstate(divide="ignore"):
            r = np.minimum(r, np.where(cosine > 0.01, away / cosine, np.inf))
    return np.where(r < 80.0, r, NONE)


def test_the_middle_of_a_trunk_is_found_within_its_noise() -> None:
    generator = np.random.default_rng(4)
    errors = []
    for _ in range(300):
        diameter = generator.uniform(0.25, 0.9)
        trunk = (generator.uniform(3.0, min(30.0, diameter / 0.018)), generator.uniform(-1.4, 1.4), diameter)
        scan = cast([trunk]) + 0.02 * generator.normal(size=361)
        (found,) = find_trunks(scan, BEARINGS, TrunkSize())
        errors.append(found - trunk)
    off = np.array(errors)
    # Half a beam to each side at the most; in range, what the width's rounding to beams makes of the radius.
    assert np.abs(off[:, 1]).max() < np.radians(0.5)
    assert abs(off[:, 1].mean()) < np.radians(0.03)
    assert abs(off[:, 0].mean()) < 0.03
    assert off[:, 0].std() < 0.08
    assert abs(off[:, 2].mean()) < 0.05


def test_several_are_found_by_bearing_each_once() -> None:
    trunks = [(10.0, -1.0, 0.4), (25.0, -0.2, 0.6), (6.0, 0.3, 0.3), (15.0, 1.2, 0.5)]
    found = find_trunks(cast(trunks), BEARINGS, TrunkSize())
    np.testing.assert_allclose(found[:, :2], [trunk[:2] for trunk in trunks], rtol=0, atol=0.15)


@pytest.mark.parametrize(
    ("trunks", "walls", "left"),
    [
        ([(10.0, 0.0, 0.5)], [(8.0, np.pi / 2)], 1),
        ([], [(8.0, 0.2)], 0),
        ([(10.0, 0.0, 2.5)], [], 0),
        ([(10.0, 0.0, 0.5)], [(10.6, 0.0)], 0),
        ([(10.0, 0.0, 0.5)], [(20.0, 0.0)], 1),
        ([(10.0, 0.0, 0.5), (6.0, 0.045, 0.4)], [], 1),
        ([(1.0, 0.0, 0.3)], [], 0),
        ([(50.0, 0.0, 1.0)], [], 0),
        ([(30.0, 0.0, 0.2)], [], 0),
        ([(10.0, -np.pi / 2, 0.5)], [], 0),
    ],
    ids=["beside a wall", "a wall", "too thick", "before a wall", "a wall far behind", "half hidden",
         "too near", "too far", "one beam", "at the edge of the scan"],
)  # fmt: skip
def test_what_is_no_trunk(trunks: list[Trunk], walls: list[tuple[float, float]], left: int) -> None:
    found = find_trunks(cast(trunks, walls), BEARINGS, TrunkSize())
    assert len(found) == left
    if left and len(trunks) == 2:
        np.testing.assert_allclose(found[0, :2], trunks[1][:2], rtol=0, atol=0.1)


def test_readings_that_are_no_numbers_are_no_returns() -> None:
    scan = cast([(10.0, 0.4, 0.5)])
    scan[:40], scan[100:110], scan[300:] = np.nan, np.inf, -1.0
    (found,) = find_trunks(scan, BEARINGS, TrunkSize())
    np.testing.assert_allclose(found[:2], [10.0, 0.4], rtol=0, atol=0.1)
    assert find_trunks(np.full(361, np.nan), BEARINGS, TrunkSize()).shape == (0, 3)
