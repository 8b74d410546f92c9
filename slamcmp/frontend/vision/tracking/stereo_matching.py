"""Where the right camera of a rectified pair sees what the left one sees: the disparity of each feature.

Descriptors along a row find the right corner; the disparity itself then comes from aligning a patch, by
least squares on the grey values (Lucas and Kanade 1981), for two corners found apart from one another each
carry their own error. A slanting surface has a disparity that changes over the patch, so that its slopes
are estimated with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcmp.frontend.vision.image_pair import Features
from slamcmp.frontend.vision.matching import match_descriptors
from slamcmp.types import BoolArray, FloatArray

GrayImage = NDArray[np.uint8]

ROW_TOLERANCE_PX = 1.5
"""Between the rows of two corners of one point: three deviations of either, and a little of calibration."""
_HALF_PX = 5
_SLACK_PX = 3
"""Columns beside the patch that alignment may reach into."""
_STEPS = 5
_SLOPE_SIGMA = 0.15
"""Expected slope of the disparity over the patch: a floor seen from half a metre has 0.2."""
_SIGMA_GREY = 8.0
"""Weight of the grey values against that expectation."""
_SAME_EXPOSURE = 1.05
"""Ratio of contrasts that alignment does not feel."""
_ALIKE = 0.6
"""Smallest correlation of two patches of one point."""


@dataclass(frozen=True)
class Disparities:
    """What stereo matching found for the features (m,) of the left image."""

    disparity_px: FloatArray
    """u_left - u_right, (m,); NaN where there is none."""
    no_partner: int
    """Features without a mutual, unambiguous match on their row."""
    not_aligned: int
    """Matches whose patches do not look alike or do not come to rest."""


def match_rows(
    left: Features,
    right: Features,
    left_image: GrayImage,
    right_image: GrayImage,
    *,
    disparity_max_px: float,
    ratio: float = 0.8,
) -> Disparities:
    """Disparities (m,) of the left image's features; NaN for those without a sure partner.

    A match is mutual, so that it holds from the right image to the left one as well.
    """
    shift = left.xy[:, None, 0] - right.xy[None, :, 0]
    allowed = np.abs(left.xy[:, None, 1] - right.xy[None, :, 1]) <= ROW_TOLERANCE_PX
    # A point far away may come out a little behind infinity.
    allowed &= (shift >= -ROW_TOLERANCE_PX) & (shift <= disparity_max_px)
    matches = match_descriptors(left.descriptors, right.descriptors, ratio=ratio, allowed=allowed)
    disparity = np.full(len(left.xy), np.nan)
    here, there = matches.pairs.T
    guess = left.xy[here, 0] - right.xy[there, 0]
    disparity[here] = align_rows(left_image, right_image, left.xy[here], guess)
    aligned = int(np.isfinite(disparity).sum())
    return Disparities(disparity, len(left.xy) - len(here), len(here) - aligned)


def align_rows(
    left_image: GrayImage, right_image: GrayImage, xy: FloatArray, guess_px: FloatArray
) -> FloatArray:
    """Disparities (m,) that align the patches about left pixels (m, 2), from guesses within two pixels.

    NaN where a patch leaves the image, does not come to rest, or stays unlike.
    """
    height, width = left_image.shape
    column, row = np.rint(xy).astype(np.int64).T
    whole = np.rint(guess_px).astype(np.int64)
    reach = _HALF_PX + _SLACK_PX + 1
    inside = (row >= _HALF_PX) & (row < height - _HALF_PX) & (column >= _HALF_PX)
    inside &= (column < width - _HALF_PX) & (column - whole >= reach) & (column - whole < width - reach)
    chosen = np.flatnonzero(inside)
    answer = np.full(len(xy), np.nan)
    if chosen.size:
        column, row, whole = column[chosen], row[chosen], whole[chosen]
        patch = _patches(left_image, row, column, _HALF_PX)
        strip = _patches(right_image, row, column - whole, reach)
        gain = _gain(patch, strip)
        if not 1.0 / _SAME_EXPOSURE <= gain <= _SAME_EXPOSURE:
            strip /= np.float32(gain)
        rest, settled = _align(patch, strip, guess_px[chosen] - whole)
        answer[chosen[settled]] = (whole + rest)[settled]
    return answer


def _align(
    patch: NDArray[np.float32], strip: NDArray[np.float32], offset: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Offsets d (m,) with strip(x - d - a x - b y) = patch(x, y) up to brightness, and which came to rest."""
    count = len(patch)
    axis = np.arange(-_HALF_PX, _HALF_PX + 1, dtype=np.float32)
    x, y = (each.reshape(-1) for each in np.broadcast_arrays(axis[None, :], axis[:, None]))
    basis = np.stack([np.ones_like(x), x, y], axis=-1)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(-1, 9)
    wanted = patch.reshape(count, -1)
    wanted = wanted - wanted.mean(axis=1, keepdims=True)
    parameters = np.zeros((count, 3))
    parameters[:, 0] = offset
    stiffness = np.array([1e-3, *[(_SIGMA_GREY / _SLOPE_SIGMA) ** 2] * 2])
    step = np.zeros_like(parameters)
    for _ in range(_STEPS):
        seen, slope = _sampled(strip, parameters.astype(np.float32) @ basis.T, x)
        # Differences of brightness are taken out of the derivative as out of the values.
        mean = (slope @ basis).astype(np.float64) / x.size
        A = ((slope * slope) @ products).astype(np.float64).reshape(count, 3, 3)
        A += np.diag(stiffness) - x.size * mean[:, :, None] * mean[:, None, :]
        b = ((slope * (seen - wanted)) @ basis).astype(np.float64) - [0.0, *stiffness[1:]] * parameters
        step = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        parameters += np.clip(step, -1.0, 1.0)
    seen, _ = _sampled(strip, parameters.astype(np.float32) @ basis.T, x)
    norms = np.linalg.norm(seen, axis=1) * np.linalg.norm(wanted, axis=1)
    alike = (seen * wanted).sum(axis=1) > _ALIKE * norms
    moved = np.abs(parameters[:, 0] - offset)
    return parameters[:, 0], alike & (np.abs(step[:, 0]) < 0.05) & (moved < _SLACK_PX - 0.5)


