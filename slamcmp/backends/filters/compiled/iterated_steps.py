"""The correction of the iterated EKF-SLAM in the plane, compiled: what iterated.py says in numpy."""

from __future__ import annotations

import math

import numpy as np

from slamcmp.backends.filters.compiled.compiling import compiled
from slamcmp.backends.filters.compiled.covariance_kernel import block, factor, innovation, observe
from slamcmp.backends.filters.compiled.ekf_steps import (
    DONE,
    LOST,
    fill,
    innovate,
    noise_of,
    retract,
    touched_states,
)
from slamcmp.backends.filters.compiled.planar import WORLD, retract_pose
from slamcmp.types import FloatArray, IntArray

STEEP = 1.5
"""As in ../../relaxation.py."""


@compiled()
def iterate(
    polar: bool,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    start: FloatArray,
    seen: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    iterations: int,
    tolerance: float,
    blas: int,
    since: FloatArray,
    T_linear: FloatArray,
) -> tuple[float, int]:
    """As ``correct``, in the world chart, iterated on the states touched; NIS and why it failed.

    ``T_linear`` becomes the pose of the last linearisation, ``since`` (3,) the offset from there.
    """
    n, k = 3 + 2 * len(landmarks), 2 * seen.size
    c = 3 + k
    touched, noise = touched_states(seen, numbers), noise_of(seen, R)
    P_touched = np.empty((c, c))
    block(P, touched, P_touched)
    s, step, last = np.zeros(c), np.zeros(c), np.zeros(c)
    H, y = np.zeros((k, c)), np.empty(k)
    H_pose, H_land = np.empty((2, 3)), np.empty((2, 2))
    share = 1.0
    for round_ in range(iterations):
        T_linear[:] = T
        retract_pose(WORLD, T_linear, start, s[0], s[1], s[2])
        for m in range(seen.size):
            number = numbers[seen[m]]
            lx, ly = landmarks[number, 0] + s[3 + 2 * m], landmarks[number, 1] + s[4 + 2 * m]
            innovate(polar, T_linear, lx, ly, z[seen[m]], m, y)
            fill(WORLD, polar, T_linear, start, lx, ly, m, H, H_pose, H_land)
        for a in range(k):
            for t in range(c):
                y[a] += H[a, t] * s[t]
        if round_ == iterations - 1:
            break
        S, e = noise.copy(), y.copy()
        innovation(P_touched, H, S)
        if not factor(S):
            return np.nan, LOST
        for a in range(k):
            for b in range(a):
                e[a] -= S[b, a] * e[b]
            e[a] /= S[a, a]
        for a in range(k - 1, -1, -1):
            for b in range(a + 1, k):
                e[a] -= S[a, b] * e[b]
            e[a] /= S[a, a]
        Hte = np.zeros(c)
        for a in range(k):
            for t in range(c):
                Hte[t] += H[a, t] * e[a]
        largest = 0.0
        for t in range(c):
            step[t] = -s[t]
            for j in range(c):
                step[t] += P_touched[t, j] * Hte[j]
            largest = max(largest, abs(step[t]))
        if largest < tolerance:
            break
        if round_:
            left = np.dot(step, last) / np.dot(last, last)
            curvature = (1.0 - left) / share
            share = 1.0 / curvature if curvature > STEEP else 1.0
        last[:] = step
        for t in range(c):
            s[t] += share * step[t]
    dx = np.empty(n)
    nis = observe(P, n, touched, H, noise, y, dx, blas)
    if not math.isfinite(nis):
        return np.nan, LOST
    for i in range(3):
        since[i] = dx[i] - s[i]
    retract(WORLD, T, landmarks, start, dx)
    return nis, DONE
