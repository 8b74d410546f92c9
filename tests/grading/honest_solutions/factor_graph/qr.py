"""Smoothing by QR of the stacked Jacobian; steps by Cholesky factors."""

import numpy as np

from slamcmp.geometry import exp


def gauss_newton_step(poses, landmarks, Lam, eta):
    L = np.linalg.cholesky(Lam)
    return moved(poses, landmarks, np.linalg.solve(L.T, np.linalg.solve(L, eta)))


def moved(poses, landmarks, step):
    split = 3 * len(poses)
    new = [T @ exp(part) for T, part in zip(poses, step[:split].reshape(-1, 3))]
    return np.array(new), landmarks + step[split:].reshape(-1, 2)


def smooth(graph, poses, landmarks, iterations):
    size = 3 * len(poses) + 2 * len(landmarks)
    for _ in range(iterations):
        rows, right = [], []
        for r, blocks in linearise(graph, poses, landmarks):
            J = np.zeros((len(r), size))
            for start, block in blocks:
                J[:, start : start + block.shape[1]] = block
            rows.append(J)
            right.append(-r)
        Q, R = np.linalg.qr(np.vstack(rows))
        step = np.linalg.solve(R, Q.T @ np.concatenate(right))
        at = 3 * len(poses)
        poses, landmarks = moved(poses, landmarks, step)
    back = np.linalg.inv(R)[at - 3 : at]
    return poses, landmarks, back @ back.T
