"""Cameras as landmark sensors in space: monocular, stereo and RGB-D, all pinhole and without distortion.

========  ===========================================================================
symbol    meaning
========  ===========================================================================
q         landmark in the camera frame (x right, y down, z forward), (..., 3) [m]
z         measurement (..., d): (u, v), (u_left, u_right, v) [px] or (u, v, depth) [px, px, m]
D         derivative of z by q, (..., d, 3)
H_pose    derivative of h by the body tangent (omega, v), (..., d, 6)
H_land    derivative of h by the landmark in the world, (..., d, 3)
========  ===========================================================================

u = fx q_x / q_z + cx, v = fy q_y / q_z + cy; the right image of a rectified pair has
u_right = fx (q_x - b) / q_z + cx (Hartley and Zisserman 2004, eq. 6.9 and section 9.5). Pixel (0, 0) is the
centre of the top left pixel. What lies on or behind the camera's plane has no image: its prediction is NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt
from numpy.typing import ArrayLike

from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import inverse, transform
from slamcmp.models.sensors import body_point, body_point_jacobians
from slamcmp.registry import sensors
from slamcmp.types import FloatArray

Positive = Annotated[float, Gt(0)]

FORWARD_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""``T_body_camera`` of a camera at the body's origin that looks along the body's x axis, z up."""
FORWARD_CAMERA.flags.writeable = False


