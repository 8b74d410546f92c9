"""EKF-SLAM in the plane as plain loops, compiled: what ekf_slam.py says in numpy, one frame or all at once.

P keeps both triangles: rows are columns then, every inner loop runs along a row, and ``P -= W^T W`` stays
exactly symmetric because both triangles sum the same products in the same order.

========  =====================================================================
symbol    meaning (those of ekf_slam.py)
========  =====================================================================
T         mean of the pose, T_world_body (3, 3), changed in place
P         buffer of the joint covariance, of which the first n rows and columns count
A         Ad(T_prev_body^-1), and after a correction the turn J into the new body axes
z, y      measurement and innovation
H, R, S   Jacobian without its zero columns, measurement noise, innovation covariance
L, W, e   S = L L^T, W = L^-1 H P (k, n), e = L^-1 y
G, N      new landmarks' derivative by the pose, and their own noise
========  =====================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba as nb
import numpy as np

from slamcmp.types import FloatArray, IntArray

Function = TypeVar("Function", bound=Callable[..., Any])

_TURN = 2.0 * math.pi
_SMALL = 1e-4
"""Below this angle [rad] the quotients of the exponential use their series, as in slamcmp.geometry."""

# Frames are read-only and may be strided: one signature that takes them all is one compilation.
_given = [nb.types.Array(nb.float64, dimensions, "A", readonly=True) for dimensions in range(4)]
_numbers = nb.types.Array(nb.int64, 1, "A", readonly=True)
_own = {dimensions: nb.types.Array(nb.float64, dimensions, "C") for dimensions in (1, 2, 3)}


def compiled(*signature: Any) -> Callable[[Function], Function]:
    """numba's njit with IEEE division, cached on disk where numba finds a place to write."""

    def compile_function(function: Function) -> Function:
        try:
            made: Function = nb.njit(*signature, cache=True, error_model="numpy")(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            made = nb.njit(*signature, error_model="numpy")(function)
        return made

    return compile_function


@compiled()
def _predict(T: FloatArray, P: FloatArray, n: int, T_prev_body: FloatArray, Q: FloatArray) -> None:
    c, s, x, y = T_prev_body[0, 0], T_prev_body[1, 0], T_prev_body[0, 2], T_prev_body[1, 2]
    _turn_and_move(T, c, s, x, y)
    _propagate(P, n, c, s, s * x - c * y, c * x + s * y)
    for i in range(3):
        for j in range(3):
            P[i, j] += 0.5 * (Q[i, j] + Q[j, i])


@compiled()
def _turn_and_move(T: FloatArray, c: float, s: float, x: float, y: float) -> None:
    """T times the increment of cosine, sine and translation given, in place."""
    for i in range(2):
        a, b = T[i, 0], T[i, 1]
        T[i, 0] = a * c + b * s
        T[i, 1] = b * c - a * s
        T[i, 2] += a * x + b * y


@compiled()
def _propagate(P: FloatArray, n: int, c: float, s: float, u: float, v: float) -> None:
    """A = [[c, s, u], [-s, c, v], [0, 0, 1]] applied to the pose's rows and columns."""
    for j in range(n):
        a, b, d = P[0, j], P[1, j], P[2, j]
        P[0, j] = c * a + s * b + u * d
        P[1, j] = c * b - s * a + v * d
    for i in range(3):
        a, b, d = P[i, 0], P[i, 1], P[i, 2]
        P[i, 0] = c * a + s * b + u * d
        P[i, 1] = c * b - s * a + v * d
    for i in range(3):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    for j in range(3, n):
        P[j, 0], P[j, 1], P[j, 2] = P[0, j], P[1, j], P[2, j]


@compiled()
def _linearise(
    T: FloatArray, lx: float, ly: float, polar: bool, H_pose: FloatArray, H_land: FloatArray
) -> tuple[float, float]:
    """Fill in one landmark's H_pose (2, 3) and H_land (2, 2), and tell its predicted measurement."""
    dx, dy = lx - T[0, 2], ly - T[1, 2]
    x, y = T[0, 0] * dx + T[1, 0] * dy, T[0, 1] * dx + T[1, 1] * dy
    if polar:
        r2 = x * x + y * y
        r = math.sqrt(r2)
        a, b, c, d = x / r, y / r, -y / r2, x / r2
        H_pose[0, 2], H_pose[1, 2] = 0.0, -1.0
        z0, z1 = math.hypot(x, y), math.atan2(y, x)
    else:
        a, b, c, d = 1.0, 0.0, 0.0, 1.0
        H_pose[0, 2], H_pose[1, 2] = y, -x
        z0, z1 = x, y
    H_pose[0, 0], H_pose[0, 1], H_pose[1, 0], H_pose[1, 1] = -a, -b, -c, -d
    H_land[0, 0], H_land[0, 1] = a * T[0, 0] + b * T[0, 1], a * T[1, 0] + b * T[1, 1]
    H_land[1, 0], H_land[1, 1] = c * T[0, 0] + d * T[0, 1], c * T[1, 0] + d * T[1, 1]
    return z0, z1


@compiled()
def _augment(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    number: int,
    z: FloatArray,
    R: FloatArray,
    polar: bool,
) -> None:
    """One new landmark at its inverse observation, with its correlation to everything before it."""
    x, y = z[0], z[1]
    if polar:
        x, y = z[0] * math.cos(z[1]), z[0] * math.sin(z[1])
    lx, ly = T[0, 0] * x + T[0, 1] * y + T[0, 2], T[1, 0] * x + T[1, 1] * y + T[1, 2]
    landmarks[number, 0], landmarks[number, 1] = lx, ly
    H_pose, H_land = np.empty((2, 3)), np.empty((2, 2))
    _linearise(T, lx, ly, polar, H_pose, H_land)
    determinant = H_land[0, 0] * H_land[1, 1] - H_land[0, 1] * H_land[1, 0]
    a, b = H_land[1, 1] / determinant, -H_land[0, 1] / determinant
    c, d = -H_land[1, 0] / determinant, H_land[0, 0] / determinant
    G = np.empty((2, 3))
    for j in range(3):
        G[0, j] = -(a * H_pose[0, j] + b * H_pose[1, j])
        G[1, j] = -(c * H_pose[0, j] + d * H_pose[1, j])
    s = 3 + 2 * number
    for i in range(2):
        for j in range(s):
            P[s + i, j] = P[j, s + i] = G[i, 0] * P[0, j] + G[i, 1] * P[1, j] + G[i, 2] * P[2, j]
    r00, r01, r11 = R[0, 0], R[0, 1], R[1, 1]
    N00 = a * (a * r00 + b * r01) + b * (a * r01 + b * r11)
    N01 = c * (a * r00 + b * r01) + d * (a * r01 + b * r11)
    N11 = c * (c * r00 + d * r01) + d * (c * r01 + d * r11)
    P[s, s] = P[s, 0] * G[0, 0] + P[s, 1] * G[0, 1] + P[s, 2] * G[0, 2] + N00
    P[s + 1, s] = P[s + 1, 0] * G[0, 0] + P[s + 1, 1] * G[0, 1] + P[s + 1, 2] * G[0, 2] + N01
    P[s, s + 1] = P[s + 1, s]
    P[s + 1, s + 1] = P[s + 1, 0] * G[1, 0] + P[s + 1, 1] * G[1, 1] + P[s + 1, 2] * G[1, 2] + N11


@compiled()
def _move_pose(T: FloatArray, P: FloatArray, n: int, dx: FloatArray, in_world_axes: bool) -> None:
    """The pose's part of a correction, in the error state chosen."""
    x, y, theta = dx[0], dx[1], dx[2]
    c, s = math.cos(theta), math.sin(theta)
    if in_world_axes:
        _turn_and_move(T, c, s, x, y)
        _propagate(P, n, c, s, 0.0, 0.0)
        return
    if abs(theta) < _SMALL:
        a, b = 1.0 - theta * theta / 6.0, theta * (0.5 - theta * theta / 24.0)
    else:
        a, b = s / theta, 2.0 * math.sin(0.5 * theta) ** 2 / theta
    _turn_and_move(T, c, s, a * x - b * y, b * x + a * y)


@compiled()
def _correct(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    count: int,
    known: int,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    polar: bool,
    in_world_axes: bool,
) -> tuple[float, int]:
    """One update with the observations of the first ``known`` landmarks of ``count``; NIS and its dof.

    The NIS is NaN, and the state left as it was, where S is not positive definite or y not finite.
    """
    seen = np.flatnonzero(numbers < known)
    n, k = 3 + 2 * count, 2 * seen.size
    H_pose, H_land = np.empty((k, 3)), np.empty((k, 2))
    W, S, e = np.empty((k, n)), np.empty((k, k)), np.empty(k)
    for m in range(seen.size):
        i = seen[m]
        lx, ly = landmarks[numbers[i], 0], landmarks[numbers[i], 1]
        rows = slice(2 * m, 2 * m + 2)
        z0, z1 = _linearise(T, lx, ly, polar, H_pose[rows], H_land[rows])
        e[2 * m], e[2 * m + 1] = z[i, 0] - z0, z[i, 1] - z1
        if polar:
            e[2 * m + 1] -= _TURN * np.rint(e[2 * m + 1] * (1.0 / _TURN))
        s = 3 + 2 * numbers[i]
        for a in range(2 * m, 2 * m + 2):
            h0, h1, h2 = H_pose[a, 0], H_pose[a, 1], H_pose[a, 2]
            h3, h4 = H_land[a, 0], H_land[a, 1]
            for j in range(n):
                W[a, j] = h0 * P[0, j] + h1 * P[1, j] + h2 * P[2, j] + h3 * P[s, j] + h4 * P[s + 1, j]
    for m in range(seen.size):
        s = 3 + 2 * numbers[seen[m]]
        for b in range(2 * m, 2 * m + 2):
            for a in range(b, k):
                S[a, b] = (
                    W[a, 0] * H_pose[b, 0]
                    + W[a, 1] * H_pose[b, 1]
                    + W[a, 2] * H_pose[b, 2]
                    + W[a, s] * H_land[b, 0]
                    + W[a, s + 1] * H_land[b, 1]
                )
            for a in range(b, 2 * m + 2):
                S[a, b] += R[seen[m], a - 2 * m, b - 2 * m]
    # Cholesky's factor in place of S, and L^-1 applied to e and to the rows of W on the way.
    nis = 0.0
    for a in range(k):
        for b in range(a + 1):
            for c in range(b):
                S[a, b] -= S[a, c] * S[b, c]
            if b < a:
                S[a, b] /= S[b, b]
        if not S[a, a] > 0.0:
            return np.nan, k
        S[a, a] = math.sqrt(S[a, a])
        for b in range(a):
            e[a] -= S[a, b] * e[b]
        e[a] /= S[a, a]
        nis += e[a] * e[a]
    if not math.isfinite(nis):
        return np.nan, k
    dx = np.zeros(n)
    for a in range(k):
        for b in range(a):
            factor = S[a, b]
            for j in range(n):
                W[a, j] -= factor * W[b, j]
        factor = 1.0 / S[a, a]
        for j in range(n):
            W[a, j] *= factor
            dx[j] += e[a] * W[a, j]
    for i in range(n):
        # Two rows of W at a time: a measurement has two components, and P is read and written half as often.
        for a in range(0, k, 2):
            w0, w1 = W[a, i], W[a + 1, i]
            for j in range(n):
                P[i, j] -= w0 * W[a, j] + w1 * W[a + 1, j]
    _move_pose(T, P, n, dx, in_world_axes)
    for number in range(count):
        landmarks[number, 0] += dx[3 + 2 * number]
        landmarks[number, 1] += dx[4 + 2 * number]
    return nis, k


@compiled()
def _augment_new(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    known: int,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    polar: bool,
) -> None:
    for i in range(numbers.size):
        if numbers[i] >= known:
            _augment(T, P, landmarks, numbers[i], z[i], R[i], polar)


_SETTINGS = (nb.boolean, nb.boolean, nb.boolean)
_STATE = (_own[2], _own[2], _own[2], nb.int64)


@compiled(
    nb.types.Tuple((nb.float64, nb.int64))(
        *_STATE, _given[2], _given[2], _numbers, _given[2], _given[3], *_SETTINGS
    )
)
def step(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    known: int,
    T_prev_body: FloatArray,
    Q: FloatArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    polar: bool,
    in_world_axes: bool,
    join_first: bool,
) -> tuple[float, int]:
    """One frame; T, P and landmarks are changed in place. Returns NIS (NaN: diverged) and its dof.

    Args:
        T, P, landmarks: the state, (3, 3), (N, N) and (L, 2), with room for the frame's new landmarks.
        known: landmarks in the state.
        numbers: places of the observed landmarks in the state, (m,); ``known`` and on for new ones, in order.
        polar: range and bearing, otherwise relative positions.
        in_world_axes: the pose's error is additive in the world, otherwise in the body tangent.
        join_first: new landmarks join before the update, otherwise after it.
    """
    _predict(T, P, 3 + 2 * known, T_prev_body, Q)
    new = int(np.count_nonzero(numbers >= known))
    nis, dof = 0.0, 0
    if new and join_first:
        _augment_new(T, P, landmarks, known, numbers, z, R, polar)
    if new < numbers.size:
        count = known + new if join_first else known
        nis, dof = _correct(T, P, landmarks, count, known, numbers, z, R, polar, in_world_axes)
    if new and not join_first:
        _augment_new(T, P, landmarks, known, numbers, z, R, polar)
    return nis, dof


@compiled(
    nb.int64(
        *_STATE,
        _given[3],
        _given[3],
        _numbers,
        _numbers,
        _given[2],
        _given[3],
        *_SETTINGS,
        _own[3],
        _own[3],
        _own[1],
        nb.types.Array(nb.int64, 1, "C"),
    )
)
def run(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    known: int,
    T_prev_body: FloatArray,
    Q: FloatArray,
    starts: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    polar: bool,
    in_world_axes: bool,
    join_first: bool,
    poses: FloatArray,
    covariances: FloatArray,
    nis: FloatArray,
    dof: IntArray,
) -> int:
    """Frames one after the other, observations ``starts[k]`` to ``starts[k + 1]`` being those of frame k.

    Fills in what is known after each frame: poses (K, 3, 3), covariances (K, 3, 3), nis (K,) and dof (K,).
    Returns the number of frames done; fewer than K where the filter diverged.
    """
    for k in range(len(T_prev_body)):
        seen = slice(starts[k], starts[k + 1])
        nis[k], dof[k] = step(
            T,
            P,
            landmarks,
            known,
            T_prev_body[k],
            Q[k],
            numbers[seen],
            z[seen],
            R[seen],
            polar,
            in_world_axes,
            join_first,
        )
        if not math.isfinite(nis[k]):
            return k
        for i in range(starts[k], starts[k + 1]):
            known = max(known, numbers[i] + 1)
        poses[k] = T
        covariances[k] = P[:3, :3]
    return len(T_prev_body)
