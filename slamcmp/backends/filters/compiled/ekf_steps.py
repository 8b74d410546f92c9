"""A frame's steps of EKF-SLAM in the plane, compiled: what ekf_slam.py and error_state_ekf.py say in numpy.

In every planar chart (charts.py) and with every policy of linearisation (linearisation.py, far_points.py).

========  =====================================================================
symbol    meaning (those of error_state_ekf.py)
========  =====================================================================
T         mean of the pose, T_world_body (3, 3), changed in place
P         the joint covariance, see covariance_kernel.py
z, y      measurement and innovation
H, R      Jacobian in the chart, measurement noise
G, N      new landmarks' derivative by the pose's error, and their own noise
========  =====================================================================
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.backends.filters.compiled.compiling import compiled
from slamcmp.backends.filters.compiled.covariance_kernel import grow, move, observe, shake, turn_landmarks
from slamcmp.backends.filters.compiled.planar import (
    BODY,
    BODY_WORLD,
    LEFT,
    RIGHT,
    WORLD,
    into_chart,
    inverted,
    linearise,
    noise_in_chart,
    predicted,
    retract_landmark,
    retract_pose,
    wrapped,
)
from slamcmp.types import FloatArray, IntArray

LATEST, FIRST, FIRST_BUT_NEW, CONSTRAINED, TRUTH = 0, 1, 2, 3, 4
"""Policies: the latest estimate, first estimates (new landmarks too, or not), OC, the truth."""
DONE, LOST, FAR, NOWHERE = 0, 1, 2, 3
"""Why a call ended: all frames done; no likelihood; points too far; a landmark that cannot be placed."""


@compiled()
def predict(
    chart: int,
    policy: int,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    start: FloatArray,
    memory: FloatArray,
    T_memory: FloatArray,
    points: FloatArray,
    T_prev_body: FloatArray,
    Q: FloatArray,
    T_true: FloatArray,
    seen: IntArray,
) -> None:
    """Move to the frame's pose; ``landmarks`` (count, 2) are in the state, ``seen`` of them are observed."""
    n = 3 + 2 * len(landmarks)
    before_x, before_y = T[0, 2], T[1, 2]
    a, b, x, y = T_prev_body[0, 0], T_prev_body[1, 0], T_prev_body[0, 2], T_prev_body[1, 2]
    F, noise = np.eye(3), np.zeros((3, 3))
    T_before = T.copy()
    for i in range(2):
        c, d = T[i, 0], T[i, 1]
        T[i, 0], T[i, 1] = c * a + d * b, c * T_prev_body[0, 1] + d * T_prev_body[1, 1]
        T[i, 2] += c * x + d * y
    T_to = T
    if chart in (BODY, BODY_WORLD, LEFT):
        F[0, 0], F[0, 1], F[0, 2] = a, b, b * x - a * y
        F[1, 0], F[1, 1], F[1, 2] = -b, a, a * x + b * y
    elif chart == WORLD:
        from_x, from_y = before_x, before_y
        if policy in (FIRST, FIRST_BUT_NEW):
            from_x, from_y = T_memory[0, 2], T_memory[1, 2]
            T_memory[:] = T
        elif policy == CONSTRAINED:
            if seen.size and not np.array_equal(T, T_before):
                u, v = 0.0, 0.0
                for number in seen:
                    u += landmarks[number, 0] - points[number, 0] - before_x + memory[2]
                    v += landmarks[number, 1] - points[number, 1] - before_y + memory[3]
                from_x += u / (seen.size + 1)
                from_y += v / (seen.size + 1)
            memory[2] += T[0, 2] - from_x
            memory[3] += T[1, 2] - from_y
            T_memory[:] = T
        elif policy == TRUTH:
            from_x, from_y = T_memory[0, 2], T_memory[1, 2]
            T_memory[:] = T_true
            T_to = T_memory
        F[0, 2], F[1, 2] = from_y - T_to[1, 2], T_to[0, 2] - from_x
    noise_in_chart(chart, T_to, start, Q, noise)
    if chart == LEFT:
        turn_landmarks(P, n, a, -b)
    if chart != RIGHT:
        move(P, n, F, noise)
        return
    lever = np.empty((len(landmarks), 2))
    for m in range(len(landmarks)):
        lever[m, 0], lever[m, 1] = start[1] - landmarks[m, 1], landmarks[m, 0] - start[0]
    shake(P, noise, lever)


