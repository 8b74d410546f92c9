"""One run of one filter from its first frame to its scores: world, filter and judgement in one loop.

The order of events is that of the experiment's runner: the start is drawn, the robot moves before it looks,
the filter predicts, corrects and grows, and its answer is held against the truth.
"""

from __future__ import annotations

import math

from slamcmp.ensembles.kernels.draws import PRIOR, normals
from slamcmp.ensembles.kernels.filters import augment, correct, into_axes, predict, to_body
from slamcmp.ensembles.kernels.settings import (
    CHART,
    FIRST_LOOK,
    JOIN_FIRST,
    NEES_FROM,
    NEES_HEADING,
    NEES_POSE,
    NEES_POSITION,
    OWN_MAP,
    POLICY,
    PRIOR_HEADING,
    PRIOR_POSITION,
    SCORES,
    SQUARED_HEADING,
    SQUARED_POSITION,
    TRUTH,
)
from slamcmp.ensembles.kernels.target import add, body, lane, lanes, sync
from slamcmp.ensembles.kernels.world import annulus, look, odometry, sort_seen
from slamcmp.types.arrays import FloatArray, IntArray


@body
def drawn_start(seed: int, numbers: FloatArray, pose: FloatArray) -> None:
    """The prior's mean: the true start, the origin, moved by exp(-draw) (worlds/simulate.py)."""
    a, b = normals(seed, 0, PRIOR, 0)
    turn, _ = normals(seed, 0, PRIOR, 1)
    x, y = -numbers[PRIOR_POSITION] * a, -numbers[PRIOR_POSITION] * b
    theta = -numbers[PRIOR_HEADING] * turn
    u, v = 1.0 - theta * theta / 6.0, theta * (0.5 - theta * theta / 24.0)
    if abs(theta) >= 1e-4:
        u, v = math.sin(theta) / theta, 2.0 * math.sin(0.5 * theta) ** 2 / theta
    pose[0], pose[1], pose[2], pose[3] = math.cos(theta), math.sin(theta), u * x - v * y, v * x + u * y


@body
def judge(k: int, pose: FloatArray, true_pose: FloatArray, P: FloatArray, scores: FloatArray) -> None:
    """Errors and NEES of one frame (metrics/, results/judgements/ensemble.py); P is of the body tangent."""
    c, s = pose[0], pose[1]
    dx, dy = true_pose[2] - pose[2], true_pose[3] - pose[3]
    x, y = c * dx + s * dy, c * dy - s * dx
    theta = math.atan2(c * true_pose[1] - s * true_pose[0], c * true_pose[0] + s * true_pose[1])
    scores[SQUARED_POSITION], scores[SQUARED_HEADING] = x * x + y * y, theta * theta
    scores[NEES_HEADING] = scores[NEES_POSITION] = scores[NEES_POSE] = 0.0
    if k < NEES_FROM:
        return
    a, b, d, e, f, g = P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]
    scores[NEES_HEADING] = theta * theta / g
    scores[NEES_POSITION] = 0.5 * (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b)
    # xi = log(T_hat^-1 T): the logarithm's translation, V^-1 times the offset.
    half = 0.5 * theta
    w = 1.0 - theta * theta / 12.0 if abs(theta) < 1e-4 else half / math.tan(half)
    u, v = w * x + half * y, w * y - half * x
    # By the Cholesky factor of P.
    l00 = math.sqrt(a)
    l10, l20 = b / l00, e / l00
    l11 = math.sqrt(d - l10 * l10)
    l21 = (f - l20 * l10) / l11
    l22 = math.sqrt(g - l20 * l20 - l21 * l21)
    p = u / l00
    q = (v - l10 * p) / l11
    r = (theta - l20 * p - l21 * q) / l22
    scores[NEES_POSE] = (p * p + q * q + r * r) / 3.0