class Camera(ABC):
    """What the three cameras share: intrinsics, the mounting, and the way into the camera frame."""

    name: str
    space_dim = 3
    dim: int
    components: tuple[str, ...]

    def __init__(
        self,
        *,
        fx_px: Positive,
        fy_px: Positive,
        cx_px: float,
        cy_px: float,
        T_body_camera: ArrayLike | None = None,
    ) -> None:
        mounting = FORWARD_CAMERA if T_body_camera is None else np.array(T_body_camera, dtype=np.float64)
        rotation = mounting[:3, :3] if mounting.shape == (4, 4) else np.zeros((3, 3))
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise DataError(f"{self.name}: T_body_camera is not a rigid transform (4, 4)")
        if not np.array_equal(mounting[3], [0.0, 0.0, 0.0, 1.0]):
            raise DataError(
                f"{self.name}: the last row of T_body_camera is {mounting[3].tolist()} where 0, 0, 0, 1 is "
                "needed; is the matrix transposed?"
            )
        if not (fx_px > 0 and fy_px > 0 and np.isfinite([cx_px, cy_px]).all()):
            raise DataError(
                f"{self.name}: focal lengths {fx_px}, {fy_px} and principal point {cx_px}, {cy_px}; "
                "positive and finite numbers are needed"
            )
        self.fx_px, self.fy_px = float(fx_px), float(fy_px)
        self.cx_px, self.cy_px = float(cx_px), float(cy_px)
        self.T_body_camera = mounting
        self.T_camera_body = inverse(mounting)
        self._focal_px = np.array([self.fx_px, self.fy_px])
        self._centre_px = np.array([self.cx_px, self.cy_px])

    @property
    def K(self) -> FloatArray:
        """The calibration matrix, (3, 3)."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def parameters(self) -> Mapping[str, Any]:
        return {
            "fx_px": self.fx_px,
            "fy_px": self.fy_px,
            "cx_px": self.cx_px,
            "cy_px": self.cy_px,
            "T_body_camera": self.T_body_camera.tolist(),
        }

    def camera_point(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        """World points (..., 3) in the camera frame [m]; the third component is the depth."""
        return body_point(T_world_body @ self.T_body_camera, landmark)

    def project(self, q: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame; NaN where the depth is not positive."""
        z = q[..., 2:]
        # Where the depth is not positive NaN is divided by: there is nothing to warn of.
        scale = 1.0 / (z if z.size and z.min() > 0 else np.where(z > 0, z, np.nan))
        pixels: FloatArray = q[..., :2] * scale
        pixels *= self._focal_px
        pixels += self._centre_px
        return pixels

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Directions (..., 3) of pixels (..., 2) in the camera frame, with third component 1."""
        rays = np.ones((*pixels.shape[:-1], 3))
        rays[..., 0] = (pixels[..., 0] - self.cx_px) / self.fx_px
        rays[..., 1] = (pixels[..., 1] - self.cy_px) / self.fy_px
        return rays

    def point_at_depth(self, T_world_body: FloatArray, pixels: FloatArray, depth_m: FloatArray) -> FloatArray:
        """World points (..., 3) seen at pixels (..., 2) with depths (...) along the optical axis [m]."""
        q = self.rays(pixels) * np.asarray(depth_m)[..., None]
        return transform(T_world_body @ self.T_body_camera, q)

    def predict(self, T_world_body: FloatArray, landmark: FloatArray) -> FloatArray:
        return self._measure(self.camera_point(T_world_body, landmark))

    def jacobians(self, T_world_body: FloatArray, landmark: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.linearise(T_world_body, landmark)[1:]

    def linearise(
        self, T_world_body: FloatArray, landmark: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        q_body = body_point(T_world_body, landmark)
        predicted, D = self.linearise_in_body(q_body)
        body_by_pose, body_by_landmark = body_point_jacobians(T_world_body, q_body)
        return predicted, D @ body_by_pose, D @ body_by_landmark

    def linearise_in_body(self, q_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """z (..., d) of points (..., 3) in the body frame, and its derivative (..., d, 3) by them."""
        q = transform(self.T_camera_body, q_body)
        return self._measure(q), self._derivative(q) @ self.T_camera_body[:3, :3]

    def residual(self, z: FloatArray, z_predicted: FloatArray) -> FloatArray:
        return z - z_predicted

    @abstractmethod
    def _measure(self, q: FloatArray) -> FloatArray:
        """z (..., d) of points in the camera frame."""

    @abstractmethod
    def _derivative(self, q: FloatArray) -> FloatArray:
        """D (..., d, 3) at points in the camera frame."""

    def _pixel_derivative(self, q: FloatArray) -> FloatArray:
        """Derivative of (u, v) by q, (..., 2, 3)."""
        D = np.zeros((*q.shape[:-1], 2, 3))
        D[..., 0, 0], D[..., 1, 1] = self.fx_px / q[..., 2], self.fy_px / q[..., 2]
        D[..., 0, 2] = -self.fx_px * q[..., 0] / q[..., 2] ** 2
        D[..., 1, 2] = -self.fy_px * q[..., 1] / q[..., 2] ** 2
        return D


@sensors.register("mono_camera")
class MonoCamera(Camera):
    """One image: z = (u, v) in pixels; not invertible, since a pixel is a ray and not a point."""

    name = "mono_camera"
    dim = 2
    components: tuple[str, ...] = ("u_px", "v_px")
    invertible = False

    @cached_property
    def entry_sensor(self) -> StereoCamera:
        """A pair with this camera as its left one and a baseline of 1 m.

        A landmark that several views have placed enters as (u, u - f b / depth, v): its error is nearly
        Gaussian in the disparity, as it is in inverse depth, and not in the depth.
        """
        return StereoCamera(
            fx_px=self.fx_px,
            fy_px=self.fy_px,
            cx_px=self.cx_px,
            cy_px=self.cy_px,
            baseline_m=1.0,
            T_body_camera=self.T_body_camera,
        )

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:  # noqa: ARG002
        """Not possible.

        Raises:
            UsageError: always; ``point_at_depth`` takes the depth that is missing here.
        """
        raise UsageError(
            "mono_camera: one image does not tell the depth, so a pixel cannot be inverted; wait for "
            "parallax and triangulate, or give the depth to point_at_depth"
        )

    def _measure(self, q: FloatArray) -> FloatArray:
        return self.project(q)

    def _derivative(self, q: FloatArray) -> FloatArray:
        return self._pixel_derivative(q)


@sensors.register("stereo_camera")
class StereoCamera(Camera):
    """A rectified pair: z = (u_left, u_right, v) in pixels; the camera frame is the left camera's."""

    name = "stereo_camera"
    dim = 3
    components: tuple[str, ...] = ("u_left_px", "u_right_px", "v_px")
    invertible = True

    def __init__(
        self,
        *,
        fx_px: Positive,
        fy_px: Positive,
        cx_px: float,
        cy_px: float,
        baseline_m: Positive,
        T_body_camera: ArrayLike | None = None,
    ) -> None:
        super().__init__(fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px, T_body_camera=T_body_camera)
        if not baseline_m > 0:
            raise DataError(f"stereo_camera: baseline_m is {baseline_m}; a positive number is needed")
        self.baseline_m = float(baseline_m)

    def parameters(self) -> Mapping[str, Any]:
        return {**super().parameters(), "baseline_m": self.baseline_m}

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:
        """World points (..., 3); NaN where the disparity is not positive."""
        return self.point_at_depth(T_world_body, z[..., [0, 2]], self.depths(z))

    def depths(self, z: FloatArray) -> FloatArray:
        """Depths (...) along the optical axis [m]; NaN where the disparity is not positive."""
        disparity = z[..., 0] - z[..., 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth: FloatArray = np.where(disparity > 0, self.fx_px * self.baseline_m / disparity, np.nan)
        return depth

    def _measure(self, q: FloatArray) -> FloatArray:
        left = self.project(q)
        u_right = left[..., 0] - self.fx_px * self.baseline_m / np.where(q[..., 2] > 0, q[..., 2], np.nan)
        return np.stack([left[..., 0], u_right, left[..., 1]], axis=-1)

    def _derivative(self, q: FloatArray) -> FloatArray:
        left = self._pixel_derivative(q)
        D = left[..., [0, 0, 1], :]
        D[..., 1, 2] += self.fx_px * self.baseline_m / q[..., 2] ** 2
        return D


@sensors.register("rgbd_camera")
class RgbdCamera(Camera):
    """An image with depth: z = (u, v, depth) in pixels and metres along the optical axis."""

    name = "rgbd_camera"
    dim = 3
    components: tuple[str, ...] = ("u_px", "v_px", "depth_m")
    invertible = True

    def invert(self, T_world_body: FloatArray, z: FloatArray) -> FloatArray:
        """World points (..., 3)."""
        return self.point_at_depth(T_world_body, z[..., :2], z[..., 2])

    def _measure(self, q: FloatArray) -> FloatArray:
        depth = np.where(q[..., 2:] > 0, q[..., 2:], np.nan)
        return np.concatenate([self.project(q), depth], axis=-1)

    def _derivative(self, q: FloatArray) -> FloatArray:
        D = np.zeros((*q.shape[:-1], 3, 3))
        D[..., :2, :] = self._pixel_derivative(q)
        D[..., 2, 2] = 1.0
        return D
