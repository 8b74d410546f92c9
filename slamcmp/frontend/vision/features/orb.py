"""ORB descriptors at corners that somebody else found (Rublee, Rabaud, Konolige and Bradski 2011).

OpenCV gives an orientation only to corners it has found itself. Corners handed to ``ORB.compute`` without
one are described unrotated and match nothing after a turn of 30°, so the angle is computed here: the
direction from the corner to the intensity centroid of a disc, atan2(m01, m10) (their eq. 1-3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import repeat
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
    x, y = nearest[chosen].T.tolist()
    # The last argument names each corner, for OpenCV may drop some.
    named = map(cv2.KeyPoint, x, y, repeat(size), angle.tolist(), repeat(0.0), repeat(0), range(chosen.size))
    keypoints, descriptors = _orb().compute(image, tuple(named))
    if descriptors is None:
        return _NOTHING
    if len(keypoints) < chosen.size:
        survivors = np.array([keypoint.class_id for keypoint in keypoints], dtype=np.int64)
        chosen, angle = chosen[survivors], angle[survivors]
    return Description(chosen, angle, np.asarray(descriptors))


def intensity_centroid_angles(image: NDArray[np.uint8], xy: FloatArray) -> FloatArray:
    """Angles [deg] in [0, 360) of the intensity centroid about pixels (n, 2), at least 15 px inside."""
    side = 2 * RADIUS_PX + 1
    height, width = image.shape
    # What sliding_window_view gives, which takes as long to say so as the product below.
    patches = np.lib.stride_tricks.as_strided(
        image, (height - side + 1, width - side + 1, side, side), 2 * image.strides, writeable=False
    )
    columns, rows = np.rint(xy).astype(np.int64).T - RADIUS_PX
    values = patches[rows, columns].astype(np.float32).reshape(-1, side * side)
    # Whole numbers below 2^24: single precision adds them exactly.
    across, down = (values @ _moment_weights()).astype(np.float64).T
    angles: FloatArray = np.degrees(np.arctan2(down, across)) % 360.0
    return angles


@cache
def _moment_weights() -> NDArray[np.float32]:
    """Coordinates (side², 2) inside the disc and 0 outside of it."""
    axis = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    dy, dx = np.meshgrid(axis, axis, indexing="ij")
    # Half a pixel more than the radius is the disc that OpenCV's table of row widths describes.
    disc = dx * dx + dy * dy <= (RADIUS_PX + 0.5) ** 2
    return np.stack([dx * disc, dy * disc], axis=-1).reshape(-1, 2).astype(np.float32)


@cache
def _orb() -> Any:
    # One level: the corners have no scale. BORDER_PX was cleared already.
    return cv2.ORB.create(nlevels=1, edgeThreshold=BORDER_PX, patchSize=2 * RADIUS_PX + 1)
