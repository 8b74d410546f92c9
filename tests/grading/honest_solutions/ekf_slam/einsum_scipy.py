"""Einsum for every product, scipy.linalg for what is solved; R block by block."""

import numpy as np
import scipy.linalg

from slamcmp.geometry import adjoint, exp, inverse


def predict(T_world_body, P, T_prev_body, Q):
    F = scipy.linalg.block_diag(adjoint(inverse(T_prev_body)), np.eye(len(P) - 3))
    moved = np.einsum("ij,jk,lk->il", F, P, F)
    return np.einsum("ij,jk->ik", T_world_body, T_prev_body), moved + scipy.linalg.block_diag(
        Q, 0 * P[3:, 3:]
    )


def update(T_world_body, landmarks, P, numbers, z, R):
    seen = landmarks[numbers]
    by_pose, by_landmark = SENSOR.jacobians(T_world_body, seen)
    H = np.zeros((len(numbers), 2, len(P)))
    H[:, :, :3] = by_pose
    for row, number in enumerate(numbers):
        H[row][:, 3 + 2 * number : 5 + 2 * number] = by_landmark[row]
    H = H.reshape(-1, len(P))
    S = np.einsum("ij,jk,lk->il", H, P, H) + scipy.linalg.block_diag(*R)
    L = scipy.linalg.cholesky(S, lower=True)
    half = scipy.linalg.solve_triangular(L, np.einsum("ij,jk->ik", H, P), lower=True)
    y = SENSOR.residual(z, SENSOR.predict(T_world_body, seen)).reshape(-1)
    step = np.einsum("ji,j->i", half, scipy.linalg.solve_triangular(L, y, lower=True))
    return (
        T_world_body @ exp(step[:3]),
        landmarks + step[3:].reshape(-1, 2),
        P - np.einsum("ji,jk->ik", half, half),
    )
