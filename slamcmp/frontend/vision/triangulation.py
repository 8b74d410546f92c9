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

from slamcmp.geometry import adjoint, hat, inverse
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

    def advance(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Move on by one increment and make the new present frame entry 0."""
        A = adjoint(inverse(T_prev_body))
        # T_view exp(xi) T exp(eta) = T_view T exp(Ad(T⁻¹) xi + eta): older views add the same increments.
        S = A @ self.S @ A.T + Q
        self.T_view = np.concatenate([np.eye(4)[None], self.T_view @ T_prev_body])[: self._length]
        self.S = np.concatenate([np.zeros((1, 6, 6)), S])[: self._length]


def parallax_deg(
    camera: Camera, history: PoseHistory, now: FloatArray, then: FloatArray, back: IntArray
) -> FloatArray:
    """Angles (m,) between the rays of pixels ``now`` (m, 2) and ``then`` (m, 2), ``back`` frames ago."""
    R = _camera_motion(camera, history)[back, :3, :3]
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
    motion = _camera_motion(camera, history)[back]
    body_motion = (camera.T_camera_body @ history.T_view)[back, :3, :3]
    S = history.S[back]
    seen = camera.rays(pixels)[..., :2]
    count, views = used.shape
    row = np.arange(2 * views)
    earlier = row[:, None] // 2 <= row // 2
    pixel_noise = np.diag(np.tile((sigma_px / np.array([camera.fx_px, camera.fy_px])) ** 2, views))
    # A view without a pixel keeps its place in the arrays and loses its weight.
    busy = np.repeat(used, 2, axis=1)
    both_busy, without = busy[:, :, None] & busy[:, None, :], ~busy[:, :, None] * np.eye(2 * views)
    w = np.concatenate([seen[:, -1], _inverse_depth(motion, seen, used)[:, None]], axis=1)
    for _ in range(_STEPS):
        predicted, H, G, depth = _linearised(camera, motion, body_motion, w)
        # Two views share the increments after the later one, so its S stands between their derivatives.
        G_all = G.reshape(count, 2 * views, 6)
        covariance = G_all @ np.swapaxes((G @ S).reshape(G_all.shape), 1, 2)
        covariance = np.where(earlier, covariance, np.swapaxes(covariance, 1, 2))
        covariance = np.where(both_busy, covariance + pixel_noise, without)
        H = np.where(used[..., None, None], H, 0.0).reshape(count, 2 * views, 3)
        y = np.where(used[..., None], seen - predicted, 0.0).reshape(count, 2 * views, 1)
        weighted = np.linalg.solve(covariance, np.concatenate([H, y], axis=2))
        information = np.swapaxes(H, 1, 2) @ weighted[..., :3] + _RIDGE * np.eye(3)
        w = w + np.linalg.solve(information, np.swapaxes(H, 1, 2) @ weighted[..., 3:])[..., 0]
    misfit = (y * weighted[..., 3:]).sum(axis=(1, 2))
    to_z = np.array(
        [[camera.fx_px, 0.0, 0.0], [camera.fx_px, 0.0, -camera.fx_px * baseline_m], [0.0, camera.fy_px, 0.0]]
    )
    z = w @ to_z.T + [camera.cx_px, camera.cx_px, camera.cy_px]
    R = to_z @ np.linalg.inv(information) @ to_z.T
    in_front = ((depth > 0) | ~used).all(axis=1) & (w[:, 2] > 0)
    return Triangulation(
        z, 0.5 * (R + np.swapaxes(R, 1, 2)), misfit, 2 * used.sum(axis=1) - 3, np.asarray(in_front)
    )


def _camera_motion(camera: Camera, history: PoseHistory) -> FloatArray:
    """From the present camera frame to a view's camera frame, (F, 4, 4)."""
    motion: FloatArray = camera.T_camera_body @ history.T_view @ camera.T_body_camera
    return motion


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


def _linearised(
    camera: Camera, motion: FloatArray, body_motion: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where the views should see w: (x / z, y / z), H, G, and the depth there as a share of the present one.

    All points are scaled by the inverse depth, so that one at infinity is no exception.
    """
    by_w = motion[..., :3, [0, 1, 3]]
    q = (by_w @ w[:, None, :, None])[..., 0] + motion[..., :3, 2]
    depth = np.where(np.abs(q[..., 2]) > 1e-6, q[..., 2], 1e-6)
    predicted = q[..., :2] / depth[..., None]
    ray = np.concatenate([w[:, :2], np.ones((len(w), 1))], axis=1)
    in_body = ray @ camera.T_body_camera[:3, :3].T + w[:, 2:] * camera.T_body_camera[:3, 3]
    by_perturbation = np.zeros((len(w), 3, 6))
    by_perturbation[..., :3] = -hat(in_body)
    by_perturbation[..., range(3), range(3, 6)] = w[:, 2:]
    # d(x / z) = (dx - (x / z) dz) / z, for both at once.
    by_both = np.concatenate([by_w, body_motion], axis=-1)
    projected = by_both[..., :2, :] - predicted[..., None] * by_both[..., 2:, :]
    projected /= depth[..., None, None]
    return predicted, projected[..., :3], projected[..., 3:] @ by_perturbation[:, None], depth
