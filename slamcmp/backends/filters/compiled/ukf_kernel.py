"""UKF-SLAM in the plane as compiled loops: what ukf.py says in numpy.

========  ====================================================================
symbol    meaning (those of ukf.py)
========  ====================================================================
c, u      dimension of the sampled error, and its points in units of sigma
S, P      P = S S^T, its square root by eigenvectors, so that P may be singular
Y         regression of the values on u, (k, c); H = Y S^-1
Omega     covariance of what the regression leaves, (k, k)
========  ====================================================================
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from slamcmp.backends.filters.compiled.compiling import GIVEN, GIVEN_NUMBERS, OWN, OWN_NUMBERS, compiled
from slamcmp.backends.filters.compiled.covariance_kernel import block, grow, move, observe
from slamcmp.backends.filters.compiled.ekf_steps import (
    LATEST,
    LOST,
    NOWHERE,
    innovate,
    noise_of,
    predict,
    retract,
    touched_states,
)
from slamcmp.backends.filters.compiled.planar import (
    LEFT,
    RIGHT,
    WORLD,
    inverted,
    predicted,
    quotients,
    retract_landmark,
    retract_pose,
    to_body,
    turn_and_move,
    wrapped,
)
from slamcmp.types import FloatArray, IntArray

Root = tuple[FloatArray, FloatArray, FloatArray]
"""Scale (c,), directions (c, c), and the square roots of the variances along them (c,), zero for none."""


@compiled()
def square_root(P: FloatArray) -> Root:
    """Of P (c, c), ranks judged on the correlation matrix."""
    c = len(P)
    scale = np.empty(c)
    for i in range(c):
        scale[i] = math.sqrt(max(P[i, i], 0.0))
        if not scale[i] > 0.0:
            scale[i] = 1.0
    correlation = np.empty((c, c))
    for i in range(c):
        for j in range(c):
            correlation[i, j] = P[i, j] / (scale[i] * scale[j])
    variances, directions = np.linalg.eigh(correlation)
    for i in range(c):
        variances[i] = math.sqrt(variances[i]) if variances[i] > 1e-14 * c else 0.0
    return scale, directions, variances


@compiled()
def sigma_points(root: Root, spread: float) -> FloatArray:
    """Errors (2 c, c)."""
    scale, directions, deviations = root
    c = len(scale)
    errors = np.empty((2 * c, c))
    for i in range(c):
        for j in range(c):
            errors[i, j] = spread * scale[j] * directions[j, i] * deviations[i]
            errors[c + i, j] = -errors[i, j]
    return errors


@compiled()
def regression(
    values: FloatArray, root: Root, spread: float, alpha: float, beta: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (k,), H (k, c) and Omega (k, k) of values (2 c, k) that are zero at zero."""
    scale, directions, deviations = root
    c, k = len(scale), values.shape[1]
    weight = 0.5 / spread**2
    mean = np.zeros(k)
    for i in range(2 * c):
        for a in range(k):
            mean[a] += values[i, a]
    Y, H = np.empty((k, c)), np.zeros((k, c))
    for a in range(k):
        mean[a] *= weight
        for i in range(c):
            Y[a, i] = weight * spread * (values[i, a] - values[c + i, a])
            if deviations[i] > 0.0:
                for j in range(c):
                    H[a, j] += Y[a, i] / deviations[i] * directions[j, i]
        for j in range(c):
            H[a, j] /= scale[j]
    centre = 1.0 - c / spread**2 + 1.0 - alpha**2 + beta
    Omega = np.empty((k, k))
    for a in range(k):
        for b in range(a + 1):
            moment, explained = 0.0, 0.0
            for i in range(2 * c):
                moment += (values[i, a] - mean[a]) * (values[i, b] - mean[b])
            for i in range(c):
                explained += Y[a, i] * Y[b, i]
            Omega[a, b] = Omega[b, a] = weight * moment + centre * mean[a] * mean[b] - explained
    return mean, H, Omega


