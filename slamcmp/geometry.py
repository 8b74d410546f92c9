"""SE(2) and SE(3) as homogeneous matrices, with batch axes in front of every argument.

Tangent vectors are (x, y, theta) for SE(2) and (omega, v) for SE(3), GTSAM's orders; perturbations act on
the right, ``T = T_hat exp(xi)``. Formulas: Solà, Deray and Atchuthan 2018, "A micro Lie theory" (SE(2):
eq. 152-164; SE(3): eq. 169-180), with the SE(3) blocks in (omega, v) order; Barfoot 2017 for Q of eq. 180.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slamcmp.types import FloatArray

_SMALL = 1e-4
"""Below this angle [rad] the trigonometric quotients use their Taylor series (error under 1e-17)."""


def wrap(angle: Any) -> Any:
    """Angle(s) [rad] in (-pi, pi]."""
    return math.pi - np.mod(math.pi - np.asarray(angle), 2.0 * math.pi)


def se2(x: Any, y: Any, theta: Any) -> FloatArray:
    """Poses (..., 3, 3) from position [m] and heading [rad]."""
    x, y, theta = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in (x, y, theta)))
    T = np.zeros((*x.shape, 3, 3))
    cos, sin = np.cos(theta), np.sin(theta)
    T[..., 0, 0] = T[..., 1, 1] = cos
    T[..., 0, 1], T[..., 1, 0] = -sin, sin
    T[..., 0, 2], T[..., 1, 2] = x, y
    T[..., 2, 2] = 1.0
    return T


def se2_coordinates(T: FloatArray) -> FloatArray:
    """(..., 3) of x, y [m] and heading [rad]; the inverse of :func:`se2`."""
    return np.stack([T[..., 0, 2], T[..., 1, 2], heading(T)], axis=-1)


def heading(T: FloatArray) -> FloatArray:
    """Heading of planar poses; for SE(3) the yaw about the world's z axis [rad]."""
    return np.arctan2(T[..., 1, 0], T[..., 0, 0])


def rotation(T: FloatArray) -> FloatArray:
    """(..., n, n), a view."""
    return T[..., :-1, :-1]


def translation(T: FloatArray) -> FloatArray:
    """(..., n) [m], a view."""
    return T[..., :-1, -1]


def pose(R: FloatArray, t: FloatArray) -> FloatArray:
    """Homogeneous matrices (..., n+1, n+1) from rotations (..., n, n) and translations (..., n)."""
    R, t = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    n = t.shape[-1]
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), n + 1, n + 1))
    T[..., :n, :n] = R
    T[..., :n, n] = t
    T[..., n, n] = 1.0
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Inverse of rigid transforms, (..., n+1, n+1)."""
    R_t = np.swapaxes(rotation(T), -1, -2)
    return pose(R_t, -np.einsum("...ij,...j->...i", R_t, translation(T)))


def transform(T: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., n) mapped by T; ``transform(T_world_body, p_body)`` is p_world."""
    moved: FloatArray = np.einsum("...ij,...j->...i", rotation(T), points) + translation(T)
    return moved


def hat(omega: FloatArray) -> FloatArray:
    """(..., 3, 3) with ``hat(a) @ b == cross(a, b)``."""
    omega = np.asarray(omega, dtype=np.float64)
    W = np.zeros((*omega.shape[:-1], 3, 3))
    W[..., 0, 1], W[..., 0, 2], W[..., 1, 2] = -omega[..., 2], omega[..., 1], -omega[..., 0]
    return W - np.swapaxes(W, -1, -2)


def exp(xi: FloatArray) -> FloatArray:
    """Exponential map: (..., 3) to SE(2), (..., 6) to SE(3)."""
    xi = np.asarray(xi, dtype=np.float64)
    if xi.shape == (3,):
        return _se2_exp_single(*xi.tolist())
    if xi.shape[-1] == 3:
        theta = xi[..., 2]
        a, b = _sine_quotients(theta)
        x = a * xi[..., 0] - b * xi[..., 1]
        y = b * xi[..., 0] + a * xi[..., 1]
        return se2(x, y, theta)
    omega, v = xi[..., :3], xi[..., 3:]
    V = so3_left_jacobian(omega)
    return pose(so3_exp(omega), np.einsum("...ij,...j->...i", V, v))


