"""Delayed initialisation on exact point tracks without images: closed forms and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.frontend.vision.geometry.triangulation import PoseHistory, parallax_deg, triangulate
from slamcmp.frontend.vision.tracking.placing import place_rays
from slamcmp.frontend.vision.tracking.track_table import VIEWS, TrackTable
from slamcmp.geometry import exp, inverse, local
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera

MOUNTING = FORWARD_CAMERA.copy()
MOUNTING[:3, 3] = 0.2, 0.0, 0.6
CAMERA = MonoCamera(fx_px=400, fy_px=420, cx_px=320, cy_px=240, T_body_camera=MOUNTING)
STEP = exp(np.array([0.0, 0.0, 0.03, 0.1, 0.0, 0.0]))
Q = np.diag([3e-4, 3e-4, 2e-3, 4e-3, 4e-3, 5e-4]) ** 2
POINT = np.array([4.0, 0.8, 1.0])
"""In the present body frame."""


def history_of(views: int, covariance: np.ndarray) -> PoseHistory:
    history = PoseHistory(20)
    history.advance(np.eye(4), np.zeros((6, 6)))
    for _ in range(views - 1):
        history.advance(STEP, covariance)
    return history


def views_of(point: np.ndarray, views: int, noise: np.ndarray | None = None) -> np.ndarray:
    """Pixels (m, views, 2), oldest first; ``noise`` (views - 1, m, 6): what odometry missed, latest first."""
    count = 1 if noise is None else noise.shape[1]
    pixels = np.empty((count, views, 2))
    T_view = np.tile(np.eye(4), (count, 1, 1))
    for back in range(views):
        pixels[:, views - 1 - back] = CAMERA.predict(inverse(T_view), np.tile(point, (count, 1)))
        if back < views - 1:
            missed = np.zeros((count, 6)) if noise is None else noise[back]
            # T_view maps the present body frame to the view's: an older increment stands on the left.
            T_view = STEP @ exp(missed) @ T_view
    return pixels


def test_history_holds_relative_poses_and_the_growing_covariance() -> None:
    history = history_of(4, Q)
    np.testing.assert_allclose(history.T_view[3], STEP @ STEP @ STEP, atol=1e-14)
    np.testing.assert_array_equal(history.S[0], 0.0)
    np.testing.assert_allclose(history.S[1], Q, atol=1e-18)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((3, 20000, 6)) * np.sqrt(np.diag(Q))
    true = STEP @ exp(noise[2]) @ STEP @ exp(noise[1]) @ STEP @ exp(noise[0])
    sampled = np.cov(local(history.T_view[3], true).T)
    # 20 000 samples: a variance is known to 1 %; four of them, against the largest of its row and column.
    scale = np.sqrt(np.outer(np.diag(history.S[3]), np.diag(history.S[3])))
    assert np.abs((sampled - history.S[3]) / scale).max() < 0.04


def test_exact_views_give_the_exact_point() -> None:
    pixels = views_of(POINT, 6)
    back = np.arange(5, -1, -1)[None]
    found = triangulate(CAMERA, history_of(6, Q), pixels, back, np.ones((1, 6), dtype=bool), sigma_px=0.5)
    exact = CAMERA.entry_sensor.predict(np.eye(4), POINT)
    np.testing.assert_allclose(found.z[0], exact, atol=1e-8)
    np.testing.assert_allclose(CAMERA.entry_sensor.invert(np.eye(4), found.z)[0], POINT, atol=1e-8)
    assert found.misfit[0] < 1e-12
    assert found.dof[0] == 9


@pytest.mark.parametrize("missing", [None, 2])
def test_covariance_and_misfit_agree_with_monte_carlo(missing: int | None) -> None:
    rng = np.random.default_rng(1)
    count, views = 4000, 6
    noise = rng.standard_normal((views - 1, count, 6)) * np.sqrt(np.diag(Q))
    pixels = views_of(POINT, views, noise) + 0.5 * rng.standard_normal((count, views, 2))
    used = np.ones((count, views), dtype=bool)
    if missing is not None:
        used[:, missing] = False
        pixels[:, missing] = 0.0
    back = np.tile(np.arange(views - 1, -1, -1), (count, 1))
    found = triangulate(CAMERA, history_of(views, Q), pixels, back, used, sigma_px=0.5)
    error = found.z - CAMERA.entry_sensor.predict(np.eye(4), POINT)
    nees = np.einsum("mi,mij,mj->m", error, np.linalg.inv(found.R), error)
    # Means of 4000 chi-square values: deviations of sqrt(2 n / 4000), four of them, and 2 % for curvature.
    assert nees.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / count) + 0.06)
    dof = 2 * used[0].sum() - 3
    assert found.misfit.mean() == pytest.approx(dof, abs=4 * np.sqrt(2 * dof / count) + 0.02 * dof)
    assert error.mean(axis=0) == pytest.approx(np.zeros(3), abs=4 * np.sqrt(171 / count))


def test_two_views_without_odometry_noise_have_the_textbook_depth_error() -> None:
    """A sideways baseline b is a stereo pair: the disparity f b / Z is known to √2 sigma."""
    sideways = np.eye(4)
    sideways[1, 3] = -0.5
    history = PoseHistory(5)
    history.advance(np.eye(4), np.zeros((6, 6)))
    history.advance(sideways, np.zeros((6, 6)))
    here = CAMERA.predict(np.eye(4), POINT)
    there = CAMERA.predict(inverse(sideways), POINT)
    found = triangulate(
        CAMERA,
        history,
        np.stack([there, here])[None],
        np.array([[1, 0]]),
        np.ones((1, 2), dtype=bool),
        sigma_px=0.5,
    )
    along = np.array([1.0, -1.0, 0.0])
    # The entry sensor's pair has 1 m of baseline: its disparity is twice as large.
    assert along @ found.R[0] @ along == pytest.approx(2 * 0.5**2 * 2**2, rel=1e-6)


def test_parallax_is_the_angle_at_the_point_and_nothing_for_a_rotation() -> None:
    history = history_of(6, Q)
    pixels = views_of(POINT, 6)
    angle = parallax_deg(CAMERA, history, pixels[:, 5], pixels[:, 0], np.array([5]))[0]
    centres = [(T @ MOUNTING)[:3, 3] for T in (np.eye(4), inverse(history.T_view[5]))]
    a, b = (POINT - centre for centre in centres)
    expected = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    assert angle == pytest.approx(expected, abs=1e-6)
    turned = PoseHistory(3)
    turned.advance(np.eye(4), Q)
    # A turn about the camera's own centre.
    turn = MOUNTING @ exp(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0])) @ inverse(MOUNTING)
    turned.advance(turn, Q)
    then = CAMERA.predict(inverse(turn), POINT)[None]
    now = CAMERA.predict(np.eye(4), POINT)[None]
    assert parallax_deg(CAMERA, turned, now, then, np.array([1]))[0] == pytest.approx(0.0, abs=1e-5)


def table_of(pixels: np.ndarray) -> TrackTable:
    """Rays seen in every one of the last views, (m, views, 2)."""
    tracks = TrackTable.empty()
    rows = tracks.add(np.zeros((len(pixels), 32), np.uint8), pixels[:, 0])
    for view in range(1, pixels.shape[1]):
        tracks.view_back[tracks.view_back >= 0] += 1
        tracks.see(rows, np.zeros((len(pixels), 32), np.uint8), pixels[:, view])
    return tracks


def test_a_ray_is_placed_when_it_is_due_and_not_before() -> None:
    far = np.array([60.0, 3.0, 2.0])
    spoilt = views_of(POINT, 6)
    spoilt[0, 2] += [0.0, 9.0]
    pixels = np.concatenate([views_of(POINT, 6), views_of(far, 6), spoilt])
    tracks = table_of(pixels)
    placed = place_rays(
        tracks,
        np.arange(3),
        CAMERA,
        history_of(6, 0.01 * Q),
        sigma_px=0.5,
        parallax_min_deg=1.0,
        depth_min_m=0.3,
        gate_probability=0.999,
    )
    np.testing.assert_array_equal(placed.rows, [0])
    np.testing.assert_array_equal(placed.contradicted, [2])
    np.testing.assert_allclose(tracks.q[0], POINT, atol=1e-6)
    np.testing.assert_array_equal(tracks.placed, [True, False, False])


def placed_of(pixels: np.ndarray, history: PoseHistory, **settings: float) -> tuple[np.ndarray, TrackTable]:
    """Rows that are placed, with settings that place POINT unless they are changed."""
    tracks = table_of(pixels)
    usual = {"sigma_px": 0.5, "parallax_min_deg": 1.0, "depth_min_m": 0.3, "gate_probability": 0.999}
    placed = place_rays(tracks, np.arange(len(pixels)), CAMERA, history, **(usual | settings))
    return placed.rows, tracks


def test_each_condition_of_placing_holds_by_itself() -> None:
    pixels, history = views_of(POINT, 6), history_of(6, 0.01 * Q)
    assert placed_of(pixels, history)[0].size == 1
    angle = parallax_deg(CAMERA, history, pixels[:, 5], pixels[:, 0], np.array([5]))[0]
    assert placed_of(pixels, history, parallax_min_deg=angle - 0.01)[0].size == 1
    assert placed_of(pixels, history, parallax_min_deg=angle + 0.01)[0].size == 0
    depth = CAMERA.camera_point(np.eye(4), POINT)[2]
    assert placed_of(pixels, history, depth_min_m=depth - 0.01)[0].size == 1
    assert placed_of(pixels, history, depth_min_m=depth + 0.01)[0].size == 0
    # 12 % of the inverse depth: the deviation grows with the pixel's.
    along = np.array([1.0, -1.0, 0.0])
    back, used = np.arange(5, -1, -1)[None], np.ones((1, 6), dtype=bool)
    exact = history_of(6, 1e-12 * Q)
    found = triangulate(CAMERA, exact, pixels, back, used, sigma_px=1.0)
    share = np.sqrt(along @ found.R[0] @ along) / (along @ found.z[0])
    assert placed_of(pixels, exact, sigma_px=0.11 / share)[0].size == 1
    assert placed_of(pixels, exact, sigma_px=0.13 / share)[0].size == 0
    # Two views, far apart: nothing tests the point.
    sideways = np.eye(4)
    sideways[1, 3] = -0.5
    wide = PoseHistory(5)
    for T in (np.eye(4), sideways, sideways):
        wide.advance(T, np.zeros((6, 6)))
    shown = [CAMERA.predict(inverse(T), POINT) for T in (sideways @ sideways, sideways, np.eye(4))]
    assert placed_of(np.array(shown)[None], wide)[0].size == 1
    assert placed_of(np.array(shown)[None, 1:], wide)[0].size == 0


def test_a_point_behind_any_of_its_views_is_not_placed() -> None:
    """The lines of sight meet exactly, but one of them behind its camera."""
    backwards = np.eye(4)
    backwards[:2, 3] = -1.5, 0.4
    history = PoseHistory(5)
    for T in (np.eye(4), backwards, backwards):
        history.advance(T, 1e-12 * Q)
    back, used = np.array([[2, 1, 0]]), np.ones((1, 3), dtype=bool)

    def image_of(point: np.ndarray) -> np.ndarray:
        q = np.array([CAMERA.camera_point(T, point) for T in history.T_view[[2, 1, 0]]])
        return q[:, :2] / q[:, 2:] * [CAMERA.fx_px, CAMERA.fy_px] + [CAMERA.cx_px, CAMERA.cy_px]

    # In the frame of each view, (history maps the present frame into it): x decreases with age.
    for point, expected in (([6.0, 0.3, 0.8], True), ([2.0, 0.3, 0.8], False), ([-3.0, 0.3, 0.8], False)):
        views = [np.linalg.inv(T) for T in history.T_view[[2, 1, 0]]]
        q = np.array([CAMERA.camera_point(T, np.array(point)) for T in views])
        pixels = q[:, :2] / q[:, 2:] * [CAMERA.fx_px, CAMERA.fy_px] + [CAMERA.cx_px, CAMERA.cy_px]
        found = triangulate(CAMERA, history, pixels[None], back, used, sigma_px=0.5)
        assert found.misfit[0] < 1e-6
        assert bool(found.in_front[0]) is expected
        assert placed_of(pixels[None], history)[0].size == int(expected)


def test_entries_bound_the_error_that_ten_points_share() -> None:
    """J Q J^T over n points with one common error is at most n times its diagonal blocks."""
    pixels = views_of(POINT, 6)
    history, back = history_of(6, 0.01 * Q), np.arange(5, -1, -1)[None]
    each = triangulate(CAMERA, history, pixels, back, np.ones((1, 6), dtype=bool), sigma_px=0.5).R[0]
    placed = place_rays(
        table_of(pixels),
        np.arange(1),
        CAMERA,
        history,
        sigma_px=0.5,
        parallax_min_deg=1.0,
        depth_min_m=0.3,
        gate_probability=0.999,
    )
    along = np.array([1.0, -1.0, 0.0])
    assert along @ placed.R[0] @ along == pytest.approx(10 * along @ each @ along)
    # Two thirds of what this pixel and the corner's later ones tell together.
    np.testing.assert_allclose(placed.R[0][np.ix_([0, 2], [0, 2])], 1.5 * each[np.ix_([0, 2], [0, 2])])


def test_a_track_remembers_its_first_view_and_the_latest() -> None:
    pixels = np.arange(24.0).reshape(1, 12, 2)
    tracks = table_of(pixels)
    np.testing.assert_array_equal(tracks.view_pixel[0], pixels[0, [0, *range(12 - VIEWS + 1, 12)]])
    np.testing.assert_array_equal(tracks.view_back[0], [11, *range(VIEWS - 2, -1, -1)])
