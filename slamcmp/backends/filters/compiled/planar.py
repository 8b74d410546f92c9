"""Poses, sensors and charts in the plane, for compiled loops: what geometry, models and charts.py say.

========  =====================================================================
symbol    meaning (those of charts.py and models/sensors.py)
========  =====================================================================
T         pose, T_world_body (3, 3)
A, C      chart to body tangent (3, 3), and to a landmark's world offset (2, 2)
b         the heading's column of B, by which a landmark follows the pose's error
a, b      of the exponential: sin(theta) / theta and (1 - cos(theta)) / theta
H_pose    derivative of a measurement by the pose's error, (2, 3)
H_land    by the landmark's, (2, 2)
========  =====================================================================
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.backends.filters.compiled.compiling import compiled
from slamcmp.types import FloatArray

TURN = 2.0 * math.pi
SMALL = 1e-4
"""Below this angle [rad] the quotients of the exponential use their series, as in slamcmp.geometry."""

BODY, BODY_WORLD, WORLD, RIGHT, LEFT = 0, 1, 2, 3, 4
"""Charts: the body tangent, corrected by the exponential or in the world's axes (ekf_slam); others."""


@compiled()
def turn_and_move(T: FloatArray, c: float, s: float, x: float, y: float) -> None:
    """T times the increment of cosine, sine and translation given, in place."""
    for i in range(2):
        a, b = T[i, 0], T[i, 1]
        T[i, 0] = a * c + b * s
        T[i, 1] = b * c - a * s
        T[i, 2] += a * x + b * y


@compiled()
def quotients(theta: float) -> tuple[float, float]:
    """a and b of the exponential."""
    if abs(theta) < SMALL:
        return 1.0 - theta * theta / 6.0, theta * (0.5 - theta * theta / 24.0)
    return math.sin(theta) / theta, 2.0 * math.sin(0.5 * theta) ** 2 / theta


@compiled()
def wrapped(angle: float) -> float:
    """The angle within half a turn of zero."""
    turned: float = angle - TURN * np.rint(angle * (1.0 / TURN))
    return turned


@compiled()
def predicted(T: FloatArray, lx: float, ly: float, polar: bool) -> tuple[float, float]:
    """The measurement of a landmark."""
    dx, dy = lx - T[0, 2], ly - T[1, 2]
    x, y = T[0, 0] * dx + T[1, 0] * dy, T[0, 1] * dx + T[1, 1] * dy
    if polar:
        return math.hypot(x, y), math.atan2(y, x)
    return x, y


@compiled()
def inverted(T: FloatArray, z0: float, z1: float, polar: bool) -> tuple[float, float]:
    """Where a measurement puts its landmark."""
    x, y = z0, z1
    if polar:
        x, y = z0 * math.cos(z1), z0 * math.sin(z1)
    return T[0, 0] * x + T[0, 1] * y + T[0, 2], T[1, 0] * x + T[1, 1] * y + T[1, 2]


@compiled()
def linearise(
    T: FloatArray, lx: float, ly: float, polar: bool, H_pose: FloatArray, H_land: FloatArray
) -> None:
    """Fill in H_pose by the body tangent and H_land by the landmark in world axes."""
    dx, dy = lx - T[0, 2], ly - T[1, 2]
    x, y = T[0, 0] * dx + T[1, 0] * dy, T[0, 1] * dx + T[1, 1] * dy
    if polar:
        r2 = x * x + y * y
        r = math.sqrt(r2)
        a, b, c, d = x / r, y / r, -y / r2, x / r2
        H_pose[0, 2], H_pose[1, 2] = 0.0, -1.0
    else:
        a, b, c, d = 1.0, 0.0, 0.0, 1.0
        H_pose[0, 2], H_pose[1, 2] = y, -x
    H_pose[0, 0], H_pose[0, 1], H_pose[1, 0], H_pose[1, 1] = -a, -b, -c, -d
    H_land[0, 0], H_land[0, 1] = a * T[0, 0] + b * T[0, 1], a * T[1, 0] + b * T[1, 1]
    H_land[1, 0], H_land[1, 1] = c * T[0, 0] + d * T[0, 1], c * T[1, 0] + d * T[1, 1]


@compiled()
def into_chart(
    chart: int,
    T: FloatArray,
    start: FloatArray,
    lx: float,
    ly: float,
    H_pose: FloatArray,
    H_land: FloatArray,
) -> None:
    """H_pose A + H_land B and H_land C, in place, at the pose T and the landmark."""
    c, s = T[0, 0], T[1, 0]
    if chart == WORLD:
        for i in range(2):
            u, v = H_pose[i, 0], H_pose[i, 1]
            H_pose[i, 0], H_pose[i, 1] = u * c - v * s, u * s + v * c
    elif chart == RIGHT:
        x, y = T[0, 2] - start[0], T[1, 2] - start[1]
        for i in range(2):
            u, v = H_pose[i, 0], H_pose[i, 1]
            H_pose[i, 0], H_pose[i, 1] = u * c - v * s, u * s + v * c
            H_pose[i, 2] += u * (s * x - c * y) + v * (c * x + s * y)
            H_pose[i, 2] += H_land[i, 1] * (lx - start[0]) - H_land[i, 0] * (ly - start[1])
    elif chart == LEFT:
        for i in range(2):
            u, v = H_land[i, 0], H_land[i, 1]
            H_land[i, 0], H_land[i, 1] = u * c + v * s, v * c - u * s


