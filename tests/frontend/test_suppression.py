"""Suppression against Brown's definition written out, and the spread of the fast variant."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from slamcmp.frontend.vision.features.harris import harris_corners
from slamcmp.frontend.vision.features.suppression import (
    _cell_winners,
    brown_radii,
    suppress_brown,
    suppress_cells,
)
from tests.frontend.photographs import photograph


def naive_squared_radii(xy: np.ndarray, response: np.ndarray, robustness: float) -> np.ndarray:
    squared = np.full(len(xy), np.inf)
    for i in range(len(xy)):
        for j in range(len(xy)):
            if response[i] < robustness * response[j]:
                squared[i] = min(squared[i], ((xy[i] - xy[j]) ** 2).sum())
    return squared


def test_radii_by_hand() -> None:
    # Strengths 10, 8, 4, 9.5: with 0.9, the fourth is not clearly weaker than the first (9.5 > 9).
    xy = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 0.0], [10.0, 0.0]])
    squared = brown_radii(xy, np.array([10.0, 8.0, 4.0, 9.5]), robustness=0.9)
    np.testing.assert_array_equal(squared, [np.inf, 25.0, 9.0, np.inf])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 70),
    robustness=st.sampled_from([0.5, 0.9, 1.0]),
    levels=st.sampled_from([1, 3, 1000]),
    side=st.sampled_from([3, 40]),
)
def test_radii_equal_the_definition(seed: int, count: int, robustness: float, levels: int, side: int) -> None:
    rng = np.random.default_rng(seed)
    # Few levels and a small grid give ties in strength and in place.
    xy = rng.integers(0, side, (count, 2)).astype(float)
    response = rng.integers(1, levels + 1, count).astype(float)
    np.testing.assert_array_equal(
        brown_radii(xy, response, robustness=robustness), naive_squared_radii(xy, response, robustness)
    )


def test_the_kept_corners_equal_the_definition_on_a_photograph() -> None:
    corners = harris_corners(photograph(1), count_max=600)
    squared = naive_squared_radii(corners.xy, corners.response, 0.9)
    expected = sorted(range(600), key=lambda i: (-squared[i], -corners.response[i]))[:100]
    kept = suppress_brown(corners.xy, corners.response, 100)
    assert set(kept.tolist()) == set(expected)
    assert (np.diff(corners.response[kept]) <= 0).all()


@pytest.mark.parametrize("number", [1, 3, 5])
@pytest.mark.parametrize("count", [200, 500, 1000])
def test_square_cells_spread_at_least_as_well_as_the_definition(number: int, count: int) -> None:
    """Two measures: mean distance to the nearest kept neighbour, and how far corners are from a kept one."""
    corners = harris_corners(photograph(number), count_max=3000)
    spread = {}
    for suppress in (suppress_brown, suppress_cells):
        kept = corners.xy[suppress(corners.xy, corners.response, count)]
        assert len(kept) == count
        tree = cKDTree(kept)
        to_neighbour = tree.query(kept, 2)[0][:, 1].mean()
        to_kept = np.sqrt((tree.query(corners.xy)[0] ** 2).mean())
        spread[suppress] = to_neighbour, to_kept
    assert spread[suppress_cells][0] >= spread[suppress_brown][0]
    assert spread[suppress_cells][1] <= spread[suppress_brown][1]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    total=st.integers(1, 300),
    count=st.integers(1, 120),
    side=st.sampled_from([1, 4, 300]),
)
def test_square_cells_give_the_wanted_number_of_distinct_corners(
    seed: int, total: int, count: int, side: int
) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.integers(0, side, (total, 2)).astype(float)
    response = rng.integers(1, 50, total).astype(float)
    kept = suppress_cells(xy, response, count)
    assert len(set(kept.tolist())) == len(kept) == min(count, total)
    assert (np.diff(response[kept]) <= 0).all()


def naive_winners(xy: np.ndarray, width: float) -> list[int]:
    """The definition: a cell's strongest, but for a stronger one of a neighbouring cell within 0.7 width."""
    cells = [tuple(cell) for cell in np.floor(xy / width).astype(int)]
    strongest = {cell: cells.index(cell) for cell in cells}
    return sorted(
        own
        for cell, own in strongest.items()
        if not any(
            other < own
            and max(abs(np.subtract(cell, place))) <= 1
            and ((xy[own] - xy[other]) ** 2).sum() < (0.7 * width) ** 2
            for place, other in strongest.items()
        )
    )


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("width", [4.0, 7.3, 30.0])
def test_winners_of_cells_equal_the_definition(seed: int, width: float) -> None:
    xy = np.random.default_rng(seed).uniform(0.0, (90.0, 60.0), (150, 2)).astype(np.float32)
    x, y = (np.append(axis, np.float32(1e9)) for axis in xy.T)
    extent = (float(xy[:, 0].max()) + 1.0, float(xy[:, 1].max()) + 1.0)
    assert sorted(_cell_winners(x, y, extent, width).tolist()) == naive_winners(xy, width)


def test_nothing_in_nothing_out() -> None:
    empty = np.empty((0, 2)), np.empty(0)
    assert suppress_brown(*empty, 10).size == 0
    assert suppress_cells(*empty, 10).size == 0
