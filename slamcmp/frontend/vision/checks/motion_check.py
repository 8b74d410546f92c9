"""Whether the images turn as the odometry says: clocks that are apart, and a mounting that is inverted.

The picture of a camera that turns is shifted as a whole. The shift between two images is read off their
mean rows and columns (as RatSLAM does: Milford and Wyeth 2008), which needs no features and no odometry; what
the odometry's rotation should have shifted it by is compared over the whole recording, image by image and
with one of the two delayed.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from slamcmp.frontend.vision.checks.mounting_mistakes import WHAT_IT_MAPS, mounting_mistakes
from slamcmp.geometry import local
from slamcmp.models.camera import Camera
from slamcmp.types import FloatArray

_STANDING = 1e-4
"""Probability that odometry's noise alone moves so far."""
_REACH = 0.15
"""Of the image's side: larger shifts are not looked for."""
_DELAY_MAX = 8
_FRAMES_MIN = 15
_TURNING_PX = 1.5
"""Root mean square of the expected shift: with less, the images hardly turn."""
_FITS, _FITS_NOT = 0.7, 0.4
"""Correlations of what was seen with what was expected."""
_BETTER_BY, _REST = 0.08, 1.8
"""By how much a delay must fit better, and how much larger what remains unexplained must be without it."""


def frozen(
    before: NDArray[np.uint8] | None, now: NDArray[np.uint8] | None, T: FloatArray, Q: FloatArray
) -> str:
    """Why an image is none: the last one again, while the robot drove by T with covariance Q; else empty."""
    if not same_picture(before, now):
        return ""
    moved = local(np.eye(4), T)
    if moved @ np.linalg.pinv(Q) @ moved <= chdtri(6, _STANDING):
        return ""
    return "the same image as before, while the odometry moved: the camera is frozen"


def same_picture(one: NDArray[np.generic] | None, other: NDArray[np.generic] | None) -> bool:
    """Whether two images are equal in every byte."""
    # A few rows tell nearly all pairs apart.
    if one is None or other is None or not np.array_equal(one[::64], other[::64]):
        return False
    return np.array_equal(one, other)


class MotionCheck:
    """Shifts of the images, seen and expected, one entry a frame.

    Args:
        camera: what the images were taken with.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._profiles: list[FloatArray] | None = None
        self._seen: list[FloatArray] = []
        self._rotations: list[FloatArray] = []

    def look(self, image: NDArray[np.uint8] | None, T_prev_body: FloatArray) -> None:
        """Take in the next frame; None is one that cannot be used."""
        profiles = None if image is None else _profiles(image)
        shift = np.full(2, np.nan)
        if profiles is not None and self._profiles is not None:
            pairs = zip(self._profiles, profiles, strict=True)
            shift = np.array([_shift(*each) if len(each[0]) == len(each[1]) else np.nan for each in pairs])
        self._profiles = profiles
        self._seen.append(shift)
        self._rotations.append(T_prev_body[:3, :3])

    def findings(self, step_s: float) -> list[str]:
        """What does not fit, with the likely cause; ``step_s`` is the usual time between two frames."""
        seen, mounting = np.array(self._seen), self._camera.T_body_camera[:3, :3]
        expected = self._expected(mounting)
        if len(seen) < _FRAMES_MIN:
            return []
        fit = _correlation(seen, expected)
        delays = [each for each in range(-_DELAY_MAX, _DELAY_MAX + 1) if abs(each) < len(seen) // 3]
        fits = [_correlation(seen[max(delay, 0) :], expected[max(-delay, 0) :]) for delay in delays]
        best = int(np.argmax(fits))
        if fit < _FITS_NOT:
            for T_body_camera, name in mounting_mistakes(self._camera.T_body_camera):
                other = self._expected(T_body_camera[:3, :3])
                meant = _correlation(seen, other)
                if _turning(other) and meant > _FITS and meant > fits[best]:
                    return [
                        f"the images do not turn as the odometry says (correlation {fit:.2f}), but would if "
                        f"{name} ({meant:.2f}); {WHAT_IT_MAPS}"
                    ]
        if not _turning(expected):
            return []
        better = fits[best] - fit > _BETTER_BY and 1.0 - fit > _REST * (1.0 - fits[best])
        if delays[best] and fits[best] > _FITS and better:
            late = delays[best]
            return [
                f"the images fit the odometry best {abs(late)} frame(s) ({abs(late) * step_s:.3g} s) "
                f"{'later' if late > 0 else 'earlier'} (correlation {fits[best]:.2f}, {fit:.2f} as "
                "recorded): are the clocks of camera and odometry apart?"
            ]
        return []

    def _expected(self, R_body_camera: FloatArray) -> FloatArray:
        """Where the rotations (K, 3, 3) take the middle of the picture, (K, 2) [px]."""
        turned = R_body_camera.T @ np.swapaxes(np.array(self._rotations), 1, 2) @ R_body_camera
        ray = turned[:, :, 2]
        shift: FloatArray = (
            ray[:, :2] / np.maximum(ray[:, 2:], 0.1) * [self._camera.fx_px, self._camera.fy_px]
        )
        return shift


def _turning(expected: FloatArray) -> bool:
    """Whether shifts (K, 2) [px] are large enough to be told from noise."""
    return bool(np.sqrt(np.nanmean(expected**2)) >= _TURNING_PX)


def _profiles(image: NDArray[np.uint8]) -> list[FloatArray]:
    """Changes along the mean row and the mean column: brightness as a whole is no motion."""
    return [
        np.diff(cv2.reduce(image, axis, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel().astype(np.float64))
        for axis in (0, 1)
    ]


def _shift(before: FloatArray, now: FloatArray) -> float:
    """By how many pixels ``now`` lies further than ``before``: the overlap's best normalised correlation."""
    count = len(before)
    reach = int(_REACH * count)
    products = np.correlate(now, before, mode="full")[count - 1 - reach : count + reach]
    lags = np.arange(-reach, reach + 1)
    energy = np.concatenate([[0.0], np.cumsum(before**2)]), np.concatenate([[0.0], np.cumsum(now**2)])
    of_before = energy[0][np.minimum(count, count - lags)] - energy[0][np.maximum(0, -lags)]
    of_now = energy[1][np.minimum(count, count + lags)] - energy[1][np.maximum(0, lags)]
    score = products / np.sqrt(np.maximum(of_before * of_now, 1e-12))
    return float(lags[int(np.argmax(score))])


def _correlation(seen: FloatArray, expected: FloatArray) -> float:
    """Over both axes and without a mean: no turn is no shift."""
    count = min(len(seen), len(expected))
    seen, expected = seen[:count], expected[:count]
    known = np.isfinite(seen)
    a, b = seen[known], expected[known]
    norm = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / norm) if norm > 0 else 0.0
