"""Place a point seen from several views whose relative poses odometry tells with a known error.

The unknown is what the entry sensor would measure now, (u, u_right, v) of a pair with a baseline of 1 m:
pixel and disparity, in which the error is nearly Gaussian, as in inverse depth (Montiel, Civera and Davison
2006). Gauss-Newton weighs the pixels by their own noise and by the odometry's, which all views before an
increment share.

========  ===============================================================================
symbol    meaning
========  ===============================================================================
m, V      tracks, and views of a track; the last one is the present image
T_view    present body frame to a view's body frame, (F, 4, 4); F frames back, present first
S         covariance (F, 6, 6) of its right perturbation: what odometry lost since that view
w         (x / z, y / z, 1 / z) of the point in the present camera frame, (m, 3)
H, G      derivative of a view's (x / z, y / z) by w (m, V, 2, 3) and by that perturbation (m, V, 2, 6)
========  ===============================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.geometry import adjoint, inverse
from slamcmp.models.camera import Camera
from slamcmp.types import BoolArray, FloatArray, IntArray

_STEPS = 4
_RIDGE = 1e-12
"""Keeps a point without any parallax solvable; its covariance then says that it is not placed."""


@dataclass(frozen=True)
class Triangulation:
    """Placed points in the present frame."""

    z: FloatArray
    """(m, 3), to be read by the camera's entry sensor."""
    R: FloatArray
    """(m, 3, 3)."""
    misfit: FloatArray
    """Squared Mahalanobis distance of the pixels from one point, (m,); chi-square distributed."""
    dof: IntArray
    """2 · views - 3, (m,)."""
    in_front: BoolArray
    """Whether every view has the point before its camera."""


