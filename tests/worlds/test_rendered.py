"""The renderer against projective geometry by hand, and the logs made with it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.geometry.degeneracy import Geometry, verify_matches
from slamcmp.frontend.vision.image_pair import extract_features, match_features, precision_recall
from slamcmp.geometry import dead_reckoning, inverse, local
from slamcmp.registry import sources
from slamcmp.types import Log
from slamcmp.worlds.rendered import rendered
from slamcmp.worlds.rendering.camera_image import render_depth, render_exposure
from slamcmp.worlds.rendering.scene import Panel, Scene

K = np.array([[200.0, 0.0, 159.5], [0.0, 200.0, 119.5], [0.0, 0.0, 1.0]])
SIZE = (320, 240)
SMALL = {"width_px": 320, "height_px": 240, "steps": 40}


def _wall(texture: np.ndarray, distance: float = 2.0) -> Panel:
    """A wall 2 m wide and 1 m high that faces a camera at the origin looking along z."""
    return Panel(
        np.array([-1.0, -0.5, distance]), np.array([2.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), texture
    )


def test_a_frontal_wall_covers_the_pixels_it_should() -> None:
    scene = Scene([_wall(np.full((50, 100), 200, dtype=np.uint8))])
    image = render_exposure(scene, [np.eye(4)], K, SIZE)
    # 1 m at 2 m is 100 px: columns 59.5 to 259.5, rows 69.5 to 169.5, the sample at the centre − 0.25.
    expected = np.zeros((240, 320))
    expected[70:170, 60:260] = 200
    np.testing.assert_array_equal(image, expected)
    depth = render_depth(scene, np.eye(4), K, SIZE)
    np.testing.assert_allclose(depth, np.where(expected > 0, 2.0, 0.0), rtol=1e-6)


def test_a_wall_is_seen_from_its_front_only() -> None:
    scene = Scene([_wall(np.full((50, 100), 200, dtype=np.uint8))])
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])
    behind[2, 3] = 4.0
    assert render_exposure(scene, [behind], K, SIZE).max() == 0
    assert np.isnan(scene.depth_at(behind, K, np.array([[159.5, 119.5]]))).all()


def test_the_nearer_surface_hides_the_farther_in_either_order() -> None:
    far = _wall(np.full((50, 100), 100, dtype=np.uint8), 4.0)
    near = _wall(np.full((50, 100), 220, dtype=np.uint8), 2.0)
    for panels in ([far, near], [near, far]):
        image = render_exposure(Scene(panels), [np.eye(4)], K, SIZE)
        assert (image[70:170, 60:260] == 220).all()


def test_texture_lands_where_the_homography_says() -> None:
    """A slanting wall's dots are found where their world points project."""
    texture = np.zeros((400, 800), dtype=np.uint8)
    dots = [(x, y) for x in range(100, 800, 150) for y in range(80, 400, 120)]
    for dot in dots:
        cv2.circle(texture, dot, 14, 255, -1)
    panel = Panel(np.array([-0.9, -0.5, 1.6]), np.array([1.7, 0.1, 0.9]), np.array([0.05, 0.9, 0.1]), texture)
    image = render_exposure(Scene([panel], tile_m=0.4), [np.eye(4)] * 4, K, SIZE)
    for x, y in dots:
        point = panel.corner + panel.edge_s * (x + 0.5) / 800 + panel.edge_t * (y + 0.5) / 400
        u, v = (K @ point)[:2] / point[2]
        patch = image[round(v) - 12 : round(v) + 13, round(u) - 12 : round(u) + 13].astype(float)
        rows, columns = np.mgrid[round(v) - 12 : round(v) + 13, round(u) - 12 : round(u) + 13]
        found = np.array([(patch * columns).sum(), (patch * rows).sum()]) / patch.sum()
        # Perspective moves a disc's centroid off its centre's image by less than a tenth of a pixel here.
        np.testing.assert_allclose(found, [u, v], atol=0.2)


def test_depth_image_equals_exact_rays() -> None:
    log = rendered(1, camera="rgbd", depth_sigma_per_m2=0.0, depth_max_m=50.0, **SMALL)
    depth = log.images[7].depth_m
    pixels = np.stack(np.meshgrid(np.arange(3, 320, 11), np.arange(2, 240, 9)), axis=-1).reshape(-1, 2)
    exact = log.images.scene.depth_at(log.images.camera_pose(7), log.images.camera.K, pixels.astype(float))
    assert np.isfinite(exact).all()
    close = np.abs(depth[pixels[:, 1], pixels[:, 0]] - exact) < 1e-4 * exact
    # Single precision may decide a pixel exactly on an edge differently.
    assert close.mean() > 0.999


