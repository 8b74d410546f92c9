"""Straightening images: each new pixel's source against Brown's formula written out here."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.datasets.images.rectification import Lens, rectify, undistort
from slamcmp.errors import DataError
from slamcmp.geometry import exp, inverse, transform

SIZE = (320, 240)
LEFT = Lens(np.array([[210.0, 0, 155.0], [0, 208.0, 122.0], [0, 0, 1]]), np.array([-0.28, 0.07, 2e-4, -3e-4]))
RIGHT = Lens(
    np.array([[205.0, 0, 162.0], [0, 206.0, 118.0], [0, 0, 1]]), np.array([-0.25, 0.05, -1e-4, 4e-4, 0.01])
)
T_LEFT_RIGHT = exp(np.array([0.02, -0.03, 0.01, 0.11, 0.004, -0.003]))


def brown(lens: Lens, points: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of points (..., 3) in the camera's frame, with distortion (Brown 1966)."""
    k1, k2, p1, p2, k3 = [*lens.distortion, 0.0][:5]
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([lens.K[0, 0] * u + lens.K[0, 2], lens.K[1, 1] * v + lens.K[1, 2]], axis=-1)


def _rays(K: np.ndarray) -> np.ndarray:
    """Directions (height, width, 3) of every pixel of a pinhole camera."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)


@pytest.mark.parametrize("lens", [LEFT, RIGHT])
def test_undistorted_pixels_come_from_where_the_lens_put_them(lens: Lens) -> None:
    K, remap = undistort(lens, SIZE)
    assert remap is not None
    expected = brown(lens, _rays(K))
    np.testing.assert_allclose(np.stack([remap.x, remap.y], axis=-1), expected, atol=1e-3)
    # Cropped to what the camera saw.
    assert expected.min() > -1
    assert (expected < np.array(SIZE)).all()


def test_without_distortion_nothing_changes() -> None:
    K, remap = undistort(Lens(LEFT.K, np.zeros(4)), SIZE)
    assert remap is None
    np.testing.assert_array_equal(K, LEFT.K)


def test_both_rectified_images_show_the_scene_as_one_stereo_camera_would() -> None:
    """The rotations, the baseline and which side is which: pixels of both new images traced to the old."""
    pair = rectify(LEFT, RIGHT, inverse(T_LEFT_RIGHT), SIZE, source="")
    assert pair.baseline_m == pytest.approx(np.linalg.norm(T_LEFT_RIGHT[:3, 3]), rel=1e-9)
    depth = 3.0
    in_new_left = depth * _rays(pair.K)
    in_left = in_new_left @ pair.R_left_new.T
    expected = brown(LEFT, in_left)
    np.testing.assert_allclose(np.stack([pair.left.x, pair.left.y], axis=-1), expected, atol=1e-3)
    # The new right camera stands a baseline along the new x axis and looks the same way.
    in_left = (in_new_left + np.array([pair.baseline_m, 0, 0])) @ pair.R_left_new.T
    expected = brown(RIGHT, transform(inverse(T_LEFT_RIGHT), in_left))
    np.testing.assert_allclose(np.stack([pair.right.x, pair.right.y], axis=-1), expected, atol=1e-3)


def test_nearest_values_are_not_mixed() -> None:
    _, remap = undistort(LEFT, SIZE)
    assert remap is not None
    stripes = np.tile(np.where(np.arange(SIZE[0]) % 7 < 3, 1.0, 9.0).astype(np.float32), (SIZE[1], 1))
    assert set(np.unique(remap.apply(stripes, nearest=True))) <= {1.0, 9.0}
    assert len(np.unique(remap.apply(stripes))) > 100


@pytest.mark.parametrize("place", [[0.0, 0.0, 0.0], [-0.11, 0.0, 0.0], [0.01, 0.11, 0.0]])
def test_a_right_camera_that_is_not_on_the_right(place: list[float]) -> None:
    T_left_right = np.eye(4)
    T_left_right[:3, 3] = place
    with pytest.raises(DataError, match=r"mine\.yaml: the right camera stands at .* must stand to the right"):
        rectify(LEFT, RIGHT, inverse(T_left_right), SIZE, source="mine.yaml")
