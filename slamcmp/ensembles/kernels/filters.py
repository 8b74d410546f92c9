"""EKF-SLAM in the plane for a block of threads: what backends/filters/error_state_ekf.py says in numpy.

Charts WORLD and RIGHT, every policy of linearisation. All threads hold the same pose, and share the rest.

========  =====================================================================
symbol    meaning (those of error_state_ekf.py)
========  =====================================================================
pose      mean: cosine and sine of the heading, x, y (4,); one for each thread
last      what a policy keeps of the pose, alike (4,)
memory    squared distances and number of landmarks placed; the shift of OC's point, x and y (4,)
points    where a policy linearises landmarks, (L, 2), in the order of the map
room      P, W, S, H, dx: see matrices.py
========  =====================================================================
"""

from __future__ import annotations

import math

from slamcmp.ensembles.kernels.matrices import (
    downdate,
    eliminate,
    factor,
    grow,
    innovation,
    move,
    project,
    shake,
)
from slamcmp.ensembles.kernels.settings import (
    CHART,
    CONSTRAINED,
    FIRST,
    FIRST_BUT_NEW,
    FIRST_SIGMA,
    LATEST,
    POLAR,
    POLICY,
    RIGHT,
    SECOND_SIGMA,
    TOO_FAR,
    TRUTH,
)
from slamcmp.ensembles.kernels.target import body, lane, lanes, sync
from slamcmp.types.arrays import FloatArray, IntArray

SMALL = 1e-4
"""Below this angle [rad] the quotients of the exponential use their series, as in slamcmp.geometry."""


@body
def into_axes(chart: int, c: float, s: float, x: float, y: float, Q: FloatArray, noise: FloatArray) -> None:
    """``noise`` = A^-1 Q A^-T, from the body tangent into the chart, at a pose x, y from the start."""
    u, v = (y, -x) if chart == RIGHT else (0.0, 0.0)
    for j in range(3):
        a, b, w = Q[0, j], Q[1, j], Q[2, j]
        noise[0, j], noise[1, j], noise[2, j] = c * a - s * b + u * w, s * a + c * b + v * w, w
    for i in range(3):
        a, b, w = noise[i, 0], noise[i, 1], noise[i, 2]
        noise[i, 0], noise[i, 1] = c * a - s * b + u * w, s * a + c * b + v * w


@body
def to_body(chart: int, pose: FloatArray, start: FloatArray, P: FloatArray, of_pose: FloatArray) -> None:
    """``of_pose`` (3, 3) = A P_xx A^T, the pose's covariance in its body tangent."""
    c, s = pose[0], pose[1]
    u, v = 0.0, 0.0
    if chart == RIGHT:
        x, y = pose[2] - start[0], pose[3] - start[1]
        u, v = s * x - c * y, c * x + s * y
    for i in range(3):
        for j in range(3):
            of_pose[i, j] = P[min(i, j), max(i, j)]
    for j in range(3):
        a, b, w = of_pose[0, j], of_pose[1, j], of_pose[2, j]
        of_pose[0, j], of_pose[1, j] = c * a + s * b + u * w, c * b - s * a + v * w
    for i in range(3):
        a, b, w = of_pose[i, 0], of_pose[i, 1], of_pose[i, 2]
        of_pose[i, 0], of_pose[i, 1] = c * a + s * b + u * w, c * b - s * a + v * w


@body
def predict(
    options: IntArray,
    pose: FloatArray,
    last: FloatArray,
    memory: FloatArray,
    start: FloatArray,
    landmarks: FloatArray,
    points: FloatArray,
    count: int,
    P: FloatArray,
    by: tuple[float, float, float, float],
    Q: FloatArray,
    noise: FloatArray,
    true_pose: FloatArray,
    order: IntArray,
    places: IntArray,
    known: int,
) -> None:
    """Move by the increment ``by`` with Q; ``order``, the first ``known`` of it, is what will be observed."""
    chart, policy = options[CHART], options[POLICY]
    c, s, x, y = pose[0], pose[1], pose[2], pose[3]
    cos, sin = by[0], by[1]
    to_c, to_s = c * cos - s * sin, s * cos + c * sin
    to_x, to_y = x + c * by[2] - s * by[3], y + s * by[2] + c * by[3]
    from_x, from_y = x, y
    at_c, at_s, at_x, at_y = to_c, to_s, to_x, to_y
    if policy in (FIRST, FIRST_BUT_NEW):
        from_x, from_y = last[2], last[3]
    elif policy == CONSTRAINED:
        if known > 0 and not (to_c == c and to_s == s and to_x == x and to_y == y):
            u, v = 0.0, 0.0
            for m in range(known):
                place = places[order[m]]
                u += landmarks[place, 0] - points[place, 0] - x + memory[2]
                v += landmarks[place, 1] - points[place, 1] - y + memory[3]
            from_x += u / (known + 1)
            from_y += v / (known + 1)
        memory[2] += to_x - from_x
        memory[3] += to_y - from_y
    elif policy == TRUTH:
        from_x, from_y = last[2], last[3]
        at_c, at_s, at_x, at_y = true_pose[0], true_pose[1], true_pose[2], true_pose[3]
    pose[0], pose[1], pose[2], pose[3] = to_c, to_s, to_x, to_y
    if policy != LATEST:
        last[0], last[1], last[2], last[3] = at_c, at_s, at_x, at_y
    into_axes(chart, at_c, at_s, at_x - start[0], at_y - start[1], Q, noise)
    n = 3 + 2 * count
    if chart == RIGHT:
        shake(P, n, landmarks, start[0], start[1], noise)
    else:
        move(P, n, from_y - at_y, at_x - from_x, noise)