@body
def run(
    seed: int,
    numbers: FloatArray,
    options: IntArray,
    path: FloatArray,
    controls: FloatArray,
    landmarks_given: FloatArray,
    shared: tuple[FloatArray, ...],
    marks: tuple[IntArray, ...],
    own: tuple[FloatArray, ...],
    scores: FloatArray,
    curves: FloatArray,
    keep: bool,
    log: tuple[FloatArray, ...],
) -> int:
    """One run; fills in its scores (5,) and adds to the curves (K, 2); the frame of its failure, or -1.

    Args:
        path: the true poses: cosine, sine, x, y, (K, 4).
        controls: true speed and turn rate of each step, (K - 1, 2).
        landmarks_given: (L, 2); not used with OWN_MAP.
        shared: memory of the block: P, W, S, H, dx, landmarks, points, truth, z.
        marks: memory of the block: visible, places, order, own states.
        own: memory of each thread: pose, last, memory, start, Q, noise, G, N, P of the pose, scores.
        keep: fill in the log of this run: increments (K, 4), Q (K, 3, 3), seen (K, L), z (K, L, 2),
            the filter's poses (K, 4) and covariances in the body tangent (K, 3, 3), landmarks (L, 2), and
            the start (4,).
    """
    P, W, S, H, dx, landmarks, points, truth, z = shared
    visible, places, order, states = marks
    pose, last, memory, start, Q, noise, G, N, of_pose, of_frame = own
    increments, log_Q, log_seen, log_z, log_poses, log_P, log_map, log_start = log
    for number in range(lane(), len(truth), lanes()):
        places[number] = -1
        if options[OWN_MAP] == 0:
            truth[number, 0], truth[number, 1] = landmarks_given[number, 0], landmarks_given[number, 1]
    if options[OWN_MAP] != 0:
        annulus(seed, numbers, truth)
    drawn_start(seed, numbers, pose)
    start[0], start[1] = pose[2], pose[3]
    memory[0], memory[1], memory[2], memory[3] = 0.0, 0.0, pose[2], pose[3]
    for i in range(4):
        last[i] = path[0, i] if options[POLICY] == TRUTH else pose[i]
    for i in range(3):
        for j in range(3):
            Q[i, j] = 0.0
    Q[0, 0] = Q[1, 1] = numbers[PRIOR_POSITION] ** 2
    Q[2, 2] = numbers[PRIOR_HEADING] ** 2
    into_axes(options[CHART], pose[0], pose[1], 0.0, 0.0, Q, noise)
    if lane() == 0:
        for i in range(3):
            for j in range(i, 3):
                P[i, j] = noise[i, j]
    sync()
    if keep and lane() == 0:
        for i in range(4):
            log_start[i] = pose[i]
        for number in range(len(truth)):
            log_map[number, 0], log_map[number, 1] = truth[number, 0], truth[number, 1]
    for j in range(lane(), SCORES, lanes()):
        scores[j] = 0.0
    sync()
    count = 0
    frames = len(path)
    for k in range(frames):
        known, seen = 0, 0
        if k >= options[FIRST_LOOK]:
            look(seed, k, path[k], truth, numbers, options, visible, z)
            known, seen = sort_seen(visible, places, order)
        if k > 0:
            by = odometry(seed, k, controls[k - 1, 0], controls[k - 1, 1], numbers, options, Q)
            if keep and lane() == 0:
                for i in range(4):
                    increments[k, i] = by[i]
                for i in range(3):
                    for j in range(3):
                        log_Q[k, i, j] = Q[i, j]
            predict(
                options,
                pose,
                last,
                memory,
                start,
                landmarks,
                points,
                count,
                P,
                by,
                Q,
                noise,
                path[k],
                order,
                places,
                known,
            )
        if keep and lane() == 0:
            for m in range(seen):
                number = order[m]
                log_seen[k, number] = 1.0
                log_z[k, number, 0], log_z[k, number, 1] = z[number, 0], z[number, 1]
        for turn in range(2):
            if (turn == 0) == (options[JOIN_FIRST] != 0):
                for m in range(known, seen):
                    number = order[m]
                    augment(
                        options,
                        numbers,
                        pose,
                        last,
                        memory,
                        landmarks,
                        points,
                        truth[number, 0],
                        truth[number, 1],
                        count,
                        z[number, 0],
                        z[number, 1],
                        P,
                        H,
                        G,
                        N,
                    )
                    if lane() == 0:
                        places[number] = count
                    sync()
                    count += 1
            elif known > 0:
                fine = correct(
                    options,
                    numbers,
                    pose,
                    last,
                    memory,
                    start,
                    landmarks,
                    points,
                    count,
                    order,
                    places,
                    states,
                    known,
                    z,
                    P,
                    W,
                    S,
                    H,
                    dx,
                )
                if not fine:
                    for j in range(lane(), SCORES, lanes()):
                        scores[j] = math.nan
                    sync()
                    return k
        to_body(options[CHART], pose, start, P, of_pose)
        judge(k, pose, path[k], of_pose, of_frame)
        if lane() == 0:
            for j in range(SCORES):
                scores[j] += of_frame[j] / frames
            add(curves, k, 0, of_frame[SQUARED_POSITION])
            add(curves, k, 1, of_frame[SQUARED_HEADING])
            if keep:
                for i in range(4):
                    log_poses[k, i] = pose[i]
                for i in range(3):
                    for j in range(3):
                        log_P[k, i, j] = of_pose[i, j]
        sync()
    return -1
