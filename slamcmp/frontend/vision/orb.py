"""ORB descriptors at corners that somebody else found (Rublee, Rabaud, Konolige and Bradski 2011).

OpenCV gives an orientation only to corners it has found itself. Corners handed to ``ORB.compute`` without
one are described unrotated and match nothing after a turn of 30°, so the angle is computed here: the
direction from the corner to the intensity centroid of a disc, atan2(m01, m10) (their eq. 1-3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slamcmp.types import FloatArray, IntArray

RADIUS_PX = 15
"""Of the disc whose centroid gives the angle."""
BORDER_PX = 22
"""What a rotated and blurred patch reaches: 13 √2 for the pattern and 3 for the blur."""


@dataclass(frozen=True)
class Description:
    """Descriptors of those corners that are not too close to the border."""

    described: IntArray
    """Which of the corners were described, (m,)."""
    angle_deg: FloatArray
    """(m,) in [0, 360), from the image's x axis towards its y axis."""
    descriptors: NDArray[np.uint8]
    """(m, 32), 256 bits each."""


_NOTHING = Description(np.empty(0, np.int64), np.empty(0), np.empty((0, 32), np.uint8))


def describe(image: NDArray[np.uint8], xy: FloatArray) -> Description:
    """Oriented binary descriptors at pixels (n, 2); the patch is taken about the nearest whole pixel."""
    height, width = image.shape
    nearest = np.rint(xy)
    inside = (
        (nearest >= BORDER_PX).all(axis=1)
        & (nearest[:, 0] < width - BORDER_PX)
        & (nearest[:, 1] < height - BORDER_PX)
    )
    chosen = np.flatnonzero(inside)
    if not chosen.size:
        return _NOTHING
    angle = intensity_centroid_angles(image, xy[chosen])
    size = float(2 * RADIUS_PX + 1)
    # The last argument names each corner, for OpenCV may drop some.
    keypoints = [
        cv2.KeyPoint(x, y, size, a, 0.0, 0, i)
        for i, (x, y, a) in enumerate(zip(*nearest[chosen].T.tolist(), angle.tolist(), strict=True))
    ]
    keypoints, descriptors = _orb().compute(image, keypoints)
    if descriptors is None:
        return _NOTHING
    survivors = np.array([keypoint.class_id for keypoint in keypoints], dtype=np.int64)
    return Description(chosen[survivors], angle[survivors], np.asarray(descriptors))


def intensity_centroid_angles(image: NDArray[np.uint8], xy: FloatArray) -> FloatArray:
    """Angles [deg] in [0, 360) of the intensity centroid about pixels (n, 2), at least 15 px inside."""
    side = 2 * RADIUS_PX + 1
    patches = np.lib.stride_tricks.sliding_window_view(image, (side, side))
    columns, rows = np.rint(xy).astype(np.int64).T - RADIUS_PX
    values = patches[rows, columns].reshape(-1, side * side).astype(np.float32)
    # Whole numbers below 2^24: single precision adds them exactly.
    across, down = ((values @ weights).astype(np.float64) for weights in _moment_weights())
    angles: FloatArray = np.degrees(np.arctan2(down, across)) % 360.0
    return angles


@cache
def _moment_weights() -> NDArray[np.float32]:
    """Coordinates (2, side²) inside the disc and 0 outside of it."""
    axis = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    dy, dx = np.meshgrid(axis, axis, indexing="ij")
    # Half a pixel more than the radius is the disc that OpenCV's table of row widths describes.
    disc = dx * dx + dy * dy <= (RADIUS_PX + 0.5) ** 2
    return np.stack([dx * disc, dy * disc]).reshape(2, -1).astype(np.float32)


@cache
def _orb() -> Any:
    # One level: the corners have no scale. BORDER_PX was cleared already.
    return cv2.ORB.create(nlevels=1, edgeThreshold=BORDER_PX, patchSize=2 * RADIUS_PX + 1)
