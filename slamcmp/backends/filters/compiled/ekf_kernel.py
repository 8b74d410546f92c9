"""EKF-SLAM in the plane, one frame or many in one call of compiled code.

The steps are in ekf_steps.py and iterated_steps.py, the symbols as there.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from slamcmp.backends.filters.compiled.compiling import GIVEN, GIVEN_NUMBERS, OWN, OWN_NUMBERS, compiled
from slamcmp.backends.filters.compiled.ekf_steps import DONE, NOWHERE, augment, correct, predict
from slamcmp.backends.filters.compiled.iterated_steps import iterate
from slamcmp.backends.filters.compiled.planar import to_body
from slamcmp.types import FloatArray, IntArray


@compiled(
    nb.int64(
        *(OWN[2], OWN[2], OWN[2], OWN[2], OWN[2], OWN[1], OWN[1]),
        *(nb.int64, OWN_NUMBERS, OWN[1], nb.int64),
        *(GIVEN_NUMBERS, GIVEN[3], GIVEN[3], GIVEN[3], GIVEN_NUMBERS, GIVEN_NUMBERS, GIVEN[2], GIVEN[3]),
        *(OWN[3], OWN[3], OWN[1], OWN_NUMBERS),
    )
)
def run(
    T: FloatArray,
    P: FloatArray,
    landmarks: FloatArray,
    points: FloatArray,
    T_memory: FloatArray,
    memory: FloatArray,
    start: FloatArray,
    known: int,
    options: IntArray,
    tuning: FloatArray,
    blas: int,
    frames: IntArray,
    T_prev_body: FloatArray,
    Q: FloatArray,
    T_true: FloatArray,
    starts: IntArray,
    numbers: IntArray,
    z: FloatArray,
    R: FloatArray,
    poses: FloatArray,
    covariances: FloatArray,
    nis: FloatArray,
    dof: IntArray,
) -> int:
    """Frames one after the other, observations ``starts[k]`` to ``starts[k + 1]`` being those of the k-th.

    Fills in what is known after each: poses and covariances in the body tangent (K, 3, 3), nis (K,), which is
    NaN where nothing was corrected, and dof (K,). Returns the number of frames done; fewer than K where the
    filter failed, and then ``options[0]`` says why.

    Args:
        T, P, landmarks: the state, with room for the new landmarks.
        points, T_memory, memory: what a policy remembers: of each landmark, of the pose, and otherwise.
        start: where the right-invariant chart's lever begins, (2,).
        known: landmarks in the state.
        options: fault, chart, policy, polar, new landmarks join first, iterations (0: not the iterated one).
        tuning: farthest points, tolerance of the iteration.
        blas: address of ``dsyrk``, or 0.
        frames: their k.
        T_true: the truth, where the policy has use for it.
        numbers: places of the observed landmarks in the state; ``known`` and on for new ones, in order.
    """
    chart, policy, polar = options[1], options[2], options[3] != 0
    join_first, iterations = options[4] != 0, options[5]
    G, since, T_linear = np.empty((2, 3)), np.zeros(3), np.empty((3, 3))
    for k in range(len(frames)):
        first, last = starts[k], starts[k + 1]
        places = numbers[first:last]
        seen, new = np.flatnonzero(places < known), np.flatnonzero(places >= known)
        if frames[k] > 0:
            predict(
                chart,
                policy,
                T,
                P,
                landmarks[:known],
                start,
                memory,
                T_memory,
                points,
                T_prev_body[k],
                Q[k],
                T_true[k],
                places[seen],
            )
        nis[k], dof[k], fault = np.nan, 0, DONE
        since[:] = 0.0
        T_linear[:] = T
        for turn in range(2):
            if (turn == 0) == join_first:
                for i in new:
                    number = known
                    placed = augment(
                        chart,
                        policy,
                        polar,
                        T_linear,
                        P,
                        landmarks,
                        number,
                        start,
                        memory,
                        T_memory,
                        points,
                        z[first + i],
                        R[first + i],
                        G,
                    )
                    if not placed:
                        options[0] = NOWHERE
                        return k
                    for j in range(3):
                        landmarks[number, 0] += G[0, j] * since[j]
                        landmarks[number, 1] += G[1, j] * since[j]
                    known += 1
            elif seen.size:
                of_frame = slice(first, last)
                if iterations:
                    nis[k], fault = iterate(
                        polar,
                        T,
                        P,
                        landmarks[:known],
                        start,
                        seen,
                        places,
                        z[of_frame],
                        R[of_frame],
                        iterations,
                        tuning[1],
                        blas,
                        since,
                        T_linear,
                    )
                else:
                    nis[k], fault = correct(
                        chart,
                        policy,
                        polar,
                        T,
                        P,
                        landmarks[:known],
                        start,
                        memory,
                        T_memory,
                        points,
                        seen,
                        places,
                        z[of_frame],
                        R[of_frame],
                        tuning[0],
                        blas,
                    )
                    T_linear[:] = T
                dof[k] = 2 * seen.size
                if fault != DONE:
                    options[0] = fault
                    return k
        poses[k] = T
        to_body(chart, T, start, P, covariances[k])
    return len(frames)
