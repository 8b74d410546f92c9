"""Lens distortion and stereo rectification, by OpenCV, as a look-up that straightens each image.

The lens is Brown's: radial k1, k2, k3 and tangential p1, p2, in OpenCV's order (k1, k2, p1, p2, k3). The
new image shows only what the camera saw: it is cropped to where every pixel has a source.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.geometry import inverse
from slamcmp.types import FloatArray

Size = tuple[int, int]


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with distortion."""

    K: FloatArray
    """(3, 3) [px]."""
    distortion: FloatArray
    """(k1, k2, p1, p2) or (k1, k2, p1, p2, k3)."""


@dataclass(frozen=True)
class Remap:
    """Where each pixel of the new image comes from."""

    x: NDArray[np.float32]
    y: NDArray[np.float32]

    def apply(self, image: NDArray[Any], *, nearest: bool = False) -> NDArray[Any]:
        """The straightened image; 0 where the old one ended. ``nearest`` takes values without mixing them."""
        import cv2

        way = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        straight: NDArray[Any] = cv2.remap(image, self.x, self.y, way)
        return straight


@dataclass(frozen=True)
class RectifiedPair:
    """A stereo pair whose rows are epipolar lines."""

    K: FloatArray
    """Of both new images, (3, 3)."""
    baseline_m: float
    R_left_new: FloatArray
    """(3, 3): turns vectors of the new left camera's frame into the old one's."""
    left: Remap
    right: Remap


def undistort(lens: Lens, size: Size) -> tuple[FloatArray, Remap | None]:
    """The calibration matrix without distortion and the look-up to it; without distortion both stay."""
    if not lens.distortion.any():
        return lens.K, None
    import cv2

    K, _ = cv2.getOptimalNewCameraMatrix(lens.K, lens.distortion, size, 0.0)
    return np.asarray(K), _remap(lens, np.eye(3), np.asarray(K), size)


def refocus(K_old: FloatArray, K_new: FloatArray, size: Size) -> Remap:
    """The look-up from a pinhole's image to that of another pinhole at the same place, both of ``size``."""
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    x = (u - K_new[0, 2]) * K_old[0, 0] / K_new[0, 0] + K_old[0, 2]
    y = (v - K_new[1, 2]) * K_old[1, 1] / K_new[1, 1] + K_old[1, 2]
    return Remap(x.astype(np.float32), y.astype(np.float32))


def rectify(left: Lens, right: Lens, T_right_left: FloatArray, size: Size, *, source: str) -> RectifiedPair:
    """Turn both cameras so that a point stands on the same row in both (Bouguet's method).

    ``T_right_left`` (4, 4) maps points of the left camera's frame to the right one's; ``source`` names its
    file.

    Raises:
        DataError: the right camera does not stand to the right of the left one.
    """
    import cv2

    x, y, z = inverse(T_right_left)[:3, 3]
    if not x > np.hypot(y, z):
        raise DataError(
            f"{source}: the right camera stands at ({x:.3g}, {y:.3g}, {z:.3g}) m in the left one's frame (x "
            "right, y down, z forward); it must stand to the right"
        )

    R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
        left.K,
        left.distortion,
        right.K,
        right.distortion,
        size,
        np.ascontiguousarray(T_right_left[:3, :3]),
        np.ascontiguousarray(T_right_left[:3, 3:]),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0.0,
    )
    K = np.asarray(P_left)[:, :3]
    return RectifiedPair(
        K,
        float(-P_right[0, 3] / P_right[0, 0]),
        np.asarray(R_left).T,
        _remap(left, R_left, K, size),
        _remap(right, R_right, np.asarray(P_right)[:, :3], size),
    )


def _remap(lens: Lens, R: FloatArray, K: FloatArray, size: Size) -> Remap:
    import cv2

    x, y = cv2.initUndistortRectifyMap(lens.K, lens.distortion, R, K, size, cv2.CV_32FC1)
    return Remap(x, y)
