"""Lens distortion and stereo rectification, by OpenCV, as a look-up that straightens each image.

The lens is Brown's: radial k1, k2, k3 and tangential p1, p2, in OpenCV's order (k1, k2, p1, p2, k3), over
1 + k4 r² + k5 r⁴ + k6 r⁶ where these three follow (the rational model). The new image shows only what the
camera saw: it is cropped to where every pixel has a source.
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
    """(k1, k2, p1, p2), perhaps with k3 or with k3, k4, k5, k6; (k1, k2, k3, k4) of an equidistant lens."""
    equidistant: bool = False
    """A fisheye: the angle from the axis is mapped, not its tangent (Kannala and Brandt 2006)."""

    @property
    def distorts(self) -> bool:
        """Whether the image is not a pinhole's already: an equidistant one never is."""
        return self.equidistant or bool(self.distortion.any())

    def distorted_radius(self, r: FloatArray) -> FloatArray:
        """Where the radii r (m,) of a pinhole's image go, in focal lengths, by the radial part."""
        if self.equidistant:
            angle = np.arctan(r)
            k = self.distortion
            return np.asarray(angle * np.polyval([k[3], k[2], k[1], k[0], 1.0], angle**2))
        k1, k2 = self.distortion[:2]
        k3, k4, k5, k6 = [*self.distortion[4:8], 0.0, 0.0, 0.0, 0.0][:4]
        below = np.polyval([k6, k5, k4, 1.0], r**2)
        return np.asarray(r * np.polyval([k3, k2, k1, 1.0], r**2) / below)


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
    if not lens.distorts:
        return lens.K, None
    import cv2

    if lens.equidistant:
        wide = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            lens.K, lens.distortion, size, np.eye(3), balance=0.0
        )
        return np.asarray(wide), _remap(lens, np.eye(3), np.asarray(wide), size)
    K, _ = cv2.getOptimalNewCameraMatrix(lens.K, lens.distortion, size, 0.0)
    return np.asarray(K), _remap(lens, np.eye(3), np.asarray(K), size)


def require_no_fold(lens: Lens, size: Size, *, source: str) -> None:
    """Check that the lens model maps what the image holds one to one; ``source`` names its file.

    Raises:
        DataError: farther from the centre than some radius the image would come back over itself.
    """
    corners = np.array([[0, 0], [size[0] - 1, 0], [0, size[1] - 1], [size[0] - 1, size[1] - 1]], dtype=float)
    scaled = (corners - lens.K[:2, 2]) / np.diag(lens.K)[:2]
    corner = float(np.hypot(*scaled.T).max())
    # Up to 85 degrees from the axis; nothing that a pinhole can show lies farther out.
    radii = np.tan(np.linspace(0.0, np.radians(85.0), 3000))
    reached = lens.distorted_radius(radii)
    largest = np.maximum.accumulate(reached)
    falls = np.flatnonzero(np.diff(reached) <= 0)
    if falls.size and largest[falls[0]] < corner:
        focal = float(np.sqrt(lens.K[0, 0] * lens.K[1, 1]))
        raise DataError(
            f"{source}: the lens model folds the image {focal * largest[falls[0]]:.0f} px from its centre, "
            f"and the corner is {focal * corner:.0f} px away: the coefficients are not this lens's, or of "
            "another model"
        )


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

    if left.equidistant != right.equidistant:
        raise DataError(f"{source}: one lens is equidistant and the other is not")
    if left.equidistant:
        return _rectified_fisheyes(left, right, T_right_left, size)
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
    return _as_pair(left, right, (R_left, R_right), (P_left, P_right), size)


def _rectified_fisheyes(left: Lens, right: Lens, T_right_left: FloatArray, size: Size) -> RectifiedPair:
    import cv2

    R_left, R_right, P_left, P_right, _ = cv2.fisheye.stereoRectify(
        left.K,
        left.distortion,
        right.K,
        right.distortion,
        size,
        np.ascontiguousarray(T_right_left[:3, :3]),
        np.ascontiguousarray(T_right_left[:3, 3]),
        flags=cv2.CALIB_ZERO_DISPARITY,
        balance=0.0,
    )
    return _as_pair(left, right, (R_left, R_right), (P_left, P_right), size)


def _as_pair(
    left: Lens, right: Lens, turns: tuple[Any, Any], projections: tuple[Any, Any], size: Size
) -> RectifiedPair:
    (R_left, R_right), (P_left, P_right) = turns, (np.asarray(each) for each in projections)
    K = P_left[:, :3]
    return RectifiedPair(
        K,
        float(-P_right[0, 3] / P_right[0, 0]),
        np.asarray(R_left).T,
        _remap(left, R_left, K, size),
        _remap(right, R_right, P_right[:, :3], size),
    )


def _remap(lens: Lens, R: FloatArray, K: FloatArray, size: Size) -> Remap:
    import cv2

    if lens.equidistant:
        x, y = cv2.fisheye.initUndistortRectifyMap(lens.K, lens.distortion, R, K, size, cv2.CV_32FC1)
        return Remap(x, y)
    x, y = cv2.initUndistortRectifyMap(lens.K, lens.distortion, R, K, size, cv2.CV_32FC1)
    return Remap(x, y)
