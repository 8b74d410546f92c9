"""The fundamental matrix: exact on exact data, robust where least squares is not, seeded."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.geometry.fundamental import (
    EpipolarFit,
    eight_point,
    least_squares,
    magsac,
    ransac,
    samples_needed,
    sampson_distance,
)
from slamcmp.frontend.vision.image_pair import precision_recall
from tests.frontend.two_views import TwoViews, two_views


def _error(F: np.ndarray, F_true: np.ndarray) -> float:
    """Frobenius distance of two matrices of norm 1 that are only known up to sign."""
    return min(np.linalg.norm(F - F_true), np.linalg.norm(F + F_true))


def _fit(method: str, views: TwoViews, seed: int = 0) -> EpipolarFit:
    if method == "ransac":
        return ransac(views.first, views.second, np.random.default_rng(seed))
    return magsac(views.first, views.second, seed)


@pytest.mark.parametrize("count", [8, 9, 100])
def test_eight_point_is_exact_without_noise(count: int) -> None:
    views = two_views(1, count, noise_px=0.0)
    F = eight_point(views.first, views.second)
    assert _error(F, views.F) < 1e-7
    assert np.linalg.norm(F) == pytest.approx(1.0)
    assert np.linalg.svd(F)[1][2] < 1e-12
    assert sampson_distance(views.F, views.first, views.second).max() < 1e-9


def test_eight_point_agrees_with_opencvs_in_distance_to_the_matches() -> None:
    views = two_views(2, 200)
    theirs, _ = cv2.findFundamentalMat(views.first, views.second, cv2.FM_8POINT)
    mine = eight_point(views.first, views.second)
    assert _error(mine, theirs / np.linalg.norm(theirs)) < 1e-6


def test_sampson_distance_by_hand() -> None:
    # A pure sideways translation: F = hat((1, 0, 0)), the epipolar lines are rows and x2ᵀ F x1 = v1 − v2.
    # Both gradients have length 1, so rows that differ by 3 px give 3 / √2.
    F = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    first, second = np.array([[10.0, 20.0], [10.0, 20.0]]), np.array([[50.0, 23.0], [-7.0, 20.0]])
    np.testing.assert_allclose(sampson_distance(F, first, second), [3 / np.sqrt(2), 0.0], rtol=1e-14)


def test_sampson_distance_has_the_deviation_of_the_noise() -> None:
    views = two_views(3, 20_000, noise_px=0.4)
    distance = sampson_distance(views.F, views.first, views.second)
    # Standard error of a standard deviation from 20 000 draws: 0.5 %; the bound is four of them.
    assert np.sqrt((distance**2).mean()) == pytest.approx(0.4, rel=0.02)


def test_the_number_of_samples_by_hand() -> None:
    assert samples_needed(0.5, 0.99) == 1177  # log 0.01 / log(1 − 1/256) = 1176.6
    assert samples_needed(1.0, 0.99) == 1.0
    assert samples_needed(0.0, 0.99) == np.inf


@pytest.mark.parametrize("method", ["ransac", "magsac"])
@pytest.mark.parametrize("wrong", [0.3, 0.45])
def test_wrong_matches_are_rejected_and_right_ones_kept(method: str, wrong: float) -> None:
    """With the epipolar test alone: a wrong match may lie on its line by chance (about 1 %)."""
    scores = []
    for seed in range(10):
        views = two_views(seed, 300, wrong=wrong)
        fit = _fit(method, views, seed)
        scores.append(precision_recall(fit.inliers, views.right))
        assert np.median(sampson_distance(fit.F, views.first, views.second)[views.right]) < 0.5
    precision, recall = np.array(scores).T
    assert precision.min() >= 0.98 if wrong == 0.3 else precision.min() >= 0.95
    assert recall.min() >= 0.9


def test_least_squares_is_spoilt_by_what_ransac_ignores() -> None:
    """The course's Problem 1, in numbers: 30 % wrong matches."""
    clean = two_views(5, 300)
    spoilt = two_views(5, 300, wrong=0.3)
    right = spoilt.right
    fine = least_squares(clean.first, clean.second)
    bent = least_squares(spoilt.first, spoilt.second)
    robust = ransac(spoilt.first, spoilt.second, np.random.default_rng(0))
    medians = [
        np.median(sampson_distance(fit.F, spoilt.first, spoilt.second)[right]) for fit in (fine, bent, robust)
    ]
    assert medians[0] < 0.4
    assert medians[1] > 10 * medians[2]
    assert medians[2] < 0.4
    assert precision_recall(bent.inliers, right)[1] < 0.3


@pytest.mark.parametrize("method", ["ransac", "magsac"])
def test_the_seed_decides_everything(method: str) -> None:
    views = two_views(6, 200, wrong=0.4)
    cv2.setRNGSeed(1)
    first = _fit(method, views, 7)
    cv2.setRNGSeed(99)
    again = _fit(method, views, 7)
    np.testing.assert_array_equal(first.F, again.F)
    np.testing.assert_array_equal(first.inliers, again.inliers)
    others = [_fit(method, views, seed).F for seed in range(20, 26)]
    assert any(not np.array_equal(first.F, F) for F in others)


def test_the_number_of_samples_adapts() -> None:
    iterations = []
    for wrong in (0.0, 0.4):
        views = two_views(8, 200, wrong=wrong)
        fit = ransac(views.first, views.second, np.random.default_rng(0), threshold_px=1.5)
        iterations.append(fit.iterations)
    assert iterations[0] <= 40
    # log 0.001 / log(1 − 0.6^8) = 408 with every right match an inlier.
    assert 300 <= iterations[1] <= 900


@pytest.mark.parametrize("count", [0, 1, 7])
def test_fewer_than_eight_matches_have_no_answer(count: int) -> None:
    views = two_views(9, 8)
    for method in ("ransac", "magsac"):
        fit = _fit(method, TwoViews(views.first[:count], views.second[:count], views.right[:count], views.F))
        assert fit.F is None
        assert fit.inliers.shape == (count,)
        assert not fit.inliers.any()
    assert least_squares(views.first[:count], views.second[:count]).F is None
