"""The images of a drive through a scene, rendered one at a time, and the true matches between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from slamcmp.geometry import exp, local
from slamcmp.models.camera import MonoCamera, RgbdCamera, StereoCamera
from slamcmp.types import CameraFrame, FloatArray
from slamcmp.worlds.rendering.camera_image import Size, render_depth, render_exposure
from slamcmp.worlds.rendering.scene import Scene

AnyCamera = MonoCamera | StereoCamera | RgbdCamera


@dataclass(frozen=True)
class Exposure:
    """How the sensor turns light into numbers."""

    share: float
    """Of the time step during which the shutter is open: the length of the motion blur."""
    samples: int
    gain: FloatArray
    """(K,), a factor on the brightness of each frame."""
    noise_sigma: float
    """Grey levels."""
    vignetting: float
    """Share of the brightness that is missing in the image's corners."""
    depth_sigma_per_m2: float
    """Noise of the depth grows with its square: sigma [m] at 1 m."""
    depth_max_m: float


class RenderedImages(Sequence[CameraFrame]):
    """Frame k is drawn when it is asked for, always the same: every frame has a generator of its own."""

    def __init__(
        self,
        scene: Scene,
        camera: AnyCamera,
        size: Size,
        T_world_body: FloatArray,
        exposure: Exposure,
        seed: np.random.SeedSequence,
        *,
        with_depth: bool,
    ) -> None:
        self.scene, self.camera, self.size, self.exposure = scene, camera, size, exposure
        self._T_world_body = T_world_body
        self._with_depth = with_depth
        self._entropy, self._key = seed.entropy, seed.spawn_key

    def __len__(self) -> int:
        return len(self._T_world_body)

    @overload
    def __getitem__(self, k: int) -> CameraFrame: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[CameraFrame]: ...
    def __getitem__(self, k: int | slice) -> CameraFrame | Sequence[CameraFrame]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        if not -len(self) <= k < len(self):
            raise IndexError(f"frame {k} of {len(self)}")
        k %= len(self)
        seed = np.random.SeedSequence(self._entropy, spawn_key=(*self._key, k))
        left_noise, right_noise, depth_noise = (np.random.default_rng(s) for s in seed.spawn(3))
        poses = self._during_exposure(k)
        right = None
        if isinstance(self.camera, StereoCamera):
            aside = np.eye(4)
            aside[0, 3] = self.camera.baseline_m
            right = self._expose(k, [pose @ aside for pose in poses], right_noise)
        depth = self._measure_depth(k, depth_noise) if self._with_depth else None
        return CameraFrame(self._expose(k, poses, left_noise), right, depth)

    def camera_pose(self, k: int) -> FloatArray:
        """``T_world_camera`` of frame k in the middle of its exposure, (4, 4)."""
        pose: FloatArray = self._T_world_body[k] @ self.camera.T_body_camera
        return pose

    def surface_points(self, k: int, pixels: FloatArray) -> FloatArray:
        """The points of the scene (m, 3) [m] that frame k shows at pixels (m, 2); NaN where it shows none."""
        depth = self.scene.depth_at(self.camera_pose(k), self.camera.K, pixels)
        return self.camera.point_at_depth(self._T_world_body[k], pixels, depth)

    def true_pixels(self, k: int, j: int, pixels: FloatArray) -> FloatArray:
        """Where frame j shows what frame k shows at pixels (m, 2); NaN where it is hidden or outside."""
        points = self.surface_points(k, pixels)
        in_j = self.camera.camera_point(self._T_world_body[j], points)
        seen = self.camera.project(in_j)
        inside = np.asarray(np.isfinite(seen).all(axis=1))
        inside &= (np.nan_to_num(seen) >= 0).all(axis=1)
        inside &= (np.nan_to_num(seen) <= np.array(self.size) - 1).all(axis=1)
        nearest = self.scene.depth_at(
            self.camera_pose(j), self.camera.K, np.where(inside[:, None], seen, 0.0)
        )
        # Within a millimetre and a thousandth it is the same surface; the nearest other one is 10 mm away.
        visible = inside & (np.abs(nearest - in_j[:, 2]) < 1e-3 * (1.0 + in_j[:, 2]))
        return np.where(visible[:, None], seen, np.nan)

    def _during_exposure(self, k: int) -> list[FloatArray]:
        """Camera poses evenly over the exposure, whose middle is the frame's time."""
        other = k + 1 if k + 1 < len(self) else k - 1
        step = local(self._T_world_body[k], self._T_world_body[other]) * (1.0 if other > k else -1.0)
        count = self.exposure.samples
        shares = self.exposure.share * ((np.arange(count) + 0.5) / count - 0.5)
        return [self._T_world_body[k] @ exp(share * step) @ self.camera.T_body_camera for share in shares]

    def _expose(self, k: int, poses: list[FloatArray], noise: np.random.Generator) -> NDArray[np.uint8]:
        light = render_exposure(self.scene, poses, self.camera.K, self.size)
        light *= np.float32(self.exposure.gain[k]) * self._falloff()
        if self.exposure.noise_sigma > 0:
            light += np.float32(self.exposure.noise_sigma) * noise.standard_normal(
                light.shape, dtype=np.float32
            )
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)

    def _falloff(self) -> NDArray[np.float32]:
        width, height = self.size
        x = (np.arange(width) - 0.5 * (width - 1)) / (0.5 * width)
        y = (np.arange(height) - 0.5 * (height - 1)) / (0.5 * height)
        radius_squared = 0.5 * (x[None, :] ** 2 + y[:, None] ** 2)
        return (1.0 - self.exposure.vignetting * radius_squared).astype(np.float32)

    def _measure_depth(self, k: int, noise: np.random.Generator) -> NDArray[np.float32]:
        depth = render_depth(self.scene, self.camera_pose(k), self.camera.K, self.size)
        sigma = np.float32(self.exposure.depth_sigma_per_m2) * depth * depth
        measured = depth + sigma * noise.standard_normal(depth.shape, dtype=np.float32)
        known = (depth > 0) & (measured > 0) & (measured <= self.exposure.depth_max_m)
        return np.where(known, measured, 0.0).astype(np.float32)