@compiled()
def predict_sampled(
    T: FloatArray,
    P: FloatArray,
    n: int,
    start: FloatArray,
    T_prev_body: FloatArray,
    Q: FloatArray,
    alpha: float,
    beta: float,
    kappa: float,
) -> None:
    """The motion in the world chart, regressed on pose and increment."""
    c, s, x, y = T_prev_body[0, 0], T_prev_body[1, 0], T_prev_body[0, 2], T_prev_body[1, 2]
    joint = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            joint[i, j], joint[3 + i, 3 + j] = P[i, j], Q[i, j]
    spread = alpha * math.sqrt(6 + kappa)
    root = square_root(joint)
    errors = sigma_points(root, spread)
    T_after = T.copy()
    turn_and_move(T_after, c, s, x, y)
    values = np.empty((12, 3))
    for i in range(12):
        end = T.copy()
        retract_pose(WORLD, end, start, errors[i, 0], errors[i, 1], errors[i, 2])
        turn_and_move(end, c, s, x, y)
        retract_pose(LEFT, end, start, errors[i, 3], errors[i, 4], errors[i, 5])
        values[i, 0], values[i, 1] = end[0, 2] - T_after[0, 2], end[1, 2] - T_after[1, 2]
        values[i, 2] = math.atan2(
            end[1, 0] * T_after[0, 0] - end[0, 0] * T_after[1, 0],
            end[0, 0] * T_after[0, 0] + end[1, 0] * T_after[1, 0],
        )
    _, H, noise = regression(values, root, spread, alpha, beta)
    for i in range(3):
        for j in range(3):
            for a in range(3):
                for b in range(3):
                    noise[i, j] += H[i, 3 + a] * Q[a, b] * H[j, 3 + b]
    move(P, n, H[:, :3].copy(), noise)
    T[:] = T_after


@compiled()
def landmark_error(
    chart: int,
    T: FloatArray,
    start: FloatArray,
    theta: float,
    lx: float,
    ly: float,
    x: float,
    y: float,
) -> tuple[float, float]:
    """The error that takes a landmark from (lx, ly) to (x, y) while the pose T turns by theta."""
    if chart == WORLD:
        return x - lx, y - ly
    a, b = quotients(theta)
    if chart == RIGHT:
        c, s = math.cos(theta), math.sin(theta)
        u, v = lx - start[0], ly - start[1]
        dx, dy = x - start[0] - (c * u - s * v), y - start[1] - (s * u + c * v)
    else:
        dx, dy = x - lx, y - ly
        dx, dy = T[0, 0] * dx + T[1, 0] * dy, T[0, 1] * dx + T[1, 1] * dy
    scale = 1.0 / (a * a + b * b)
    return scale * (a * dx + b * dy), scale * (a * dy - b * dx)


@compiled()
def augment_sampled(
    chart: int,
    polar: bool,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    known: int,
    start: FloatArray,
    new: IntArray,
    z: FloatArray,
    R: FloatArray,
    alpha: float,
    beta: float,
    kappa: float,
) -> bool:
    """The frame's new landmarks, regressed on pose and measurements; False: one of them is nowhere."""
    m = new.size
    c = 3 + 2 * m
    joint = np.zeros((c, c))
    joint[:3, :3] = P[:3, :3]
    for i in range(m):
        lx, ly = inverted(T, z[new[i], 0], z[new[i], 1], polar)
        if not (math.isfinite(lx) and math.isfinite(ly)):
            return False
        landmarks[known + i, 0], landmarks[known + i, 1] = lx, ly
        for a in range(2):
            for b in range(2):
                joint[3 + 2 * i + a, 3 + 2 * i + b] = R[new[i], a, b]
    spread = alpha * math.sqrt(c + kappa)
    root = square_root(joint)
    errors = sigma_points(root, spread)
    values = np.empty((2 * c, 2 * m))
    for point in range(2 * c):
        moved = T.copy()
        theta = errors[point, 2]
        retract_pose(chart, moved, start, errors[point, 0], errors[point, 1], theta)
        for i in range(m):
            z0, z1 = z[new[i], 0] + errors[point, 3 + 2 * i], z[new[i], 1] + errors[point, 4 + 2 * i]
            x, y = inverted(moved, z0, z1, polar)
            lx, ly = landmarks[known + i, 0], landmarks[known + i, 1]
            dx, dy = landmark_error(chart, T, start, wrapped(theta), lx, ly, x, y)
            values[point, 2 * i], values[point, 2 * i + 1] = dx, dy
    _, H, N = regression(values, root, spread, alpha, beta)
    D = H[:, 3:].copy()
    N += D @ joint[3:, 3:].copy() @ D.T
    grow(P, 3 + 2 * known, H[:, :3].copy(), N)
    return True