class PoseHistory:
    """Poses of the last views relative to the present body frame, with the odometry's growing doubt."""

    def __init__(self, length: int) -> None:
        self._length = length
        self.T_view = np.empty((0, 4, 4))
        self.S = np.empty((0, 6, 6))
        self._of_camera: Camera | None = None
        self._motion = self.T_view

    def advance(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Move on by one increment and make the new present frame entry 0."""
        A = adjoint(inverse(T_prev_body))
        # T_view exp(xi) T exp(eta) = T_view T exp(Ad(T⁻¹) xi + eta): older views add the same increments.
        S = A @ self.S @ A.T + Q
        self.T_view = np.concatenate([np.eye(4)[None], self.T_view @ T_prev_body])[: self._length]
        self.S = np.concatenate([np.zeros((1, 6, 6)), S])[: self._length]
        self._of_camera = None

    def camera_motion(self, camera: Camera) -> FloatArray:
        """From the present camera frame to a view's camera frame, (F, 4, 4); made once a frame."""
        if self._of_camera is not camera:
            self._motion = camera.T_camera_body @ self.T_view @ camera.T_body_camera
            self._of_camera = camera
        return self._motion


def parallax_deg(
    camera: Camera, history: PoseHistory, now: FloatArray, then: FloatArray, back: IntArray
) -> FloatArray:
    """Angles (m,) between the rays of pixels ``now`` (m, 2) and ``then`` (m, 2), ``back`` frames ago."""
    R = history.camera_motion(camera)[back, :3, :3]
    here, there = camera.rays(now), (camera.rays(then)[:, None, :] @ R)[:, 0]
    cosine = (here * there).sum(axis=1)
    cosine /= np.linalg.norm(here, axis=1) * np.linalg.norm(there, axis=1)
    angles: FloatArray = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return angles


def triangulate(
    camera: Camera,
    history: PoseHistory,
    pixels: FloatArray,
    back: IntArray,
    used: BoolArray,
    *,
    sigma_px: float,
    baseline_m: float = 1.0,
) -> Triangulation:
    """Points from pixels (m, V, 2) seen ``back`` (m, V) frames ago, where ``used`` (m, V).

    A track's views stand in the order of time, unused ones anywhere. The last one is the present one:
    ``back`` is 0 there, and it is used.
    """
    motion = history.camera_motion(camera)[back]
    # A view without a pixel keeps its place in the arrays and loses its weight: all its derivatives are 0.
    views_of = _Views(camera, motion, (camera.T_camera_body @ history.T_view)[back, :3, :3], used)
    S = history.S[back]
    seen = camera.rays(pixels)[..., :2]
    count, views = used.shape
    row = np.arange(2 * views)
    earlier = row[:, None] // 2 <= row // 2
    busy = np.repeat(used, 2, axis=1)
    pixel_variances = np.tile((sigma_px / np.array([camera.fx_px, camera.fy_px])) ** 2, views)
    variances = np.where(busy, pixel_variances, 1.0)
    w = np.concatenate([seen[:, -1], _inverse_depth(motion, seen, used)[:, None]], axis=1)
    H_and_y, ridge = np.empty((count, 2 * views, 4)), _RIDGE * np.eye(3)
    H, y = H_and_y[..., :3], H_and_y[..., 3]
    for _ in range(_STEPS):
        predicted, by_w, G, depth = views_of.linearised(w)
        H_and_y[..., :3] = by_w.reshape(H.shape)
        np.subtract(seen, predicted, out=predicted)
        np.multiply(predicted.reshape(y.shape), busy, out=y)
        # Two views share the increments after the later one, so its S stands between their derivatives.
        G_all = G.reshape(count, 2 * views, 6)
        covariance = G_all @ (G @ S).reshape(G_all.shape).mT
        covariance = np.where(earlier, covariance, covariance.mT)
        covariance[:, row, row] += variances
        weighted = np.linalg.solve(covariance, H_and_y)
        information = H.mT @ weighted[..., :3] + ridge
        w = w + np.linalg.solve(information, H.mT @ weighted[..., 3:])[..., 0]
    misfit = (y * weighted[..., 3]).sum(axis=1)
    to_z = np.array(
        [[camera.fx_px, 0.0, 0.0], [camera.fx_px, 0.0, -camera.fx_px * baseline_m], [0.0, camera.fy_px, 0.0]]
    )
    z = w @ to_z.T + [camera.cx_px, camera.cx_px, camera.cy_px]
    R = to_z @ np.linalg.inv(information) @ to_z.T
    in_front = ((depth > 0) | ~used).all(axis=1) & (w[:, 2] > 0)
    return Triangulation(z, 0.5 * (R + R.mT), misfit, 2 * used.sum(axis=1) - 3, np.asarray(in_front))


def _inverse_depth(motion: FloatArray, seen: FloatArray, used: BoolArray) -> FloatArray:
    """Least squares on (R r + t / depth) × (x, y, 1) = 0 for the ray r of the present pixel, (m,)."""
    ray = np.concatenate([seen[:, -1], np.ones((len(seen), 1))], axis=1)
    turned = (motion[..., :3, :3] @ ray[:, None, :, None])[..., 0]
    t = motion[..., :3, 3]
    a = t[..., :2] - seen * t[..., 2:]
    b = seen * turned[..., 2:] - turned[..., :2]
    weight = used[..., None]
    answer: FloatArray = (a * b * weight).sum(axis=(1, 2)) / ((a * a * weight).sum(axis=(1, 2)) + 1e-12)
    return answer


class _Views:
    """What the views of some tracks (m, V) see of points, with all that does not depend on the points.

    Args:
        camera: of all views.
        motion: from the present camera frame to a view's camera frame, (m, V, 4, 4).
        body_motion: the rotation from the present body frame to a view's camera frame, (m, V, 3, 3).
        used: which views count, (m, V); the derivatives of the others are 0.
    """

    def __init__(self, camera: Camera, motion: FloatArray, body_motion: FloatArray, used: BoolArray) -> None:
        self._by_w, self._at_z = motion[..., :3, [0, 1, 3]], motion[..., :3, 2]
        self._by_both = np.concatenate([self._by_w, body_motion], axis=-1)
        self._R_body_camera, self._t_body_camera = camera.T_body_camera[:3, :3], camera.T_body_camera[:3, 3]
        self._used = used
        self._ray = np.ones((len(motion), 3))
        self._by_perturbation = np.zeros((len(motion), 3, 6))

    def linearised(self, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Where the views should see w: (x / z, y / z), H, G, and the depth as a share of the present one.

        All points are scaled by the inverse depth, so that one at infinity is no exception.
        """
        q = (self._by_w @ w[:, None, :, None])[..., 0] + self._at_z
        depth = np.where(np.abs(q[..., 2]) > 1e-6, q[..., 2], 1e-6)
        predicted = q[..., :2] / depth[..., None]
        self._ray[:, :2] = w[:, :2]
        x, y, z = (self._ray @ self._R_body_camera.T + w[:, 2:] * self._t_body_camera).T
        # Minus the hat of the point in the body, and its inverse depth.
        P = self._by_perturbation
        P[:, 0, 1], P[:, 1, 2], P[:, 2, 0] = z, x, y
        P[:, 1, 0], P[:, 2, 1], P[:, 0, 2] = -z, -x, -y
        P[:, 0, 3] = P[:, 1, 4] = P[:, 2, 5] = w[:, 2]
        # d(x / z) = (dx - (x / z) dz) / z, for both at once.
        projected = self._by_both[..., :2, :] - predicted[..., None] * self._by_both[..., 2:, :]
        projected /= np.where(self._used, depth, np.inf)[..., None, None]
        return predicted, projected[..., :3], projected[..., 3:] @ P[:, None], depth