@compiled()
def noise_in_chart(chart: int, T: FloatArray, start: FloatArray, Q: FloatArray, noise: FloatArray) -> None:
    """``noise`` = A^-1 Q A^-T at the pose T."""
    for i in range(3):
        for j in range(3):
            noise[i, j] = 0.5 * (Q[i, j] + Q[j, i])
    if chart not in (WORLD, RIGHT):
        return
    c, s, u, v = T[0, 0], T[1, 0], 0.0, 0.0
    if chart == RIGHT:
        u, v = T[1, 2] - start[1], start[0] - T[0, 2]
    for j in range(3):
        x, y, w = noise[0, j], noise[1, j], noise[2, j]
        noise[0, j], noise[1, j] = c * x - s * y + u * w, s * x + c * y + v * w
    for i in range(3):
        x, y, w = noise[i, 0], noise[i, 1], noise[i, 2]
        noise[i, 0], noise[i, 1] = c * x - s * y + u * w, s * x + c * y + v * w


@compiled()
def to_body(chart: int, T: FloatArray, start: FloatArray, P: FloatArray, P_body: FloatArray) -> None:
    """``P_body`` (3, 3) = A P_xx A^T at the pose T, of the first block of P."""
    c, s, u, v = 1.0, 0.0, 0.0, 0.0
    if chart in (WORLD, RIGHT):
        c, s = T[0, 0], T[1, 0]
    if chart == RIGHT:
        x, y = T[0, 2] - start[0], T[1, 2] - start[1]
        u, v = s * x - c * y, c * x + s * y
    for i in range(3):
        for j in range(3):
            P_body[i, j] = P[min(i, j), max(i, j)]
    if chart not in (WORLD, RIGHT):
        return
    for j in range(3):
        x, y, w = P_body[0, j], P_body[1, j], P_body[2, j]
        P_body[0, j], P_body[1, j] = c * x + s * y + u * w, c * y - s * x + v * w
    for i in range(3):
        x, y, w = P_body[i, 0], P_body[i, 1], P_body[i, 2]
        P_body[i, 0], P_body[i, 1] = c * x + s * y + u * w, c * y - s * x + v * w
    for i in range(3):
        for j in range(i):
            P_body[i, j] = P_body[j, i] = 0.5 * (P_body[i, j] + P_body[j, i])


@compiled()
def retract_pose(chart: int, T: FloatArray, start: FloatArray, x: float, y: float, theta: float) -> None:
    """The pose moved by the error (x, y, theta), in place."""
    c, s = math.cos(theta), math.sin(theta)
    if chart == BODY_WORLD:
        turn_and_move(T, c, s, x, y)
        return
    if chart in (BODY, LEFT):
        a, b = quotients(theta)
        turn_and_move(T, c, s, a * x - b * y, b * x + a * y)
        return
    # From the left: both turn the pose in the world's axes.
    cos, sin = T[0, 0], T[1, 0]
    T[0, 0] = T[1, 1] = c * cos - s * sin
    T[1, 0] = s * cos + c * sin
    T[0, 1] = -T[1, 0]
    if chart == WORLD:
        T[0, 2] += x
        T[1, 2] += y
        return
    a, b = quotients(theta)
    u, v = T[0, 2] - start[0], T[1, 2] - start[1]
    T[0, 2] = c * u - s * v + a * x - b * y + start[0]
    T[1, 2] = s * u + c * v + b * x + a * y + start[1]


@compiled()
def retract_landmark(
    chart: int, T: FloatArray, start: FloatArray, theta: float, lx: float, ly: float, x: float, y: float
) -> tuple[float, float]:
    """A landmark moved by its error (x, y), where the pose T moved by one of the angle theta."""
    if chart == RIGHT:
        c, s = math.cos(theta), math.sin(theta)
        a, b = quotients(theta)
        u, v = lx - start[0], ly - start[1]
        return c * u - s * v + a * x - b * y + start[0], s * u + c * v + b * x + a * y + start[1]
    if chart == LEFT:
        a, b = quotients(theta)
        u, v = a * x - b * y, b * x + a * y
        return lx + T[0, 0] * u + T[0, 1] * v, ly + T[1, 0] * u + T[1, 1] * v
    return lx + x, ly + y