@compiled()
def correct_sampled(
    chart: int,
    polar: bool,
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    start: FloatArray,
    seen: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    alpha: float,
    beta: float,
    kappa: float,
    blas: int,
) -> float:
    """One update with the observations ``seen``; the NIS, NaN where there is no likelihood."""
    k = 2 * seen.size
    c = 3 + k
    touched, noise, y = touched_states(seen, numbers), noise_of(seen, R), np.empty(k)
    P_touched = np.empty((c, c))
    block(P, touched, P_touched)
    if not np.isfinite(P_touched).all():
        return np.nan
    spread = alpha * math.sqrt(c + kappa)
    root = square_root(P_touched)
    errors = sigma_points(root, spread)
    centres = np.empty(k)
    for m in range(seen.size):
        lx, ly = landmarks[numbers[seen[m]], 0], landmarks[numbers[seen[m]], 1]
        centres[2 * m], centres[2 * m + 1] = predicted(T, lx, ly, polar)
        innovate(polar, T, lx, ly, z[seen[m]], m, y)
    values = np.empty((2 * c, k))
    for point in range(2 * c):
        moved = T.copy()
        theta = errors[point, 2]
        retract_pose(chart, moved, start, errors[point, 0], errors[point, 1], theta)
        for m in range(seen.size):
            lx, ly = landmarks[numbers[seen[m]], 0], landmarks[numbers[seen[m]], 1]
            dx, dy = errors[point, 3 + 2 * m], errors[point, 4 + 2 * m]
            lx, ly = retract_landmark(chart, T, start, theta, lx, ly, dx, dy)
            z0, z1 = predicted(moved, lx, ly, polar)
            values[point, 2 * m] = z0 - centres[2 * m]
            values[point, 2 * m + 1] = z1 - centres[2 * m + 1]
            if polar:
                values[point, 2 * m + 1] = wrapped(values[point, 2 * m + 1])
    mean, H, Omega = regression(values, root, spread, alpha, beta)
    for a in range(k):
        y[a] -= mean[a]
        for b in range(k):
            noise[a, b] += Omega[a, b]
    dx_all = np.empty(3 + 2 * len(landmarks))
    nis = observe(P, len(dx_all), touched, H, noise, y, dx_all, blas)
    if math.isfinite(nis):
        retract(chart, T, landmarks, start, dx_all)
    return nis


@compiled(
    nb.int64(
        *(OWN[2], OWN[2], OWN[2], OWN[1]),
        *(nb.int64, OWN_NUMBERS, OWN[1], nb.int64),
        *(GIVEN_NUMBERS, GIVEN[3], GIVEN[3], GIVEN_NUMBERS, GIVEN_NUMBERS, GIVEN[2], GIVEN[3]),
        *(OWN[3], OWN[3], OWN[1], OWN_NUMBERS),
    )
)
def run(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    start: FloatArray,
    known: int,
    options: IntArray,
    tuning: FloatArray,
    blas: int,
    frames: IntArray,
    T_prev_body: FloatArray,
    Q: FloatArray,
    starts: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    poses: FloatArray,
    covariances: FloatArray,
    nis: FloatArray,
    dof: IntArray,
) -> int:
    """As ``run`` in ekf_kernel.py; ``tuning`` is alpha, beta and kappa."""
    chart, polar, join_first = options[1], options[3] != 0, options[4] != 0
    alpha, beta, kappa = tuning[0], tuning[1], tuning[2]
    nothing, nobody = np.empty(1), np.empty((0, 2))
    T_nothing = np.empty((3, 3))
    for k in range(len(frames)):
        of_frame = slice(starts[k], starts[k + 1])
        places = numbers[of_frame]
        seen, new = np.flatnonzero(places < known), np.flatnonzero(places >= known)
        if frames[k] > 0:
            if chart == WORLD:
                predict_sampled(T, P, 3 + 2 * known, start, T_prev_body[k], Q[k], alpha, beta, kappa)
            else:
                predict(
                    chart,
                    LATEST,
                    T,
                    P,
                    landmarks[:known],
                    start,
                    nothing,
                    T_nothing,
                    nobody,
                    T_prev_body[k],
                    Q[k],
                    T_nothing,
                    seen,
                )
        nis[k], dof[k] = np.nan, 0
        for turn in range(2):
            if (turn == 0) == join_first:
                if new.size:
                    placed = augment_sampled(
                        chart,
                        polar,
                        T,
                        P,
                        landmarks,
                        known,
                        start,
                        new,
                        z[of_frame],
                        R[of_frame],
                        alpha,
                        beta,
                        kappa,
                    )
                    if not placed:
                        options[0] = NOWHERE
                        return k
                    known += new.size
            elif seen.size:
                nis[k] = correct_sampled(
                    chart,
                    polar,
                    T,
                    P,
                    landmarks[:known],
                    start,
                    seen,
                    places,
                    z[of_frame],
                    R[of_frame],
                    alpha,
                    beta,
                    kappa,
                    blas,
                )
                dof[k] = 2 * seen.size
                if not math.isfinite(nis[k]):
                    options[0] = LOST
                    return k
        poses[k] = T
        to_body(chart, T, start, P, covariances[k])
    return len(frames)