@compiled()
def augment(
    chart: int,
    policy: int,
    polar: bool,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    number: int,
    start: FloatArray,
    memory: FloatArray,
    T_memory: FloatArray,
    points: FloatArray,
    z: FloatArray,
    R: FloatArray,
    G: FloatArray,
) -> bool:
    """One new landmark at its inverse observation; fills in G (2, 3). False: it is nowhere."""
    lx, ly = inverted(T, z[0], z[1], polar)
    if not (math.isfinite(lx) and math.isfinite(ly)):
        return False
    landmarks[number, 0], landmarks[number, 1] = lx, ly
    H_pose, H_land = np.empty((2, 3)), np.empty((2, 2))
    T_at, at_x, at_y = T, lx, ly
    if policy in (FIRST, FIRST_BUT_NEW, CONSTRAINED):
        memory[0] += (lx - T[0, 2]) ** 2 + (ly - T[1, 2]) ** 2
        memory[1] += 1.0
        points[number, 0], points[number, 1] = lx, ly
        if policy == CONSTRAINED:
            points[number, 0] += memory[2] - T_memory[0, 2]
            points[number, 1] += memory[3] - T_memory[1, 2]
        if policy != FIRST_BUT_NEW:
            T_at = T_memory
    elif policy == TRUTH:
        T_at, at_x, at_y = T_memory, points[number, 0], points[number, 1]
    linearise(T_at, at_x, at_y, polar, H_pose, H_land)
    into_chart(chart, T_at, start, at_x, at_y, H_pose, H_land)
    determinant = H_land[0, 0] * H_land[1, 1] - H_land[0, 1] * H_land[1, 0]
    a, b = H_land[1, 1] / determinant, -H_land[0, 1] / determinant
    c, d = -H_land[1, 0] / determinant, H_land[0, 0] / determinant
    for j in range(3):
        G[0, j] = -(a * H_pose[0, j] + b * H_pose[1, j])
        G[1, j] = -(c * H_pose[0, j] + d * H_pose[1, j])
    r00, r01, r10, r11 = R[0, 0], R[0, 1], R[1, 0], R[1, 1]
    N = np.empty((2, 2))
    N[0, 0] = a * (a * r00 + b * r10) + b * (a * r01 + b * r11)
    N[0, 1] = c * (a * r00 + b * r10) + d * (a * r01 + b * r11)
    N[1, 0] = a * (c * r00 + d * r10) + b * (c * r01 + d * r11)
    N[1, 1] = c * (c * r00 + d * r10) + d * (c * r01 + d * r11)
    grow(P, 3 + 2 * number, G, N)
    return True


@compiled()
def fill(
    chart: int,
    polar: bool,
    T: FloatArray,
    start: FloatArray,
    lx: float,
    ly: float,
    m: int,
    H: FloatArray,
    H_pose: FloatArray,
    H_land: FloatArray,
) -> None:
    """The m-th landmark's rows of H (k, 3 + k); the last two are for its own use."""
    linearise(T, lx, ly, polar, H_pose, H_land)
    into_chart(chart, T, start, lx, ly, H_pose, H_land)
    for i in range(2):
        for j in range(3):
            H[2 * m + i, j] = H_pose[i, j]
        for j in range(2):
            H[2 * m + i, 3 + 2 * m + j] = H_land[i, j]