def _gain(patch: NDArray[np.float32], strip: NDArray[np.float32]) -> float:
    """Contrast of the right image over the left one's: two cameras need not be exposed alike."""
    middle = slice(strip.shape[2] // 2 - _HALF_PX, strip.shape[2] // 2 + _HALF_PX + 1)
    left, right = (each.reshape(len(each), -1).std(axis=1) for each in (patch, strip[:, :, middle]))
    textured = left > 0
    gain = float(np.median(right[textured] / left[textured])) if textured.any() else 1.0
    return gain if gain > 0 else 1.0


def _sampled(
    strip: NDArray[np.float32], shift: NDArray[np.float32], x: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Grey values less their mean, and their slope along the row, at columns x - shift, by interpolation."""
    count, rows, columns = strip.shape
    place = np.clip(columns // 2 + x - shift, 0.0, columns - 1.001)
    left = place.astype(np.int32)
    line = np.repeat(np.arange(rows, dtype=np.int32), x.size // rows) * columns
    index = left + (line + np.arange(count, dtype=np.int32)[:, None] * (rows * columns))
    values = strip.reshape(-1)
    low = values[index]
    slope = values[index + 1] - low
    seen = low + (place - left) * slope
    seen -= seen.mean(axis=1, keepdims=True)
    return seen, slope


def _patches(
    image: GrayImage, row: NDArray[np.int64], column: NDArray[np.int64], half: int
) -> NDArray[np.float32]:
    """Parts of an image about whole pixels: the patch's rows, and 2 half + 1 columns."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (2 * _HALF_PX + 1, 2 * half + 1))
    return windows[row - _HALF_PX, column - half].astype(np.float32)
