"""The Harris response against OpenCV's and by hand, and the corners taken from it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.features.harris import _quadric_peaks, harris_corners, harris_response
from tests.frontend.photographs import photograph


@pytest.mark.parametrize("window", [3, 5, 7])
@pytest.mark.parametrize("k", [0.04, 0.06])
def test_response_equals_opencvs(window: int, k: float) -> None:
    image = photograph(1).astype(np.float32)
    mine = harris_response(image, window=window, k=k)
    theirs = cv2.cornerHarris(image, window, 3, k)
    inner = np.s_[window:-window, window:-window]
    assert np.abs(mine - theirs)[inner].max() <= 1e-6 * np.abs(theirs).max()


def test_response_of_a_step_edge_by_hand() -> None:
    # A vertical step of height 1: Sobel gives I_x = 4/12 on the two columns beside it, I_y = 0. Where the
    # 3×3 window covers both columns, Σ I_x² = 6 (1/3)² = 2/3, so det = 0 and R = −k (2/3)².
    image = np.zeros((9, 12))
    image[:, 6:] = 1.0
    response = harris_response(image, k=0.04)
    np.testing.assert_allclose(response[4, 5:7], -0.04 * (2 / 3) ** 2, rtol=1e-13)
    np.testing.assert_allclose(response[:, [0, 1, 2, 9, 10, 11]], 0.0, atol=1e-15)


def test_an_even_window_is_refused() -> None:
    with pytest.raises(UsageError, match="odd"):
        harris_response(np.zeros((8, 8)), window=2)


def test_the_corners_of_bright_squares_are_found() -> None:
    image = np.zeros((120, 160), dtype=np.uint8)
    expected = []
    for x, y in ((30, 25), (90, 60), (50, 80)):
        image[y : y + 20, x : x + 24] = 200
        expected += [(x - 0.5 + dx, y - 0.5 + dy) for dx in (0, 24) for dy in (0, 20)]
    corners = harris_corners(image)
    assert len(corners.xy) == 12
    distance = np.linalg.norm(corners.xy[:, None] - np.array(expected)[None], axis=-1).min(axis=1)
    # The peak of a summed window lies a little inside of the corner.
    assert distance.max() < 1.5


def test_corners_come_strongest_first_and_are_local_maxima_above_the_threshold() -> None:
    image = photograph(2)
    corners = harris_corners(image, quality=0.01, count_max=10**6, subpixel=False)
    response = cv2.cornerHarris(image, 3, 3, 0.04)
    assert (np.diff(corners.response) <= 0).all()
    assert corners.response.min() > 0.01 * response.max()
    for x, y in corners.xy.astype(int)[::50]:
        assert response[y, x] == response[y - 1 : y + 2, x - 1 : x + 2].max()
    brute = 0
    for y, x in np.argwhere(response > 0.01 * response.max()):
        patch = response[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        brute += response[y, x] == patch.max()
    assert corners.found == brute == len(corners.xy) + corners.at_border


def test_border_drops_are_counted() -> None:
    image = photograph(2)
    everywhere = harris_corners(image, count_max=10**6)
    inner = harris_corners(image, count_max=10**6, border_px=40)
    height, width = image.shape
    near = (
        (everywhere.xy < 39.5).any(axis=1)
        | (everywhere.xy[:, 0] > width - 40.5)
        | (everywhere.xy[:, 1] > height - 40.5)
    )
    # The quadric moves corners by up to half a pixel, so that a few change sides of the comparison above.
    assert abs(int(near.sum()) - (inner.at_border - everywhere.at_border)) <= 5
    assert inner.found == everywhere.found == len(inner.xy) + inner.at_border


def test_subpixel_corners_err_by_less_than_a_third_of_whole_pixels() -> None:
    # A smooth pattern moved by known fractions of a pixel: the corners should move by the same.
    rng = np.random.default_rng(3)
    large = cv2.GaussianBlur(rng.integers(0, 256, (480, 640)).astype(np.float32), (0, 0), 3.0)
    large = 30 + 195 * (large - large.min()) / np.ptp(large)
    errors = {True: [], False: []}
    before = {sub: _smooth_corners(large, subpixel=sub) for sub in (True, False)}
    for dx, dy in ((0.25, 0.4), (0.5, 0.1), (0.75, 0.6)):
        shift = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
        moved = cv2.warpAffine(
            large, shift, (640, 480), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101
        )
        for subpixel in (True, False):
            offset = _smooth_corners(moved, subpixel=subpixel)[None] - before[subpixel][:, None] - [dx, dy]
            errors[subpixel].append(np.median(np.linalg.norm(offset, axis=-1).min(axis=1)))
    assert 3 * max(errors[True]) < min(errors[False])


def test_the_peak_of_an_exact_quadric_is_found_exactly() -> None:
    """Also where its axes are turned against the pixels' (a twist)."""
    rng = np.random.default_rng(0)
    peaks = rng.uniform(-0.4, 0.4, (50, 2))
    rows, columns = np.full(50, 2), 2 + 5 * np.arange(50)
    response = np.zeros((5, 250), np.float32)
    y, x = np.mgrid[-2:3, -2:3]
    for i, (px, py) in enumerate(peaks):
        a, c = rng.uniform(0.5, 2.0, 2)
        b = rng.uniform(-0.9, 0.9) * np.sqrt(a * c)
        dx, dy = x - px, y - py
        response[:, 5 * i : 5 * i + 5] = 100.0 - a * dx**2 - 2 * b * dx * dy - c * dy**2
    np.testing.assert_allclose(_quadric_peaks(response, rows, columns), peaks, atol=1e-3)


def test_an_edge_has_no_corner_whatever_its_strength() -> None:
    """Harris's constant separates them: det / trace² of an edge is 0, of a right-angled corner about 1/4."""
    image = np.full((80, 120), 60, dtype=np.uint8)
    image[20:60, 30:90] = 200
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    response = cv2.cornerHarris(image, 3, 3, 0.04)
    corners = harris_corners(image, quality=0.01)
    assert len(corners.xy) == 4
    assert response[20, 60] < 0
    # k decides how round a corner must be: with 0.24 hardly any is.
    assert harris_corners(image, k=0.04).response[0] > 10 * max(
        harris_corners(image, k=0.2).response[:1], default=0.0
    )


def _smooth_corners(image: np.ndarray, *, subpixel: bool) -> np.ndarray:
    return harris_corners(image.astype(np.uint8), border_px=10, quality=0.05, subpixel=subpixel).xy


@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_flat_image_has_no_corners(level: int) -> None:
    corners = harris_corners(np.full((60, 80), level, dtype=np.uint8))
    assert corners.xy.shape == (0, 2)
    assert (corners.found, corners.at_border) == (0, 0)