@body
def jacobian(options: IntArray, at: FloatArray, lx: float, ly: float, H: FloatArray, a: int) -> None:
    """Rows a and a + 1 of H (k, 5): a measurement by the pose's error and its landmark's, in the chart."""
    c, s = at[0], at[1]
    dx, dy = lx - at[2], ly - at[3]
    x, y = c * dx + s * dy, c * dy - s * dx
    p, q, u, v = 1.0, 0.0, 0.0, 1.0
    turn_0, turn_1 = y, -x
    if options[POLAR] != 0:
        r2 = x * x + y * y
        r = math.sqrt(r2)
        p, q, u, v = x / r, y / r, -y / r2, x / r2
        turn_0, turn_1 = 0.0, -1.0
    # By the landmark in the world's axes; by the pose's position it is the same with the other sign.
    H[a, 3], H[a, 4] = p * c - q * s, p * s + q * c
    H[a + 1, 3], H[a + 1, 4] = u * c - v * s, u * s + v * c
    for i in range(2):
        H[a + i, 0], H[a + i, 1] = -H[a + i, 3], -H[a + i, 4]
    if options[CHART] == RIGHT:
        # A landmark turns with the robot about the start: of the heading's error nothing is left to see.
        for i in range(2):
            H[a + i, 2] = 0.0
    else:
        H[a, 2], H[a + 1, 2] = turn_0, turn_1


@body
def augment(
    options: IntArray,
    numbers: FloatArray,
    pose: FloatArray,
    last: FloatArray,
    memory: FloatArray,
    landmarks: FloatArray,
    points: FloatArray,
    true_x: float,
    true_y: float,
    count: int,
    z0: float,
    z1: float,
    P: FloatArray,
    H: FloatArray,
    G: FloatArray,
    N: FloatArray,
) -> None:
    """A landmark that is new, at its inverse observation; the map has ``count`` before it."""
    policy = options[POLICY]
    x, y = z0, z1
    if options[POLAR] != 0:
        x, y = z0 * math.cos(z1), z0 * math.sin(z1)
    lx, ly = pose[0] * x - pose[1] * y + pose[2], pose[1] * x + pose[0] * y + pose[3]
    px, py = lx, ly
    if policy in (FIRST, FIRST_BUT_NEW, CONSTRAINED):
        memory[0] += (lx - pose[2]) ** 2 + (ly - pose[3]) ** 2
        memory[1] += 1.0
        if policy == CONSTRAINED:
            px, py = px + memory[2] - last[2], py + memory[3] - last[3]
    elif policy == TRUTH:
        px, py = true_x, true_y
    sync()
    if lane() == 0:
        landmarks[count, 0], landmarks[count, 1] = lx, ly
        points[count, 0], points[count, 1] = px, py
        if policy in (FIRST, CONSTRAINED):
            jacobian(options, last, lx, ly, H, 0)
        elif policy == TRUTH:
            jacobian(options, last, px, py, H, 0)
        else:
            jacobian(options, pose, lx, ly, H, 0)
    sync()
    determinant = H[0, 3] * H[1, 4] - H[0, 4] * H[1, 3]
    a, b = H[1, 4] / determinant, -H[0, 4] / determinant
    c, d = -H[1, 3] / determinant, H[0, 3] / determinant
    for j in range(3):
        G[0, j] = -(a * H[0, j] + b * H[1, j])
        G[1, j] = -(c * H[0, j] + d * H[1, j])
    q, r = numbers[FIRST_SIGMA] ** 2, numbers[SECOND_SIGMA] ** 2
    N[0, 0], N[0, 1], N[1, 1] = a * a * q + b * b * r, a * c * q + b * d * r, c * c * q + d * d * r
    grow(P, 3 + 2 * count, G, N)


