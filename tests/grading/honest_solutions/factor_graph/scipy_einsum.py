"""scipy.linalg where something is solved, einsum where something is summed."""

import numpy as np
import scipy.linalg

from slamcmp.geometry import exp


def whiten(covariance, *arrays):
    L = scipy.linalg.cholesky(covariance, lower=True)
    return tuple(scipy.linalg.solve_triangular(L, array, lower=True) for array in arrays)


def linear_system(factors, size):
    Lam, eta = np.zeros((size, size)), np.zeros(size)
    for r, blocks in factors:
        index = np.concatenate([start + np.arange(J.shape[1]) for start, J in blocks])
        J = np.concatenate([J for _, J in blocks], axis=1)
        np.add.at(Lam, (index[:, None], index), np.einsum("ki,kj->ij", J, J))
        np.subtract.at(eta, index, np.einsum("ki,k->i", J, r))
    return Lam, eta


def gauss_newton_step(poses, landmarks, Lam, eta):
    dx = scipy.linalg.solve(Lam, eta, assume_a="pos")
    split = 3 * len(poses)
    return [T @ exp(dx[3 * i : 3 * i + 3]) for i, T in enumerate(poses)], landmarks + dx[split:].reshape(
        -1, 2
    )


def marginalise(Lam, eta, keep):
    keep = list(map(int, keep))
    drop = [index for index in range(len(eta)) if index not in keep]
    factor = scipy.linalg.cho_factor(Lam[np.ix_(drop, drop)])
    solved = scipy.linalg.cho_solve(factor, np.column_stack([Lam[np.ix_(drop, keep)], eta[drop]]))
    across = Lam[np.ix_(keep, drop)]
    return Lam[np.ix_(keep, keep)] - across @ solved[:, :-1], eta[keep] - across @ solved[:, -1]


def marginal_covariance(Lam, keep):
    columns = np.eye(len(Lam))[:, keep]
    return scipy.linalg.lu_solve(scipy.linalg.lu_factor(Lam), columns)[keep]
