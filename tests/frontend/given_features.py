"""A tracker whose features are given instead of found: points with descriptors of their own, seen exactly.

No image is drawn, so that a test can move one match by so many pixels and see what becomes of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from slamcmp.frontend.tracked_features import tracked_features
from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.image_pair import Features
from slamcmp.frontend.vision.tracking import tracker as tracker_module
from slamcmp.frontend.vision.tracking.measuring import Measured, measuring
from slamcmp.frontend.vision.tracking.tracker import STAGES, FeatureTracker, Sighting, TrackingSettings
from slamcmp.geometry import exp
from slamcmp.models.camera import MonoCamera, StereoCamera
from slamcmp.types import CameraFrame

INTRINSICS = {"fx_px": 300.0, "fy_px": 300.0, "cx_px": 159.5, "cy_px": 119.5}
PAIR = StereoCamera(**INTRINSICS, baseline_m=0.2)
SINGLE = MonoCamera(**INTRINSICS)
R_PAIR = np.array([[0.25, 0.25, 0.0], [0.25, 0.29, 0.0], [0.0, 0.0, 0.25]])
SURE = np.diag([1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4]) ** 2
"""Covariance of an increment that is known well."""
TO_THE_LEFT = exp(np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]))
"""A step along the image's rows: epipolar lines are rows, and points 3 to 9 m away move 30 to 10 px."""
ALONG_THE_LINE = np.array([1.0, 0.0])
OFF_THE_LINE = np.array([0.0, 1.0])


@dataclass(frozen=True)
class View:
    """Features (m,) of one image, strongest first."""

    xy: np.ndarray
    disparity: np.ndarray
    """NaN where the right image shows nothing."""
    descriptors: np.ndarray

    def moved(self, which: object, by_px: np.ndarray) -> View:
        """Some features elsewhere, with the disparity they had."""
        xy = self.xy.copy()
        xy[which] += by_px
        return replace(self, xy=xy)

    def without_depth(self, which: object) -> View:
        disparity = self.disparity.copy()
        disparity[which] = np.nan
        return replace(self, disparity=disparity)

    def only(self, which: object) -> View:
        return View(self.xy[which], self.disparity[which], self.descriptors[which])

    def unlike(self, which: int, bits: int) -> View:
        """One descriptor with its first ``bits`` bits turned."""
        descriptors = np.unpackbits(self.descriptors, axis=1)
        descriptors[which, :bits] ^= 1
        return replace(self, descriptors=np.packbits(descriptors, axis=1))


class Points:
    """Points in the world, at pixels of the image and depths of 3 to 9 m from the first pose."""

    def __init__(self, count: int = 60, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        # On a grid with a little play: no two of them crowd each other.
        columns = int(np.ceil(np.sqrt(count * 4 / 3)))
        cell = np.arange(count)
        grid = np.stack([cell % columns, cell // columns], axis=1) * (240.0 / columns) + [50.0, 40.0]
        pixels = grid + rng.uniform(-3, 3, (count, 2))
        self.places = PAIR.point_at_depth(np.eye(4), pixels, rng.uniform(3.0, 9.0, count))
        self.descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)

    def view(self, T_world_body: np.ndarray) -> View:
        z = PAIR.predict(T_world_body, self.places)
        return View(z[:, [0, 2]], z[:, 0] - z[:, 1], self.descriptors)


class Following:
    """A tracker, and where the robot is in truth."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, camera: StereoCamera | MonoCamera, **settings: object
    ) -> None:
        self._now: View | None = None
        rng = np.random.default_rng(7)
        self._image = rng.integers(0, 256, (240, 320), dtype=np.uint8)
        monkeypatch.setattr(tracker_module, "extract_features", lambda *_, **__: self._features())
        monkeypatch.setattr(tracker_module, "measuring", self._measuring)
        parameters = {**tracked_features.__kwdefaults__, **settings}
        self.tracker = FeatureTracker(camera, TrackingSettings(**parameters), np.random.default_rng(0))
        self.T = np.eye(4)

    def see(self, view: View | None, step: np.ndarray | None = None, Q: np.ndarray = SURE) -> Sighting:
        """The next image after a step as odometry tells it; None is an image that cannot be used."""
        self._now = view
        # No two images of a camera are the same, nor the two of a pair.
        self._image = self._image + np.uint8(1)
        frame = CameraFrame(None) if view is None else CameraFrame(self._image, self._image[::-1])
        return self.tracker.step(frame, np.eye(4) if step is None else step, Q)

    def drive(self, points: Points, step: np.ndarray = TO_THE_LEFT) -> View:
        """The view after the robot has moved."""
        self.T = self.T @ step
        return points.view(self.T)

    def _features(self) -> Features:
        assert self._now is not None
        count = len(self._now.xy)
        strength = np.arange(count, 0.0, -1.0)
        corners = Corners(self._now.xy, strength, count, 0)
        return Features(self._now.xy, strength, np.zeros(count), self._now.descriptors, corners, {}, {})

    def _measuring(self, camera: object, noise: object, **settings: object) -> object:
        sensor, measure = measuring(camera, noise, **settings)  # type: ignore[arg-type]
        return sensor, self._measure if sensor is camera else measure

    def _measure(self, frame: CameraFrame, features: Features) -> Measured:
        assert self._now is not None
        xy, disparity = self._now.xy, self._now.disparity
        z = np.stack([xy[:, 0], xy[:, 0] - disparity, xy[:, 1]], axis=1)
        return Measured(z, np.tile(R_PAIR, (len(xy), 1, 1)), np.isfinite(disparity))


def taken(sighting: Sighting, stage: str) -> int:
    """How many features a stage took."""
    return sighting.counts[1 + STAGES.index(stage)]