def test_motion_blur_is_the_mean_over_the_exposure() -> None:
    scene = Scene([_wall(np.full((50, 100), 200, dtype=np.uint8))])
    poses = []
    for step in (0.0, 0.01, 0.02, 0.03):
        pose = np.eye(4)
        pose[0, 3] = step
        poses.append(pose)
    image = render_exposure(scene, poses, K, SIZE)
    # 1 cm at 2 m is 1 px: the left edge ramps over three columns more, and so does the right one.
    row = image[120]
    assert row[55] == 0.0
    assert row[61] == 200.0
    assert np.count_nonzero((row > 0) & (row < 200)) == 6
    np.testing.assert_allclose(row.sum(), 200 * 200, rtol=1e-6)


def test_the_stereo_pair_is_rectified_with_the_stated_baseline() -> None:
    log = rendered(2, camera="stereo", noise_sigma=0.0, light_change=0.0, exposure_share=0.0, **SMALL)
    frame = log.images[5]
    left, right = extract_features(frame.image), extract_features(frame.right)
    pair = match_features(left, right, seed=0)
    sensor = log.problem.sensor
    depth = log.images.scene.depth_at(log.images.camera_pose(5), sensor.K, pair.first)
    expected = pair.first - np.stack([sensor.fx_px * 0.12 / depth, np.zeros_like(depth)], axis=-1)
    error = np.linalg.norm(pair.second - expected, axis=1)
    assert len(error) > 60
    assert np.median(error) < 0.3


def test_matches_of_a_rendered_pair_are_right() -> None:
    """Both the front end and the true correspondences: an error in either would show here."""
    log = rendered(3, camera="mono")
    truth = log.images
    scores = []
    for k, j in ((0, 2), (40, 43), (100, 105)):
        pair = match_features(
            extract_features(truth[k].image), extract_features(truth[j].image), seed=0, K=log.problem.sensor.K
        )
        expected = truth.true_pixels(k, j, pair.first)
        error = np.linalg.norm(pair.second - expected, axis=1)
        known = np.isfinite(error)
        scores.append(precision_recall(pair.kept[known], error[known] < 3.0))
        assert pair.verification.geometry is Geometry.EPIPOLAR
        assert np.median(error[known & pair.kept]) < 0.7
        assert pair.counts["kept"] > 100
    precision, recall = np.array(scores).T
    assert precision.min() > 0.95
    assert recall.min() > 0.9


def test_true_pixels_return_and_respect_occlusion() -> None:
    log = rendered(4, camera="mono", **SMALL)
    images = log.images
    rng = np.random.default_rng(0)
    pixels = rng.uniform([0, 0], [319, 239], (400, 2))
    there = images.true_pixels(10, 16, pixels)
    visible = np.isfinite(there).all(axis=1)
    assert 0.4 < visible.mean() < 1.0
    back = images.true_pixels(16, 10, there[visible])
    returned = np.isfinite(back).all(axis=1)
    assert returned.mean() > 0.99
    np.testing.assert_allclose(back[returned], pixels[visible][returned], atol=1e-6)
    points = images.surface_points(10, pixels)
    np.testing.assert_allclose(
        log.problem.sensor.predict(log.truth.T_world_body[10], points), pixels, atol=1e-9
    )


def test_the_same_seed_gives_the_same_log_and_another_seed_another() -> None:
    first, again, other = (rendered(seed, **SMALL) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.T_prev_body, again.T_prev_body)
    # Frames do not depend on the order in which they are asked for.
    late = first.images[9].image
    np.testing.assert_array_equal(again.images[3].image, first.images[3].image)
    np.testing.assert_array_equal(again.images[9].image, late)
    np.testing.assert_array_equal(again.images[9].right, first.images[9].right)
    assert (other.images[9].image != late).mean() > 0.5
    assert not np.array_equal(other.T_prev_body, first.T_prev_body)