@compiled()
def innovate(polar: bool, T: FloatArray, lx: float, ly: float, z: FloatArray, m: int, y: FloatArray) -> None:
    """The m-th landmark's part of y."""
    z0, z1 = predicted(T, lx, ly, polar)
    y[2 * m], y[2 * m + 1] = z[0] - z0, z[1] - z1
    if polar:
        y[2 * m + 1] = wrapped(y[2 * m + 1])


@compiled()
def touched_states(seen: IntArray, numbers: IntArray) -> IntArray:
    """The pose's states and those of the landmarks seen."""
    touched = np.empty(3 + 2 * seen.size, dtype=np.int64)
    touched[0], touched[1], touched[2] = 0, 1, 2
    for m in range(seen.size):
        s = 3 + 2 * numbers[seen[m]]
        touched[3 + 2 * m], touched[4 + 2 * m] = s, s + 1
    return touched


@compiled()
def noise_of(seen: IntArray, R: FloatArray) -> FloatArray:
    """R of the observations seen, (k, k)."""
    k = 2 * seen.size
    S = np.zeros((k, k))
    for m in range(seen.size):
        for i in range(2):
            for j in range(2):
                S[2 * m + i, 2 * m + j] = R[seen[m], i, j]
    return S


@compiled()
def retract(chart: int, T: FloatArray, landmarks: FloatArray, start: FloatArray, dx: FloatArray) -> None:
    """Pose and landmarks moved by the error dx, in place."""
    for m in range(len(landmarks)):
        landmarks[m, 0], landmarks[m, 1] = retract_landmark(
            chart, T, start, dx[2], landmarks[m, 0], landmarks[m, 1], dx[3 + 2 * m], dx[4 + 2 * m]
        )
    retract_pose(chart, T, start, dx[0], dx[1], dx[2])


@compiled()
def correct(
    chart: int,
    policy: int,
    polar: bool,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    start: FloatArray,
    memory: FloatArray,
    T_memory: FloatArray,
    points: FloatArray,
    seen: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    farthest: float,
    blas: int,
) -> tuple[float, int]:
    """One update with the observations ``seen``; the NIS and why it failed, if it did."""
    n, k = 3 + 2 * len(landmarks), 2 * seen.size
    H, y = np.zeros((k, 3 + k)), np.empty(k)
    H_pose, H_land = np.empty((2, 3)), np.empty((2, 2))
    T_at = T_memory if policy == TRUTH else T
    worst = 0.0
    for m in range(seen.size):
        number = numbers[seen[m]]
        lx, ly = landmarks[number, 0], landmarks[number, 1]
        innovate(polar, T, lx, ly, z[seen[m]], m, y)
        if policy != LATEST:
            at_x, at_y = points[number, 0], points[number, 1]
            if policy == CONSTRAINED:
                at_x += T[0, 2] - memory[2]
                at_y += T[1, 2] - memory[3]
            if policy != TRUTH:
                worst = max(worst, (at_x - lx) ** 2 + (at_y - ly) ** 2)
            lx, ly = at_x, at_y
        fill(chart, polar, T_at, start, lx, ly, m, H, H_pose, H_land)
    if policy in (FIRST, FIRST_BUT_NEW, CONSTRAINED):
        distance = math.sqrt(memory[0] / memory[1])
        memory[4], memory[5] = math.sqrt(worst), distance
        if memory[4] > farthest * distance:
            return np.nan, FAR
    dx = np.empty(n)
    nis = observe(P, n, touched_states(seen, numbers), H, noise_of(seen, R), y, dx, blas)
    if not math.isfinite(nis):
        return np.nan, LOST
    retract(chart, T, landmarks, start, dx)
    if chart == BODY_WORLD:
        J = np.eye(3)
        J[0, 0] = J[1, 1] = math.cos(dx[2])
        J[0, 1] = math.sin(dx[2])
        J[1, 0] = -J[0, 1]
        move(P, n, J, np.zeros((3, 3)))
    return nis, DONE
