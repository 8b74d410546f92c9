"""One frame of the world: what the wheels report, and what is seen, as worlds/simulate.py has them.

========  =====================================================================
symbol    meaning
========  =====================================================================
c, s      cosine and sine of a pose's heading
v, w      speed [m/s] and turn rate [rad/s] of a part of a step
J         derivative of the increment by v and w, in the body tangent at its end
Q         covariance of the increment in that tangent, (3, 3)
========  =====================================================================

Odometry drives straight and then turns (models/motion.py, StraightThenTurn); the parts of a step have noise
of their own.
"""

from __future__ import annotations

import math

from slamcmp.ensembles.kernels.draws import MAP, PART, SENSOR, SLIP, normals, uniforms
from slamcmp.ensembles.kernels.settings import (
    FARTHEST,
    FIRST_SIGMA,
    GAP_MAX,
    GAP_MIN,
    HALF_VIEW,
    LATERAL_SIGMA,
    NEAREST,
    PARTS,
    POLAR,
    RADIUS,
    SECOND_SIGMA,
    SPEED_SIGMA,
    TIME_STEP,
    TURN_SIGMA,
)
from slamcmp.ensembles.kernels.target import body, lane, lanes, sync
from slamcmp.types.arrays import FloatArray, IntArray


@body
def odometry(
    seed: int, k: int, speed: float, turn: float, numbers: FloatArray, options: IntArray, Q: FloatArray
) -> tuple[float, float, float, float]:
    """The increment to frame k: cosine, sine, x and y; fills in ``Q`` (3, 3), each thread its own."""
    parts = options[PARTS]
    dt = numbers[TIME_STEP] / parts
    c, s, x, y = 1.0, 0.0, 0.0, 0.0
    for i in range(3):
        for j in range(3):
            Q[i, j] = 0.0
    # From the last part to the first, so that all is known of the later ones, which carry its noise on.
    for part in range(parts):
        a, b = normals(seed, k, PART, part)
        v, w = speed + numbers[SPEED_SIGMA] * a, turn + numbers[TURN_SIGMA] * b
        cos, sin = math.cos(w * dt), math.sin(w * dt)
        # J by v, turned into the tangent at the end of the step; by w it is (moved by the later parts).
        gx, gy = cos * dt, -sin * dt
        by_v_x, by_v_y = c * gx + s * gy, c * gy - s * gx
        mx, my = -(c * x + s * y), s * x - c * y
        by_w_x, by_w_y = my * dt, -mx * dt
        q, r = numbers[SPEED_SIGMA] ** 2, numbers[TURN_SIGMA] ** 2
        Q[0, 0] += q * by_v_x * by_v_x + r * by_w_x * by_w_x
        Q[0, 1] += q * by_v_x * by_v_y + r * by_w_x * by_w_y
        Q[1, 1] += q * by_v_y * by_v_y + r * by_w_y * by_w_y
        Q[0, 2] += r * by_w_x * dt
        Q[1, 2] += r * by_w_y * dt
        Q[2, 2] += r * dt * dt
        x, y = v * dt + cos * x - sin * y, sin * x + cos * y
        c, s = cos * c - sin * s, sin * c + cos * s
    if numbers[LATERAL_SIGMA] > 0.0:
        a, b = normals(seed, k, SLIP, 0)
        x, y = x - s * numbers[LATERAL_SIGMA] * a, y + c * numbers[LATERAL_SIGMA] * a
        Q[1, 1] += numbers[LATERAL_SIGMA] ** 2
    Q[1, 0], Q[2, 0], Q[2, 1] = Q[0, 1], Q[0, 2], Q[1, 2]
    return c, s, x, y


@body
def annulus(seed: int, numbers: FloatArray, landmarks: FloatArray) -> None:
    """This run's landmarks (L, 2) on both sides of the circle (worlds/planar.py, circle)."""
    for number in range(lane(), len(landmarks), lanes()):
        a, b = uniforms(seed, number, MAP, 0)
        side, _ = uniforms(seed, number, MAP, 1)
        gap = numbers[GAP_MIN] + (numbers[GAP_MAX] - numbers[GAP_MIN]) * b
        distance = numbers[RADIUS] + (gap if side < 0.5 else -gap)
        landmarks[number, 0] = distance * math.cos(2.0 * math.pi * a)
        landmarks[number, 1] = numbers[RADIUS] + distance * math.sin(2.0 * math.pi * a)


@body
def look(
    seed: int,
    k: int,
    pose: FloatArray,
    landmarks: FloatArray,
    numbers: FloatArray,
    options: IntArray,
    visible: IntArray,
    z: FloatArray,
) -> None:
    """Which landmarks are seen from the true pose (cosine, sine, x, y): ``visible`` (L,), and z (L, 2)."""
    c, s, x, y = pose[0], pose[1], pose[2], pose[3]
    for number in range(lane(), len(landmarks), lanes()):
        dx, dy = landmarks[number, 0] - x, landmarks[number, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        distance, bearing = math.hypot(ahead, left), math.atan2(left, ahead)
        visible[number] = 0
        if (
            numbers[NEAREST] <= distance
            and distance <= numbers[FARTHEST]
            and abs(bearing) <= numbers[HALF_VIEW]
        ):
            visible[number] = 1
            a, b = normals(seed, k, SENSOR, number)
            first, second = ahead, left
            if options[POLAR] != 0:
                first, second = distance, bearing
            z[number, 0] = first + numbers[FIRST_SIGMA] * a
            z[number, 1] = second + numbers[SECOND_SIGMA] * b
            if options[POLAR] != 0:
                z[number, 1] -= 2.0 * math.pi * math.floor(z[number, 1] / (2.0 * math.pi) + 0.5)
                # A sensor cannot report a range below zero.
                if z[number, 0] <= 0.0:
                    visible[number] = 0
    sync()


@body
def sort_seen(visible: IntArray, places: IntArray, order: IntArray) -> tuple[int, int]:
    """The seen landmarks by number, known ones first: fills in ``order``; how many are known, and in all."""
    known, seen = 0, 0
    for number in range(len(visible)):
        if visible[number] != 0:
            seen += 1
            if places[number] >= 0:
                known += 1
    if lane() == 0:
        at, new = 0, known
        for number in range(len(visible)):
            if visible[number] != 0 and places[number] >= 0:
                order[at] = number
                at += 1
            elif visible[number] != 0:
                order[new] = number
                new += 1
    sync()
    return known, seen
