"""The parts that follow points: filters, windows, common motion, depth; against second ways to the same."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.geometry.triangulation import PoseHistory
from slamcmp.frontend.vision.tracking.common_motion import common_motion
from slamcmp.frontend.vision.tracking.measuring import Noise, measuring, patch_depths
from slamcmp.frontend.vision.tracking.search_windows import search_windows
from slamcmp.frontend.vision.tracking.stereo_matching import align_rows
from slamcmp.frontend.vision.tracking.track_table import TrackTable
from slamcmp.frontend.vision.wrong_matches import MatchRecord, score_matches, spoil_matches
from slamcmp.geometry import exp
from slamcmp.models.camera import MonoCamera, RgbdCamera, StereoCamera
from slamcmp.models.sensors import body_point_jacobians
from slamcmp.types import CameraFrame

INTRINSICS = {"fx_px": 300.0, "fy_px": 310.0, "cx_px": 159.5, "cy_px": 119.5}
PAIR = StereoCamera(**INTRINSICS, baseline_m=0.2)
SINGLE = MonoCamera(**INTRINSICS)
R_PAIR = np.array([[0.25, 0.25, 0.0], [0.25, 0.29, 0.0], [0.0, 0.0, 0.25]])
STEP = exp(np.array([0.01, -0.02, 0.05, 0.2, 0.01, 0.0]))
Q = np.diag([1e-3, 1e-3, 4e-3, 5e-3, 5e-3, 1e-3]) ** 2


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([2.0, -0.8, -0.5], [6.0, 0.8, 0.5], (count, 3))


def placed_table(where: np.ndarray) -> TrackTable:
    tracks = TrackTable.empty()
    z = PAIR.predict(np.eye(4), where)
    rows = tracks.add(np.zeros((len(z), 32), np.uint8), z[:, [0, 2]])
    tracks.place(rows, PAIR, z, np.tile(R_PAIR, (len(z), 1, 1)))
    return tracks


def test_each_row_is_an_extended_kalman_filter_of_its_own() -> None:
    """Against the textbook's form, one landmark at a time, the covariance as P - K S K'."""
    where, count = points(7), 7
    tracks = placed_table(where)
    R = np.tile(R_PAIR, (count, 1, 1))
    rng = np.random.default_rng(1)
    moved, means, covariances = where, tracks.q.copy(), tracks.C.copy()
    back = np.linalg.inv(STEP)
    for _ in range(3):
        tracks.move(STEP, Q)
        moved = (moved - STEP[:3, 3]) @ STEP[:3, :3]
        z = PAIR.predict(np.eye(4), moved) + 0.3 * rng.standard_normal((count, 3))
        tracks.correct(np.arange(count), PAIR, z, R)
        for i in range(count):
            q = back[:3, :3] @ means[i] + back[:3, 3]
            J, _ = body_point_jacobians(np.eye(4), q)
            C = back[:3, :3] @ covariances[i] @ back[:3, :3].T + J @ Q @ J.T
            expected, _, H = PAIR.linearise(np.eye(4), q)
            S = H @ C @ H.T + R_PAIR
            K = C @ H.T @ np.linalg.inv(S)
            means[i], covariances[i] = q + K @ (z[i] - expected), C - K @ S @ K.T
    np.testing.assert_allclose(tracks.q, means, atol=1e-11)
    np.testing.assert_allclose(tracks.C, covariances, atol=1e-12)


def test_correcting_the_motion_is_as_if_it_had_been_known() -> None:
    where = points(5)
    xi, left = np.array([0.002, -0.001, 0.004, 0.01, -0.02, 0.003]), 0.01 * Q
    late, known = placed_table(where), placed_table(where)
    late.move(STEP, Q)
    late.correct_motion(xi, Q, left)
    known.move(STEP @ exp(xi), left)
    np.testing.assert_allclose(late.q, known.q, atol=1e-12)
    np.testing.assert_allclose(late.C, known.C, atol=1e-12)


def test_common_motion_is_the_linear_estimate_and_survives_wrong_matches() -> None:
    rng = np.random.default_rng(2)
    expected, H, _ = PAIR.linearise(np.eye(4), points(120, 3))
    assert np.isfinite(expected).all()
    xi = np.array([1e-3, -1e-3, 6e-3, 4e-3, 6e-3, -1e-3])
    S = np.tile(R_PAIR, (120, 1, 1))
    y = H @ xi
    exact, covariance = common_motion(y, S, H, 1e6 * np.eye(6))
    np.testing.assert_allclose(exact, xi, atol=1e-9)
    # Without residuals all weights are 1: the covariance is that of least squares.
    information = (np.swapaxes(H, 1, 2) @ np.linalg.solve(S, H)).sum(axis=0)
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-5)
    y = y + rng.standard_normal((120, 3)) @ np.linalg.cholesky(R_PAIR).T
    y[:40] += rng.uniform(-30, 30, (40, 3))
    found, covariance = common_motion(y, S, H, Q)
    error = found - xi
    # A third is wrong; what is left must be within four deviations of six numbers (chi-square 0.9999: 27.9).
    assert error @ np.linalg.solve(covariance, error) < 27.9
    planar = np.diag([0.0, 0.0, 1e-4, 1e-4, 1e-4, 0.0])
    found, covariance = common_motion(y, S, H, planar)
    np.testing.assert_allclose(found[[0, 1, 5]], 0.0, atol=1e-13)
    np.testing.assert_allclose(covariance[[0, 1, 5]], 0.0, atol=1e-13)


def test_windows_contain_what_the_exact_distance_says() -> None:
    tracks = placed_table(points(30))
    tracks.add(np.zeros((20, 32), np.uint8), np.random.default_rng(4).uniform([40, 40], [280, 200], (20, 2)))
    history = PoseHistory(5)
    history.advance(np.eye(4), np.zeros((6, 6)))
    history.advance(STEP, Q)
    tracks.move(STEP, Q)
    windows = search_windows(
        tracks, SINGLE, history, (320, 240), sigma_px=0.5, depth_min_m=0.5, widest_px=25.0
    )
    pixels = np.random.default_rng(5).uniform([0, 0], [319, 239], (400, 2))
    exact = []
    for row, (start, along) in enumerate(zip(windows.start, windows.along, strict=True)):
        L = np.linalg.cholesky(windows.covariance[row])
        off, line = np.linalg.solve(L, (pixels - start).T).T, np.linalg.solve(L, along)
        share = np.clip(off @ line / max(line @ line, 1e-12), 0.0, 1.0)
        squared = ((off - share[:, None] * line) ** 2).sum(axis=1)
        every = np.full(len(pixels), row)
        np.testing.assert_allclose(windows.distances(every, pixels), squared, rtol=1e-9, atol=1e-9)
        exact += [(row, pixel) for pixel in np.flatnonzero(squared <= 30.0).tolist()]
    which, pixel = windows.near(pixels, 30.0)
    assert list(zip(which.tolist(), pixel.tolist(), strict=True)) == exact
    assert len(exact) > 100


def test_a_ray_is_looked_for_from_infinity_to_the_smallest_depth() -> None:
    tracks = TrackTable.empty()
    pixel = np.array([[100.0, 90.0]])
    tracks.add(np.zeros((1, 32), np.uint8), pixel)
    history = PoseHistory(5)
    history.advance(np.eye(4), np.zeros((6, 6)))
    history.advance(STEP, Q)
    tracks.move(STEP, Q)
    # Four steps away, their doubt included, is as near as anything is looked for.
    four_steps = 4.0 * (np.linalg.norm(STEP[:3, 3]) + 5e-3)
    for depth_min, nearest in ((1.0, 1.0), (0.5, four_steps)):
        windows = search_windows(
            tracks, SINGLE, history, (320, 240), sigma_px=0.5, depth_min_m=depth_min, widest_px=50.0
        )
        seen = [
            SINGLE.predict(STEP, SINGLE.point_at_depth(np.eye(4), pixel, np.array([depth])))
            for depth in (1e9, 5.0, 1.2, nearest)
        ]
        np.testing.assert_allclose(windows.start, seen[0], atol=1e-5)
        np.testing.assert_allclose(windows.start + windows.along, seen[3], atol=1e-9)
        # All depths in between lie on the segment.
        for place in seen:
            assert windows.distances(np.array([0]), place)[0] < 1e-9


def test_aligned_patches_tell_the_disparity_of_a_slanting_surface() -> None:
    rng = np.random.default_rng(6)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (240, 400)).astype(np.float32), (0, 0), 1.6)
    texture = (texture - texture.mean()) * 4 + 128
    v, u = np.mgrid[0:240, 0:320].astype(np.float32)
    # Right column of what the left image shows at (u, v): u - d, d = 20.3 + 0.1 (v - 120).
    left = cv2.remap(texture, u + 40, v, cv2.INTER_CUBIC)
    right = cv2.remap(texture, u + 40 + 20.3 + 0.1 * (v - 120), v, cv2.INTER_CUBIC)
    left, right = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (left, 0.9 * right + 5))
    xy = rng.uniform([60, 60], [300, 180], (150, 2))
    true = 20.3 + 0.1 * (np.rint(xy[:, 1]) - 120)
    found = align_rows(left, right, xy, true + rng.uniform(-1.2, 1.2, 150))
    good = np.isfinite(found)
    assert good.mean() > 0.9
    assert np.abs(found - true)[good].std() < 0.05
    assert np.median(np.abs(found - true)[good]) < 0.05
    # A patch at the border has no alignment, and neither has another texture.
    assert np.isnan(align_rows(left, right, np.array([[3.0, 100.0]]), np.array([2.0])))[0]
    assert np.isnan(align_rows(left, right[::-1].copy(), xy, true)).mean() > 0.8


def test_patch_depths_are_medians_where_one_surface_is_known() -> None:
    depth = np.full((40, 40), 2.0, np.float32)
    depth[:, 20:] = 3.0
    depth[:12] = 0.0
    depth[30, 5] = 50.0
    found = patch_depths(depth, np.array([[5.0, 30.0], [19.6, 30.0], [8.0, 12.0], [30.0, 25.0], [0.0, 39.0]]))
    np.testing.assert_array_equal(found, [2.0, np.nan, 2.0, 3.0, 2.0])
    assert np.isnan(patch_depths(depth, np.array([[8.0, 10.0]])))[0]


def test_a_depth_becomes_the_disparity_of_a_virtual_pair() -> None:
    camera = RgbdCamera(**INTRINSICS)
    sensor, measure = measuring(camera, Noise(0.5, 0.2, 0.002), features=50, depth_min_m=0.3)
    assert isinstance(sensor, StereoCamera)

    class At:
        xy = np.array([[100.0, 80.0], [200.0, 100.0]])
        factor = None

    depth = np.zeros((240, 320), np.float32)
    depth[:, :150] = 4.0
    measured = measure(CameraFrame(np.zeros((240, 320), np.uint8), None, depth), At())  # type: ignore[arg-type]
    np.testing.assert_array_equal(measured.valid, [True, False])
    point = camera.invert(np.eye(4), np.array([100.0, 80.0, 4.0]))
    np.testing.assert_allclose(measured.z[0], sensor.predict(np.eye(4), point), atol=1e-5)
    # (u, u - d, v) of corner and disparity, whose errors know nothing of one another.
    J = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    disparity_sigma = sensor.fx_px * sensor.baseline_m * 0.002
    np.testing.assert_allclose(measured.R[0], J @ np.diag([0.25, disparity_sigma**2, 0.25]) @ J.T, rtol=1e-12)
    # Back to depth: sigma is 0.002 · 4², and the corner's error is that of both columns.
    _, H = sensor.jacobians(np.eye(4), point)
    in_space = np.linalg.inv(H) @ measured.R[0] @ np.linalg.inv(H).T
    assert np.sqrt(in_space[0, 0]) == pytest.approx(0.002 * 16, rel=1e-6)


def test_spoilt_matches_are_as_many_as_asked_and_all_wrong() -> None:
    chosen = np.arange(100)
    spoilt = spoil_matches(chosen, 150, 0.3, np.random.default_rng(0))
    assert (spoilt != chosen).sum() == 30
    assert spoilt.min() >= 0
    assert spoilt.max() < 150


def test_scores_of_a_hand_made_record() -> None:
    class Shifted:
        def true_pixels(self, k: int, j: int, pixels: np.ndarray) -> np.ndarray:
            return np.where(pixels[:, :1] < 100, pixels + 10.0 * (j - k), np.nan)

    before = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0], [500.0, 1.0]])
    now = before + 10.0 * np.array([[1], [1], [2], [1], [1]])
    now[3] += 5.0
    record = MatchRecord(
        7,
        np.array([1, 1, 2, 1, 1]),
        before,
        now,
        np.array([True, True, True, True, True]),
        np.array([True, False, True, True, True]),
    )
    scores = score_matches([record], Shifted())
    assert (scores.matches, scores.correct) == (4, 3)
    assert scores.precision == {"matched": 0.75, "epipolar": 0.75, "passed": pytest.approx(2 / 3)}
    assert scores.recall == {"matched": 1.0, "epipolar": 1.0, "passed": pytest.approx(2 / 3)}


def test_distances_of_rows_and_of_none() -> None:
    tracks = placed_table(np.array([[4.0, 0.5, 0.2], [6.0, -1.0, 0.1], [5.0, 0.0, 0.0]]))
    rows = np.array([0, 2])
    expected, S = tracks.predicted(rows, PAIR)
    off = np.array([[0.5, -0.2, 0.3], [1.0, 0.4, -0.6]])
    R = np.tile(np.diag([0.25, 0.25, 0.5]), (2, 1, 1))
    by_hand = [y @ np.linalg.inv(each + r) @ y for y, each, r in zip(off, S, R, strict=True)]
    np.testing.assert_allclose(tracks.distances(rows, PAIR, expected + off, R), by_hand, rtol=1e-9)
    nothing = np.empty(0, np.int64), PAIR, np.empty((0, 3)), np.empty((0, 3, 3))
    assert tracks.distances(*nothing).shape == (0,)
    assert tracks.correct(*nothing).shape == (0, 3)
