"""More agreement than chance explains: by the formula, by simulation, and on pairs that are none."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from slamcmp.frontend.vision.geometry.degeneracy import Geometry, verify_matches
from slamcmp.frontend.vision.geometry.fundamental import sampson_distance
from slamcmp.frontend.vision.geometry.significance import (
    chance_at_point,
    chance_on_line,
    distinct,
    log10_false_alarms,
)
from slamcmp.frontend.vision.image_pair import extract_features, match_features
from tests.frontend.photographs import photograph
from tests.frontend.two_views import K, two_views

Alarms = dict[Geometry, int]


def of_random_matches(method: str, counts: list[int], runs: int) -> Alarms:
    """Outcomes on uniformly random matches in 640×480 pixels."""
    found: Alarms = {}
    for count in counts:
        for seed in range(runs):
            first, second = np.random.default_rng([seed, count]).uniform(0, [640, 480], (2, count, 2))
            answer = verify_matches(first, second, seed=seed, method=method)
            found[answer.geometry] = found.get(answer.geometry, 0) + 1
            assert answer.geometry is Geometry.CHANCE or answer.F is not None or answer.H is not None
            assert answer.geometry is not Geometry.CHANCE or not answer.inliers.any()
    return found


def test_random_matches_are_called_chance() -> None:
    """At most one pair in a hundred may pass; the bound is an upper one, and none of these does."""
    assert of_random_matches("magsac", [20, 30, 60, 120, 500], 4) == {Geometry.CHANCE: 20}
    assert of_random_matches("ransac", [40], 2) == {Geometry.CHANCE: 2}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["magsac", "ransac"])
def test_false_alarms_are_fewer_than_one_in_a_hundred(method: str) -> None:
    runs = 400 if method == "magsac" else 60
    found = of_random_matches(method, [20, 30, 50, 120, 500], runs)
    # Of 5 · runs pairs with 1 in 100 each, more than these come with a probability of 1e-4.
    alarms = sum(found.values()) - found.get(Geometry.CHANCE, 0)
    assert alarms <= 0.01 * 5 * runs


@pytest.mark.parametrize("method", ["magsac", "ransac"])
@pytest.mark.parametrize("plane", [False, True])
def test_few_right_matches_among_many_wrong_ones_are_still_found(method: str, plane: bool) -> None:
    for count, wrong in ((20, 0.1), (60, 0.4)) + (((120, 0.5),) if method == "magsac" else ()):
        views = two_views(2, count, wrong=wrong, plane=plane)
        answer = verify_matches(views.first, views.second, seed=0, method=method, threshold_px=1.5, K=K)
        assert answer.geometry is (Geometry.PLANAR_SCENE if plane else Geometry.EPIPOLAR)


def test_matches_that_repeat_are_counted_once() -> None:
    views = two_views(0, 8)
    first, second = (np.tile(each, (10, 1)) for each in (views.first, views.second))
    answer = verify_matches(first, second, seed=0)
    assert answer.geometry is Geometry.CHANCE
    assert not answer.inliers.any()


@pytest.mark.parametrize("method", ["magsac", "ransac"])
@pytest.mark.parametrize("spread_px", [0.1, 0.5, 1.5])
def test_a_feature_found_again_a_little_beside_its_place_is_no_other_one(
    method: str, spread_px: float
) -> None:
    for seed in range(3):
        views = two_views(seed, 8)
        jitter = np.random.default_rng(seed).uniform(-spread_px, spread_px, (2, 80, 2))
        first, second = (np.tile(each, (10, 1)) for each in (views.first, views.second))
        answer = verify_matches(first + jitter[0], second + jitter[1], seed=seed, method=method)
        assert answer.geometry is Geometry.CHANCE
        assert not answer.inliers.any()


@pytest.mark.parametrize("method", ["magsac", "ransac"])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirror_image_is_named_though_its_rows_obey_an_epipolar_geometry(method: str, axis: int) -> None:
    rng = np.random.default_rng(axis)
    for wrong in (0, 20):
        first = rng.uniform(0, [640, 480], (60, 2))
        second = first + rng.normal(0, 0.3, first.shape)
        second[:, axis] = (639, 479)[axis] - second[:, axis]
        second[:wrong] = rng.uniform(0, [640, 480], (wrong, 2))
        answer = verify_matches(first, second, seed=0, method=method)
        assert answer.geometry is Geometry.MIRRORED
        assert not answer.inliers.any()
        # A camera that is upside down is none.
        upside_down = verify_matches(first, [639.0, 479.0] - first, seed=0, method=method)
        assert upside_down.geometry is Geometry.PLANE_OR_ROTATION


def test_many_features_that_lead_to_one_are_no_geometry() -> None:
    """All epipolar lines meet in the epipole: one that lies on the common partner explains everything."""
    rng = np.random.default_rng(1)
    first = rng.uniform(0, [640, 480], (60, 2))
    second = np.tile(rng.uniform(100, 300, (4, 2)), (15, 1)) + rng.uniform(-0.2, 0.2, (60, 2))
    for a, b in ((first, second), (second, first)):
        assert verify_matches(a, b, seed=0).geometry is Geometry.CHANCE


def test_unrelated_photographs_and_mirrored_ones_have_nothing_in_common() -> None:
    pictures = {n: extract_features(photograph(n)) for n in (1, 2)}
    flipped = extract_features(np.ascontiguousarray(photograph(1)[:, ::-1]))
    rng = np.random.default_rng(0)
    leaves = extract_features(rng.integers(0, 256, (427, 640), dtype=np.uint8))
    for other in (flipped, leaves):
        for ratio in (0.8, 0.9, 1.0):
            pair = match_features(pictures[1], other, seed=0, ratio=ratio)
            assert pair.verification.geometry in (Geometry.CHANCE, Geometry.TOO_FEW)
            assert pair.counts["kept"] == 0
    # Two views of one house are a pair.
    pair = match_features(pictures[1], pictures[2], seed=0)
    assert pair.verification.geometry not in (Geometry.CHANCE, Geometry.TOO_FEW)
    assert pair.counts["kept"] > 50


def test_the_number_of_false_alarms_by_hand() -> None:
    # n = 5, k = 4, s = 2: (5 - 2) · 5 · 6 · p².
    assert log10_false_alarms(5, 4, 2, 0.1) == pytest.approx(math.log10(3 * 5 * 6 * 0.01))
    assert log10_false_alarms(8, 8, 8, 0.01) == 0.0
    assert log10_false_alarms(20, 12, 8, 1.0) == 0.0


def test_the_number_of_false_alarms_is_an_upper_bound_in_a_world_that_can_be_enumerated() -> None:
    """Points on a circle, models through one of them: whoever is within the threshold agrees."""
    rng = np.random.default_rng(4)
    n, p, alarms, runs = 10, 0.05, 0, 4000
    for _ in range(runs):
        x = rng.uniform(0, 1, n)
        off = np.abs(x[:, None] - x[None, :])
        best = (np.minimum(off, 1 - off) <= p / 2).sum(axis=1).max()
        alarms += log10_false_alarms(n, int(best), 1, p) <= -1.0
    assert alarms / runs <= 0.1


def test_chances_agree_with_random_matches() -> None:
    """Random partners near the epipolar lines of a known geometry: the bound holds and is not idle."""
    rng = np.random.default_rng(5)
    views = two_views(1, 50)
    first, second = rng.uniform(0, [640, 480], (2, 200_000, 2))
    near = (sampson_distance(views.F, first, second) <= 1.0).mean()
    bound = chance_on_line(first, second, 1.0)
    assert 0.4 * bound < near <= bound
    at_point = (np.linalg.norm(first - second, axis=1) <= 20.0).mean()
    # 200 000 pairs of which 0.4 % agree: a deviation of 3.5 %.
    assert 0.8 < at_point / chance_at_point(first, second, 20.0) < 1.04


def test_distinct_matches_are_those_of_distinct_features() -> None:
    grid = np.array([[10.5 * i, 7.5 * j] for i in range(4) for j in range(4)])
    assert distinct(grid, grid, 1.0) == 16
    assert distinct(np.repeat(grid, 2, axis=0), np.repeat(grid, 2, axis=0), 1.0) == 16
    pairs = np.array(list(combinations(range(16), 2)))
    assert distinct(grid[pairs[:, 0]], grid[pairs[:, 1]], 1.0) == 15


@pytest.mark.parametrize("columns", [40, 64])
def test_corners_of_a_pattern_that_repeats_matched_at_random_are_chance(columns: int) -> None:
    """They stand in rows: a geometry that takes a row for a row holds for one in so many of any matches."""
    grid = np.stack(np.meshgrid(np.arange(20, 640, columns), np.arange(20, 480, 40)), -1).reshape(-1, 2)
    wrong = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        first, second = (
            grid[rng.integers(0, len(grid), 500)] + rng.normal(0, 0.2, (500, 2)) for _ in range(2)
        )
        wrong += verify_matches(first, second, seed=seed).geometry is not Geometry.CHANCE
    assert wrong == 0


def test_a_rectified_pair_whose_matches_come_row_by_row_is_no_chance() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        first = rng.uniform(0, [640, 480], (40, 2))
        first = first[np.argsort(first[:, 1])]
        second = first - np.column_stack([rng.uniform(5, 60, 40), np.zeros(40)])
        second += rng.normal(0, 0.2, (40, 2))
        assert verify_matches(first, second, seed=seed).geometry is Geometry.EPIPOLAR


def near_a_predicted_place(kind: str, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Partners that were looked for in a window only, about the place that some motion predicts."""
    first = rng.uniform(0, [640, 480], (count, 2))
    if kind == "window":
        return first, first + rng.uniform(-30, 30, (count, 2))
    if kind == "small window":
        return first, first + rng.uniform(-8, 8, (count, 2))
    if kind == "normal":
        return first, first + rng.normal(0, 15, (count, 2))
    off_centre = first - [320.0, 240.0]
    return first, first + 0.15 * off_centre + [40.0, -20.0] + rng.uniform(-20, 20, (count, 2))


WINDOWS = ["window", "small window", "normal", "zoom"]


@pytest.mark.parametrize("kind", WINDOWS)
def test_partners_from_anywhere_in_a_window_are_chance(kind: str) -> None:
    for count in (20, 60, 500):
        for seed in range(3):
            first, second = near_a_predicted_place(kind, np.random.default_rng([seed, count]), count)
            assert verify_matches(first, second, seed=seed).geometry is Geometry.CHANCE
    # The same places with a geometry behind them are one.
    views = two_views(3, 60, wrong=0.1)
    assert verify_matches(views.first, views.second, seed=0).geometry is Geometry.EPIPOLAR


@pytest.mark.slow
@pytest.mark.parametrize("kind", WINDOWS)
def test_windows_give_fewer_false_alarms_than_one_in_a_hundred(kind: str) -> None:
    alarms, runs = 0, 100
    for count in (20, 30, 60, 120, 500):
        for seed in range(runs):
            first, second = near_a_predicted_place(kind, np.random.default_rng([seed, count, 7]), count)
            alarms += verify_matches(first, second, seed=seed).geometry is not Geometry.CHANCE
    assert alarms <= 0.01 * 5 * runs
