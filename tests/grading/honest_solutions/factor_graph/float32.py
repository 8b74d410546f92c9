"""Linear algebra in single precision."""

import numpy as np

from slamcmp.geometry import exp


def f(array):
    return np.asarray(array, dtype=np.float32)


def whiten(covariance, *arrays):
    back = np.linalg.inv(np.linalg.cholesky(f(covariance)))
    return tuple(back @ f(array) for array in arrays)


def linear_system(factors, size):
    Lam, eta = np.zeros((size, size), dtype=np.float32), np.zeros(size, dtype=np.float32)
    for r, blocks in factors:
        J = np.zeros((len(r), size), dtype=np.float32)
        for start, block in blocks:
            J[:, start : start + block.shape[1]] = block
        Lam += J.T @ J
        eta -= J.T @ f(r)
    return Lam, eta


def gauss_newton_step(poses, landmarks, Lam, eta):
    step = np.linalg.solve(f(Lam), f(eta))
    split = 3 * len(poses)
    moved = [f(T @ exp(part)) for T, part in zip(poses, step[:split].reshape(-1, 3))]
    return np.array(moved), f(landmarks) + step[split:].reshape(-1, 2)


def marginalise(Lam, eta, keep):
    Lam, eta = f(Lam), f(eta)
    drop = np.setdiff1d(np.arange(len(eta)), keep)
    C = np.linalg.solve(Lam[np.ix_(drop, drop)], Lam[np.ix_(drop, keep)]).T
    return Lam[np.ix_(keep, keep)] - C @ Lam[np.ix_(drop, keep)], eta[keep] - C @ eta[drop]