@body
def correct(
    options: IntArray,
    numbers: FloatArray,
    pose: FloatArray,
    last: FloatArray,
    memory: FloatArray,
    start: FloatArray,
    landmarks: FloatArray,
    points: FloatArray,
    count: int,
    order: IntArray,
    places: IntArray,
    own: IntArray,
    known: int,
    z: FloatArray,
    P: FloatArray,
    W: FloatArray,
    S: FloatArray,
    H: FloatArray,
    dx: FloatArray,
) -> bool:
    """One update with the first ``known`` landmarks of ``order``; False where the filter has failed."""
    policy, polar = options[POLICY], options[POLAR] != 0
    n, k = 3 + 2 * count, 2 * known
    worst = 0.0
    if policy in (FIRST, FIRST_BUT_NEW, CONSTRAINED):
        shift_x, shift_y = 0.0, 0.0
        if policy == CONSTRAINED:
            shift_x, shift_y = pose[2] - memory[2], pose[3] - memory[3]
        for m in range(known):
            place = places[order[m]]
            off_x = points[place, 0] + shift_x - landmarks[place, 0]
            off_y = points[place, 1] + shift_y - landmarks[place, 1]
            worst = max(worst, off_x * off_x + off_y * off_y)
        if math.sqrt(worst) > numbers[TOO_FAR] * math.sqrt(memory[0] / memory[1]):
            return False
    for m in range(lane(), known, lanes()):
        place = places[order[m]]
        own[m] = 3 + 2 * place
        lx, ly = landmarks[place, 0], landmarks[place, 1]
        ahead, left = lx - pose[2], ly - pose[3]
        x, y = pose[0] * ahead + pose[1] * left, pose[0] * left - pose[1] * ahead
        first, second = z[order[m], 0] - x, z[order[m], 1] - y
        if polar:
            first, second = z[order[m], 0] - math.hypot(x, y), z[order[m], 1] - math.atan2(y, x)
            second -= 2.0 * math.pi * math.floor(second / (2.0 * math.pi) + 0.5)
        W[2 * m, n], W[2 * m + 1, n] = first, second
        if policy == TRUTH:
            jacobian(options, last, points[place, 0], points[place, 1], H, 2 * m)
        elif policy == LATEST:
            jacobian(options, pose, lx, ly, H, 2 * m)
        elif policy == CONSTRAINED:
            at_x, at_y = points[place, 0] + pose[2] - memory[2], points[place, 1] + pose[3] - memory[3]
            jacobian(options, pose, at_x, at_y, H, 2 * m)
        else:
            jacobian(options, pose, points[place, 0], points[place, 1], H, 2 * m)
    sync()
    project(P, n, H, own, k, W)
    innovation(H, own, k, W, numbers[FIRST_SIGMA] ** 2, numbers[SECOND_SIGMA] ** 2, S)
    sync()
    if not factor(S, k):
        return False
    eliminate(S, k, W, n + 1)
    downdate(P, n, W, k, dx)
    if not math.isfinite(dx[0] + dx[1] + dx[2]):
        return False
    retract(options[CHART], pose, start, landmarks, count, dx)
    return True


@body
def retract(
    chart: int, pose: FloatArray, start: FloatArray, landmarks: FloatArray, count: int, dx: FloatArray
) -> None:
    """Pose and landmarks moved by the error dx, in place."""
    theta = dx[2]
    c, s = math.cos(theta), math.sin(theta)
    a, b = 1.0 - theta * theta / 6.0, theta * (0.5 - theta * theta / 24.0)
    if abs(theta) >= SMALL:
        a, b = math.sin(theta) / theta, 2.0 * math.sin(0.5 * theta) ** 2 / theta
    for m in range(lane(), count, lanes()):
        u, v = dx[3 + 2 * m], dx[4 + 2 * m]
        if chart == RIGHT:
            x, y = landmarks[m, 0] - start[0], landmarks[m, 1] - start[1]
            landmarks[m, 0] = c * x - s * y + a * u - b * v + start[0]
            landmarks[m, 1] = s * x + c * y + b * u + a * v + start[1]
        else:
            landmarks[m, 0] += u
            landmarks[m, 1] += v
    if chart == RIGHT:
        x, y = pose[2] - start[0], pose[3] - start[1]
        pose[2] = c * x - s * y + a * dx[0] - b * dx[1] + start[0]
        pose[3] = s * x + c * y + b * dx[0] + a * dx[1] + start[1]
    else:
        pose[2] += dx[0]
        pose[3] += dx[1]
    pose[0], pose[1] = c * pose[0] - s * pose[1], c * pose[1] + s * pose[0]
    sync()