def log(T: FloatArray) -> FloatArray:
    """Logarithm map: SE(2) to (..., 3), SE(3) to (..., 6); angles in (-pi, pi]."""
    T = np.asarray(T, dtype=np.float64)
    if T.shape[-1] == 3:
        theta = heading(T)
        a, b = _sine_quotients(theta)
        scale = 1.0 / (a * a + b * b)
        x, y = T[..., 0, 2], T[..., 1, 2]
        return np.stack([scale * (a * x + b * y), scale * (a * y - b * x), theta], axis=-1)
    omega = so3_log(rotation(T))
    v = np.linalg.solve(so3_left_jacobian(omega), translation(T)[..., None])[..., 0]
    return np.concatenate([omega, v], axis=-1)


def retract(T: FloatArray, xi: FloatArray) -> FloatArray:
    """``T exp(xi)``."""
    return T @ exp(xi)


def retract_in_world_axes(T: FloatArray, xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (..., n+1, n+1) moved by ``p += R v``, ``R = R exp(omega)``, and what that does to their errors.

    The second answer J (..., p, p) takes a body-tangent error at the old pose to the one at the new pose with
    the same world components: with it an error is additive in the world, whatever the pose's attitude.
    """
    if xi.shape == (3,):
        x, y, theta = xi.tolist()
        (cos, minus_sin, p_x), (sin, _, p_y), _ = T.tolist()
        c, s = math.cos(theta), math.sin(theta)
        new_cos, new_sin = cos * c - sin * s, sin * c + cos * s
        moved = [
            [new_cos, -new_sin, p_x + cos * x + minus_sin * y],
            [new_sin, new_cos, p_y + sin * x + cos * y],
            [0.0, 0.0, 1.0],
        ]
        return np.array(moved), np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    planar = xi.shape[-1] == 3
    turn = rotation(se2(0.0, 0.0, xi[..., 2])) if planar else so3_exp(xi[..., :3])
    step = pose(turn, xi[..., :2] if planar else xi[..., 3:])
    return T @ step, _turned_tangent(np.swapaxes(turn, -1, -2))


def change_of_axes(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """(..., p, p): a body-tangent error at ``T_from`` as the one at ``T_to`` with its world components."""
    return _turned_tangent(np.swapaxes(rotation(T_to), -1, -2) @ rotation(T_from))


def local(T: FloatArray, other: FloatArray) -> FloatArray:
    """``log(inverse(T) other)``: the xi with ``retract(T, xi) == other``."""
    return log(inverse(T) @ other)


def adjoint(T: FloatArray) -> FloatArray:
    """(..., p, p) with ``T exp(xi) inverse(T) == exp(adjoint(T) @ xi)``."""
    T = np.asarray(T, dtype=np.float64)
    R, t = rotation(T), translation(T)
    n = T.shape[-1] - 1
    p = 3 if n == 2 else 6
    Ad = np.zeros((*T.shape[:-2], p, p))
    if n == 2:
        Ad[..., :2, :2] = R
        Ad[..., 0, 2], Ad[..., 1, 2] = t[..., 1], -t[..., 0]
        Ad[..., 2, 2] = 1.0
        return Ad
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    Ad[..., 3:, :3] = hat(t) @ R
    return Ad


def adjoint_of_inverse(T: FloatArray) -> FloatArray:
    """``adjoint(inverse(T))``, (..., p, p): carries a pose's error over the increment T that follows it."""
    if T.shape == (3, 3):
        (cos, minus_sin, x), (sin, _, y), _ = T.tolist()
        return np.array(
            [
                [cos, sin, sin * x - cos * y],
                [minus_sin, cos, cos * x + sin * y],
                [0.0, 0.0, 1.0],
            ]
        )
    return adjoint(inverse(T))


def right_jacobian(xi: FloatArray) -> FloatArray:
    """(..., p, p): ``exp(xi + d) ≈ exp(xi) exp(J_r d)`` (Solà 2018, eq. 163 and 179)."""
    xi = np.asarray(xi, dtype=np.float64)
    if xi.shape[-1] == 3:
        return _se2_right_jacobian(xi)
    omega, v = -xi[..., :3], -xi[..., 3:]
    J = np.zeros((*xi.shape[:-1], 6, 6))
    J[..., :3, :3] = J[..., 3:, 3:] = so3_left_jacobian(omega)
    J[..., 3:, :3] = _barfoot_q(omega, v)
    return J


def so3_exp(omega: FloatArray) -> FloatArray:
    """Rodrigues' formula, (..., 3) to (..., 3, 3)."""
    W = hat(omega)
    a, b, _ = _rodrigues_quotients(omega)
    return np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W)


