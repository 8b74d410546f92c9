"""What a camera measures at a feature: pixels, a stereo pair's disparity, or an RGB-D camera's depth.

Stereo and RGB-D streams share one measurement, (u_left, u_right, v): a depth d becomes the disparity of a
virtual pair, f b / d, whose error is nearly the same at all depths, for the depth's own grows with d²
(Khoshelham and Oude Elberink 2012). Both columns carry the corner's error, and their difference carries the
disparity's: R is not diagonal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcmp.frontend.vision.image_pair import Features, extract_features
from slamcmp.frontend.vision.pyramid import extract_pyramid
from slamcmp.frontend.vision.tracking.stereo_matching import match_rows
from slamcmp.models.camera import Camera, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.types import BoolArray, CameraFrame, FloatArray

VIRTUAL_BASELINE_M = 0.075
"""Of an RGB-D camera's pair: that of a Kinect; any would do."""
DEPTH_PRECISION = 0.1
"""Share of the depth that its deviation may be: beyond it a point's error is far from Gaussian in space."""
_HALF_PATCH_PX = 2
_KNOWN_SHARE = 0.6
_SPREAD = 0.02
"""Of the depth: where a patch's middle half spreads more, it lies on an edge and its depth is anyone's."""


@dataclass(frozen=True)
class Noise:
    """What the front end states about its measurements."""

    sigma_px: float
    """Of a corner's position, per axis."""
    disparity_sigma_px: float
    """Of the disparity of a stereo pair."""
    depth_sigma_per_m2: float
    """Of an RGB-D camera's depth: sigma [m] at 1 m, growing with the square of the depth."""


@dataclass(frozen=True)
class Measured:
    """Measurements at the features (m,) of one image."""

    z: FloatArray
    """(m, d)."""
    R: FloatArray
    """(m, d, d)."""
    valid: BoolArray
    """Where there is one, (m,)."""


Measure = Callable[[CameraFrame, Features], Measured]


def measuring(
    camera: Camera, noise: Noise, *, features: int, depth_min_m: float, levels: int = 1
) -> tuple[MonoCamera | StereoCamera, Measure]:
    """The sensor that a stream of this camera's measurements has, and the function that makes them.

    Points nearer than ``depth_min_m`` are not measured, nor those so far away that their depth is open.
    """
    intrinsics = {name: value for name, value in camera.parameters().items() if name != "baseline_m"}
    if isinstance(camera, StereoCamera):
        return camera, _stereo(camera, noise, features, levels, depth_min_m)
    if isinstance(camera, RgbdCamera):
        virtual = StereoCamera(**intrinsics, baseline_m=VIRTUAL_BASELINE_M)
        return virtual, _with_depth(virtual, noise, depth_min_m)
    return MonoCamera(**intrinsics), _pixels(noise)


def patch_depths(depth_m: NDArray[np.float32], xy: FloatArray) -> FloatArray:
    """Median depths (m,) [m] of the patches about pixels (m, 2); NaN where unknown or on an edge."""
    side = 2 * _HALF_PATCH_PX + 1
    height, width = depth_m.shape
    column, row = np.rint(xy).astype(np.int64).T
    column = np.clip(column, _HALF_PATCH_PX, width - _HALF_PATCH_PX - 1)
    row = np.clip(row, _HALF_PATCH_PX, height - _HALF_PATCH_PX - 1)
    windows = np.lib.stride_tricks.sliding_window_view(depth_m, (side, side))
    patches = windows[row - _HALF_PATCH_PX, column - _HALF_PATCH_PX].reshape(-1, side * side)
    known = patches > 0
    enough = known.mean(axis=1) >= _KNOWN_SHARE
    answer = np.full(len(xy), np.nan)
    if enough.any():
        values = np.where(known, patches, np.nan)[enough].astype(np.float64)
        low, median, high = np.nanpercentile(values, [25, 50, 75], axis=1)
        answer[enough] = np.where(high - low <= _SPREAD * median, median, np.nan)
    return answer


def _pixels(noise: Noise) -> Measure:
    def measure(frame: CameraFrame, features: Features) -> Measured:  # noqa: ARG001
        count = len(features.xy)
        R = np.broadcast_to(noise.sigma_px**2 * np.eye(2), (count, 2, 2))
        if features.factor is not None:
            R = R * (features.factor**2)[:, None, None]
        return Measured(features.xy, R, np.ones(count, dtype=bool))

    return measure


def _stereo(camera: StereoCamera, noise: Noise, features: int, levels: int, depth_min_m: float) -> Measure:
    strength = camera.fx_px * camera.baseline_m

    def measure(frame: CameraFrame, left: Features) -> Measured:
        assert frame.image is not None
        assert frame.right is not None
        if levels == 1:
            right = extract_features(frame.right, count=features)
        else:
            right = extract_pyramid(frame.right, count=features, levels=levels)
        found = match_rows(left, right, frame.image, frame.right, disparity_max_px=strength / depth_min_m)
        return _as_pair(left, found.disparity_px, strength / depth_min_m, noise, noise.disparity_sigma_px)

    return measure


def _with_depth(camera: StereoCamera, noise: Noise, depth_min_m: float) -> Measure:
    strength = camera.fx_px * camera.baseline_m

    def measure(frame: CameraFrame, features: Features) -> Measured:
        assert frame.depth_m is not None
        depth = patch_depths(frame.depth_m, features.xy)
        # d(f b / d) = -f b / d² dd, and dd grows with d².
        sigma = strength * noise.depth_sigma_per_m2
        return _as_pair(features, strength / depth, strength / depth_min_m, noise, sigma)

    return measure


def _as_pair(
    features: Features, disparity: FloatArray, largest: float, noise: Noise, disparity_sigma_px: float
) -> Measured:
    xy = features.xy
    z = np.stack([xy[:, 0], xy[:, 0] - disparity, xy[:, 1]], axis=-1)
    corner, difference = noise.sigma_px**2, disparity_sigma_px**2
    by_corner = np.array([[corner, corner, 0.0], [corner, corner, 0.0], [0.0, 0.0, corner]])
    R = np.broadcast_to(by_corner, (len(xy), 3, 3))
    if features.factor is not None:
        # A pixel of a smaller image is that much larger; the disparity is aligned in the image itself.
        R = R * (features.factor**2)[:, None, None]
    R = R + np.diag([0.0, difference, 0.0])
    with np.errstate(invalid="ignore"):
        valid = (disparity <= largest) & (disparity_sigma_px <= DEPTH_PRECISION * disparity)
    return Measured(z, R, valid)
