"""Every way in which two views leave the epipolar geometry open gets its name, and no matrix."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.geometry.degeneracy import (
    Geometry,
    rotation_between,
    transfer_distance,
    verify_matches,
)
from slamcmp.frontend.vision.image_pair import precision_recall
from slamcmp.geometry import so3_exp
from tests.frontend.two_views import TURN, K, two_views

METHODS = ["magsac", "ransac"]
SEEDS = range(5)
each_method = pytest.mark.parametrize("method", METHODS)


@each_method
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_a_scene_with_depth_is_epipolar(method: str, wrong: float) -> None:
    for seed in SEEDS:
        views = two_views(seed, wrong=wrong)
        answer = verify_matches(views.first, views.second, seed=seed, method=method, K=K)
        assert answer.geometry is Geometry.EPIPOLAR
        assert answer.F.shape == (3, 3)
        assert answer.H is None
        precision, recall = precision_recall(answer.inliers, views.right)
        assert precision >= 0.98
        assert recall >= 0.9


@each_method
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_one_plane_is_named_and_verified_by_its_homography(method: str, wrong: float) -> None:
    for seed in SEEDS:
        views = two_views(seed, wrong=wrong, plane=True)
        answer = verify_matches(views.first, views.second, seed=seed, method=method, K=K)
        assert answer.geometry is Geometry.PLANAR_SCENE
        assert answer.F is None
        precision, recall = precision_recall(answer.inliers, views.right)
        assert precision >= 0.98
        assert recall >= 0.9
        assert np.median(transfer_distance(answer.H, views.first, views.second)[views.right]) < 1.0
        unknown = verify_matches(views.first, views.second, seed=seed, method=method)
        assert unknown.geometry is Geometry.PLANE_OR_ROTATION


@each_method
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_a_camera_that_only_turns_is_named(method: str, wrong: float) -> None:
    for seed in SEEDS:
        views = two_views(seed, wrong=wrong, translation=(0.0, 0.0, 0.0))
        answer = verify_matches(views.first, views.second, seed=seed, method=method, K=K)
        assert answer.geometry is Geometry.PURE_ROTATION
        assert answer.F is None
        precision, recall = precision_recall(answer.inliers, views.right)
        assert precision >= 0.98
        assert recall >= 0.9


@pytest.mark.parametrize("noise_px", [0.2, 0.5])
def test_the_name_does_not_hang_on_the_threshold(noise_px: float) -> None:
    """From two to five standard deviations of the noise, the same scene gets the same name."""
    turning = two_views(1, wrong=0.2, noise_px=noise_px, translation=(0.0, 0.0, 0.0))
    driving = two_views(1, wrong=0.2, noise_px=noise_px)
    for deviations in (2.0, 3.0, 5.0):
        for views, expected in ((turning, Geometry.PURE_ROTATION), (driving, Geometry.EPIPOLAR)):
            answer = verify_matches(
                views.first, views.second, seed=0, threshold_px=deviations * noise_px, K=K
            )
            assert answer.geometry is expected


def test_no_motion_is_named() -> None:
    views = two_views(0, translation=(0.0, 0.0, 0.0), turn=np.zeros(3), noise_px=0.2)
    answer = verify_matches(views.first, views.second, seed=0)
    assert answer.geometry is Geometry.NO_MOTION
    assert answer.F is None
    assert answer.inliers.mean() > 0.95


def test_points_on_one_line_are_named() -> None:
    x = np.linspace(50, 600, 60)
    first = np.column_stack([x, 0.5 * x + 10])
    answer = verify_matches(first, first + np.array([12.0, 3.0]), seed=0)
    assert answer.geometry is Geometry.COLLINEAR
    assert not answer.inliers.any()


@pytest.mark.parametrize("count", [0, 1, 7])
def test_too_few_matches_are_named(count: int) -> None:
    views = two_views(0)
    answer = verify_matches(views.first[:count], views.second[:count], seed=0)
    assert answer.geometry is Geometry.TOO_FEW
    assert answer.inliers.shape == (count,)
    assert answer.F is None


def test_one_match_repeated_is_too_few() -> None:
    answer = verify_matches(np.full((50, 2), 100.0), np.full((50, 2), 130.0), seed=0)
    assert answer.geometry is Geometry.TOO_FEW


@each_method
def test_nan_matches_are_left_out_and_counted(method: str) -> None:
    views = two_views(0)
    second = views.second.copy()
    second[:20, 0] = np.nan
    second[20:25, 1] = np.inf
    answer = verify_matches(views.first, second, seed=0, method=method)
    assert answer.geometry is Geometry.EPIPOLAR
    assert answer.not_finite == 25
    assert not answer.inliers[:25].any()
    assert answer.inliers[25:].mean() > 0.9
    assert np.isfinite(answer.F).all()
    nothing = verify_matches(views.first, np.full_like(second, np.nan), seed=0, method=method)
    assert nothing.geometry is Geometry.NOT_FINITE
    assert nothing.F is None
    assert nothing.not_finite == len(second)


def test_the_rotation_between_rays_is_recovered() -> None:
    views = two_views(3, translation=(0.0, 0.0, 0.0), noise_px=0.0)
    np.testing.assert_allclose(rotation_between(views.first, views.second, K), so3_exp(-TURN), atol=1e-12)


def test_arrays_that_do_not_pair_up_are_refused() -> None:
    with pytest.raises(UsageError, match="twice"):
        verify_matches(np.zeros((9, 2)), np.zeros((8, 2)), seed=0)


@pytest.mark.parametrize("threshold_px", [0.5, 3.0])
@pytest.mark.parametrize(("share", "collinear"), [(0.45, True), (0.55, False)])
def test_a_line_is_as_wide_as_half_the_threshold(threshold_px: float, share: float, collinear: bool) -> None:
    """Points to both sides of a line in turn: their smaller deviation is their distance from it."""
    x = np.linspace(50, 600, 60)
    off = share * threshold_px * np.where(np.arange(60) % 4 < 2, 1.0, -1.0)
    first = np.column_stack([x, 200.0 + off])
    answer = verify_matches(first, first + np.array([12.0, 3.0]), seed=0, threshold_px=threshold_px)
    assert (answer.geometry is Geometry.COLLINEAR) == collinear
