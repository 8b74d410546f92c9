"""Whether the images of a pair are what their calibration says: rectified, left and right, of one instant.

Stereo matching looks along the rows, to one side only; what does not fit there has no partner, and a front
end that is content with that says nothing. Here corners are matched all over the image, in the first pairs
and in some later ones, and what the partners show is put into words with its likely cause.

The difference of rows is fitted, robustly, as a + b x + c y + d x y, with x, y from -1/2 to 1/2 over the
image.

========  ==============================================================================
term      likely cause
========  ==============================================================================
a         the right camera looks higher or lower: not rectified, or another calibration
b         it is turned about the optical axis: not rectified
c         other focal length; or the robot drove on between the two images
d         it is turned to the side: not rectified
scatter   distortion, or the robot turned between the two images
========  ==============================================================================
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.frontend.vision.image_pair import Features, extract_features
from slamcmp.frontend.vision.matching import match_descriptors
from slamcmp.models.camera import StereoCamera
from slamcmp.types import CameraFrame, FloatArray

_FIRST = 5
"""Pairs that are looked at from the beginning."""
_EVERY = 25
"""One in so many after that."""
_ROWS_PX = 40.0
"""Farthest that partners may be apart in their rows."""
_PAIRS_MIN = 60
"""Partners before anything is said."""
_OFFSET_PX = 0.8
"""Rows may differ so much: half of what matching along the rows allows."""
_ACROSS_PX = 1.5
"""Largest change of that from one side of the image to the other."""
_ASIDE_DEG = 0.3
_SCATTER_PX = 1.0
_WRONG_SIDE = 0.6
"""Share of partners to the right of where the left image has them."""
_BEHIND = 0.15
_BEHIND_PX = 2.0
_GAIN = 1.15
_BASELINE_M = (0.002, 5.0)
_ROUNDS = 20


class PairCheck:
    """Partners all over the image, gathered from some pairs.

    Args:
        camera: what the images are said to be taken with.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self._left = np.empty((0, 2))
        self._right = np.empty((0, 2))
        self._gains: list[float] = []
        self._seen = 0
        self._size = (1, 1)

    def look(self, left: Features, frame: CameraFrame, count: int) -> None:
        """Take in a pair, where it is its turn.

        Raises:
            DataError: left and right are swapped: there is nothing to be measured.
        """
        self._seen += 1
        if self._seen > _FIRST and self._seen % _EVERY:
            return
        assert frame.image is not None
        assert frame.right is not None
        self._size = frame.image.shape[1], frame.image.shape[0]
        right = extract_features(frame.right, count=count)
        allowed = np.abs(left.xy[:, None, 1] - right.xy[None, :, 1]) <= _ROWS_PX
        here, there = match_descriptors(
            left.descriptors, right.descriptors, ratio=0.8, allowed=allowed
        ).pairs.T
        self._left = np.concatenate([self._left, left.xy[here]])
        self._right = np.concatenate([self._right, right.xy[there]])
        self._gains += _gains(frame.image, frame.right, left.xy[here], right.xy[there])
        if self._seen == _FIRST and self._wrong_side() > _WRONG_SIDE:
            raise DataError(
                f"{self._wrong_side():.0%} of the points lie farther right in the right image than in the "
                "left one: left and right are swapped (or the images are mirrored)"
            )

    def findings(self) -> list[str]:
        """What does not fit, in sentences; empty where all does or where too little was seen."""
        told = []
        baseline = self._camera.baseline_m
        if not _BASELINE_M[0] <= baseline <= _BASELINE_M[1]:
            told.append(f"the baseline of the pair is {baseline:g} m: is it in millimetres?")
        if len(self._left) < _PAIRS_MIN:
            return told
        a, b, c, d, scatter = self._rows()
        width, height = self._size
        if abs(a) > _OFFSET_PX:
            told.append(
                f"the right image shows points {abs(a):.1f} px {'lower' if a > 0 else 'higher'} than the "
                f"left one ({np.degrees(np.arctan2(abs(a), self._camera.fy_px)):.2g}° of tilt): the pair is "
                "not rectified, or the calibration is another pair's"
            )
        if abs(b) > _ACROSS_PX:
            told.append(
                f"the right image is turned by {np.degrees(np.arctan2(abs(b), width)):.1f}° against the left "
                "one: the pair is not rectified"
            )
        aside = float(np.degrees(abs(d) * self._camera.fx_px / (width * height)))
        if abs(d) > _ACROSS_PX and aside > _ASIDE_DEG:
            told.append(
                f"the right camera is turned to the side by {aside:.1f}° against the left one: the pair is "
                "not rectified"
            )
        if abs(c) > _ACROSS_PX:
            told.append(
                f"the right image is {abs(c) / height:.1%} {'larger' if c > 0 else 'smaller'} than the left "
                "one: its focal length is another one, or it was not taken at the same time (one frame late?)"
            )
        if scatter > _SCATTER_PX:
            told.append(
                f"rows of the two images differ by {scatter:.1f} px from point to point: they were not taken "
                "at the same time (one frame late?), or lens distortion was not removed"
            )
        behind = float((self._shift() < -_BEHIND_PX).mean())
        if _BEHIND < behind <= _WRONG_SIDE:
            told.append(
                f"{behind:.0%} of the points would lie behind infinity: the images were not taken at the "
                "same time, or the cameras do not look the same way"
            )
        gain = float(np.median(self._gains)) if self._gains else 1.0
        if not 1.0 / _GAIN <= gain <= _GAIN:
            told.append(
                f"the right image has {gain:.2f} times the contrast of the left one: unequal exposure (it is "
                "allowed for in stereo matching)"
            )
        return told

    def _shift(self) -> FloatArray:
        shift: FloatArray = self._left[:, 0] - self._right[:, 0]
        return shift

    def _wrong_side(self) -> float:
        return float((self._shift() < -_BEHIND_PX).mean()) if len(self._left) >= _PAIRS_MIN else 0.0

    def _rows(self) -> tuple[float, float, float, float, float]:
        """a, b, c, d and the scatter about them, by least absolute deviations (reweighted least squares)."""
        place = self._left / np.array(self._size) - 0.5
        A = np.column_stack([np.ones(len(place)), place, place.prod(axis=1)])
        y = self._right[:, 1] - self._left[:, 1]
        x = np.array([np.median(y), 0.0, 0.0, 0.0])
        for _ in range(_ROUNDS):
            weight = 1.0 / np.maximum(np.abs(y - A @ x), 0.1)
            x = np.linalg.solve((A.T * weight) @ A, (A.T * weight) @ y)
        a, b, c, d = x.tolist()
        return a, b, c, d, float(1.4826 * np.median(np.abs(y - A @ x)))


def _gains(
    left: NDArray[np.uint8], right: NDArray[np.uint8], at_left: FloatArray, at_right: FloatArray
) -> list[float]:
    """Contrast of the right image's patches over that of the left one's."""
    patches = []
    for image, xy in ((left, at_left), (right, at_right)):
        column, row = np.rint(xy).astype(np.int64).T
        windows = np.lib.stride_tricks.sliding_window_view(image, (11, 11))
        patches.append(windows[row - 5, column - 5].reshape(len(xy), 121).std(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        gains = patches[1] / patches[0]
    return [float(gain) for gain in gains if np.isfinite(gain)]