def so3_log(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), angle in [0, pi]; exact near 0 and near pi (through the quaternion)."""
    q = quaternion(R)
    w, v = q[..., 3], q[..., :3]
    norm = np.linalg.norm(v, axis=-1)
    angle = 2.0 * np.arctan2(norm, w)
    safe = np.where(norm > 1e-12, norm, 1.0)
    return np.where(norm > 1e-12, angle / safe, 2.0)[..., None] * v


def so3_left_jacobian(omega: FloatArray) -> FloatArray:
    """(..., 3, 3), Solà 2018 eq. 145."""
    W = hat(omega)
    _, b, c = _rodrigues_quotients(omega)
    return np.eye(3) + b[..., None, None] * W + c[..., None, None] * (W @ W)


def quaternion(R: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) as (x, y, z, w) with w >= 0, by the best-conditioned of four formulas."""
    R = np.asarray(R, dtype=np.float64)
    m = [[R[..., i, j] for j in range(3)] for i in range(3)]
    # Bar-Itzhack's symmetric 4x4: each row is the quaternion times one of its own components, so the row
    # with the largest diagonal entry loses nothing to cancellation.
    K = np.empty((*R.shape[:-2], 4, 4))
    K[..., 0, 0] = 1 + m[0][0] - m[1][1] - m[2][2]
    K[..., 1, 1] = 1 - m[0][0] + m[1][1] - m[2][2]
    K[..., 2, 2] = 1 - m[0][0] - m[1][1] + m[2][2]
    K[..., 3, 3] = 1 + m[0][0] + m[1][1] + m[2][2]
    K[..., 0, 1] = K[..., 1, 0] = m[0][1] + m[1][0]
    K[..., 0, 2] = K[..., 2, 0] = m[0][2] + m[2][0]
    K[..., 1, 2] = K[..., 2, 1] = m[1][2] + m[2][1]
    K[..., 0, 3] = K[..., 3, 0] = m[2][1] - m[1][2]
    K[..., 1, 3] = K[..., 3, 1] = m[0][2] - m[2][0]
    K[..., 2, 3] = K[..., 3, 2] = m[1][0] - m[0][1]
    best = np.argmax(np.diagonal(K, axis1=-2, axis2=-1), axis=-1)
    q: FloatArray = np.take_along_axis(K, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def rotation_from_quaternion(q: FloatArray) -> FloatArray:
    """(..., 3, 3) from (x, y, z, w), which is normalised first."""
    q = np.asarray(q, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    v, w = q[..., :3], q[..., 3]
    W = hat(v)
    return np.eye(3) + 2.0 * w[..., None, None] * W + 2.0 * (W @ W)


def dead_reckoning(T_world_body: FloatArray, T_prev_body: FloatArray) -> FloatArray:
    """Chain increments (K, n+1, n+1) onto a first pose; increment 0 is ignored (it is the identity)."""
    poses = np.empty_like(T_prev_body)
    poses[0] = T_world_body
    for k in range(1, len(poses)):
        poses[k] = poses[k - 1] @ T_prev_body[k]
    return poses


def _se2_exp_single(x: float, y: float, theta: float) -> FloatArray:
    """:func:`exp` for one planar vector: plain floats are ten times faster than arrays of one element."""
    if abs(theta) < _SMALL:
        a, b = 1.0 - theta * theta / 6.0, theta * (0.5 - theta * theta / 24.0)
    else:
        a, b = math.sin(theta) / theta, 2.0 * math.sin(0.5 * theta) ** 2 / theta
    cos, sin = math.cos(theta), math.sin(theta)
    return np.array([[cos, -sin, a * x - b * y], [sin, cos, b * x + a * y], [0.0, 0.0, 1.0]])


def _turned_tangent(R: FloatArray) -> FloatArray:
    """(..., p, p): what a rotation (..., n, n) of the axes does to the two parts of a tangent vector."""
    n = R.shape[-1]
    p = 3 if n == 2 else 6
    J = np.zeros((*R.shape[:-2], p, p))
    J[..., :n, :n] = R
    if n == 2:
        J[..., 2, 2] = 1.0
    else:
        J[..., 3:, 3:] = R
    return J


def _sine_quotients(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(theta)/theta and (1 - cos(theta))/theta."""
    small = np.abs(theta) < _SMALL
    safe = np.where(small, 1.0, theta)
    squared = theta * theta
    a = np.where(small, 1.0 - squared / 6.0, np.sin(safe) / safe)
    b = np.where(small, theta * (0.5 - squared / 24.0), 2.0 * np.sin(0.5 * safe) ** 2 / safe)
    return a, b


def _rodrigues_quotients(omega: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sin t / t, (1 - cos t) / t², (t - sin t) / t³ for t = |omega|."""
    t = np.linalg.norm(np.asarray(omega, dtype=np.float64), axis=-1)
    squared = t * t
    small = t < 1e-2
    safe = np.where(small, 1.0, t)
    a = 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42))
    b = 0.5 - squared / 24 * (1 - squared / 30 * (1 - squared / 56))
    c = 1 / 6 - squared / 120 * (1 - squared / 42 * (1 - squared / 72))
    return (
        np.where(small, a, np.sin(safe) / safe),
        np.where(small, b, 2 * np.sin(safe / 2) ** 2 / safe**2),
        np.where(small, c, (safe - np.sin(safe)) / safe**3),
    )


def _se2_right_jacobian(xi: FloatArray) -> FloatArray:
    theta = xi[..., 2]
    a, b = _sine_quotients(theta)
    # c = (t - sin t)/t² and d = (1 - cos t)/t², from the SO(3) quotients of the same angle.
    axis = np.stack([theta * 0, theta * 0, theta], axis=-1)
    _, d, c_over_t = _rodrigues_quotients(axis)
    c = theta * c_over_t
    J = np.zeros((*xi.shape[:-1], 3, 3))
    J[..., 0, 0] = J[..., 1, 1] = a
    J[..., 0, 1], J[..., 1, 0] = b, -b
    J[..., 0, 2] = c * xi[..., 0] - d * xi[..., 1]
    J[..., 1, 2] = d * xi[..., 0] + c * xi[..., 1]
    J[..., 2, 2] = 1.0
    return J


def _barfoot_q(omega: FloatArray, v: FloatArray) -> FloatArray:
    """Coupling block of the SE(3) left Jacobian (Barfoot 2017, eq. 7.86; Solà 2018, eq. 180)."""
    W, V = hat(omega), hat(v)
    t = np.linalg.norm(omega, axis=-1)[..., None, None]
    small = t < 1e-1
    safe = np.where(small, 1.0, t)
    s = t * t
    _, _, c = _rodrigues_quotients(omega)
    c1 = c[..., None, None]
    # (t² + 2 cos t - 2) / (2 t⁴) and (2 t - 3 sin t + t cos t) / (2 t⁵); series where they would cancel.
    c2 = np.where(
        small,
        1 / 24 - s / 720 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132))),
        (safe**2 + 2 * np.cos(safe) - 2) / (2 * safe**4),
    )
    c3 = np.where(
        small,
        1 / 120 - s / 2520 * (1 - s * (3 / 144) * (1 - s * (4 / 330))),
        (2 * safe - 3 * np.sin(safe) + safe * np.cos(safe)) / (2 * safe**5),
    )
    WV, VW = W @ V, V @ W
    WVW = WV @ W
    Q: FloatArray = (
        0.5 * V + c1 * (WV + VW + WVW) + c2 * (W @ WV + VW @ W - 3.0 * WVW) + c3 * (WVW @ W + W @ WVW)
    )
    return Q