def test_noise_has_the_stated_deviation() -> None:
    quiet = rendered(7, noise_sigma=0.0, **SMALL).images[4].image.astype(float)
    noisy = rendered(7, noise_sigma=4.0, **SMALL).images[4].image.astype(float)
    inner = (quiet > 30) & (quiet < 220)
    # Rounding twice adds 2/12 grey levels²; 60 000 pixels give the deviation to 0.3 %.
    assert (noisy - quiet)[inner].std() == pytest.approx(np.sqrt(16 + 2 / 12), rel=0.015)
    assert abs((noisy - quiet)[inner].mean()) < 0.1


def test_light_changes_as_much_as_stated() -> None:
    log = rendered(8, light_change=0.3, **{**SMALL, "steps": 160})
    gain = log.images.exposure.gain
    assert 1.25 < gain.max() < 1.40
    assert 0.60 < gain.min() < 0.75


def _normalised_odometry_errors(log: Log) -> np.ndarray:
    true = inverse(log.truth.T_world_body[:-1]) @ log.truth.T_world_body[1:]
    error = local(true, log.T_prev_body[1:])
    return error / np.sqrt(np.diagonal(log.Q[1:], axis1=1, axis2=2))


def test_odometry_errors_have_the_stated_covariance() -> None:
    many = {**SMALL, "steps": 401}
    normal = np.concatenate([_normalised_odometry_errors(rendered(seed, **many)) for seed in range(2)])
    # 800 draws a component: the mean of squares has a standard error of 0.05; four of them.
    np.testing.assert_allclose((normal**2).mean(axis=0), np.ones(6), atol=0.2)
    log = rendered(0, **SMALL)
    drift = dead_reckoning(log.truth.T_world_body[0], log.T_prev_body) - log.truth.T_world_body
    assert np.linalg.norm(drift[-1, :3, 3]) > 0.005


@pytest.mark.parametrize("building", ["room", "corridor"])
def test_the_robot_stays_inside_and_sees_a_surface_everywhere(building: str) -> None:
    log = rendered(9, building=building, length_m=4.0, steps=120, width_px=320, height_px=240)
    pixels = np.stack(np.meshgrid(np.arange(0, 320, 20.0), np.arange(0, 240, 20.0)), axis=-1).reshape(-1, 2)
    for k in range(0, 120, 10):
        depth = log.images.scene.depth_at(log.images.camera_pose(k), log.images.camera.K, pixels)
        assert np.isfinite(depth).all()
        assert depth.min() > 0.25


def test_the_source_is_registered_and_refuses_other_names() -> None:
    assert sources.get("rendered").target is rendered
    with pytest.raises(UsageError, match="room or corridor"):
        rendered(0, building="cellar", **SMALL)
    with pytest.raises(UsageError, match="mono, stereo or rgbd"):
        rendered(0, camera="fisheye", **SMALL)


def test_frames_are_indexed_like_a_list() -> None:
    log = rendered(0, **SMALL)
    assert len(log.images) == 40
    np.testing.assert_array_equal(log.images[-1].image, log.images[39].image)
    with pytest.raises(IndexError):
        log.images[40]


def test_injected_wrong_matches_are_found_by_the_epipolar_test_alone() -> None:
    """30 % of real matches are given a wrong partner; the truth comes from the renderer.

    A wrong partner on the right epipolar line passes by nature, and lines crowd where the corners do: 2 % of
    what is kept. Only a predicted position can find those.
    """
    log = rendered(11, camera="mono", steps=200)
    scores = []
    for k in range(0, 200, 25):
        first, second = (extract_features(log.images[i].image) for i in (k, k + 2))
        matches = match_features(first, second, seed=0)
        rng = np.random.default_rng(k)
        one, two = matches.first, matches.second.copy()
        wrong = rng.permutation(len(one))[: round(0.3 * len(one))]
        two[wrong] = second.xy[rng.integers(0, len(second.xy), wrong.size)]
        answer = verify_matches(one, two, seed=k, K=log.problem.sensor.K)
        error = np.linalg.norm(two - log.images.true_pixels(k, k + 2, one), axis=1)
        # A corner where a near surface hides a far one belongs to neither: it has no true partner.
        known = np.isfinite(error)
        scores.append(precision_recall(answer.inliers[known], error[known] < 3.0))
    precision, recall = np.array(scores).T
    assert precision.mean() >= 0.96
    assert recall.mean() >= 0.97
