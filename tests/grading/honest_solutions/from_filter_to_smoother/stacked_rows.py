"""Whitened rows stacked, the plane as complex numbers, Cholesky factors, and differences for derivatives."""

import numpy as np


def solve(window, Lam, eta):
    L = np.linalg.cholesky(Lam)
    dx = np.linalg.lstsq(L.T, np.linalg.lstsq(L, eta, rcond=None)[0], rcond=None)[0]
    split = 3 * len(window["poses"])
    poses = [
        [x + dx[3 * i], y + dx[3 * i + 1], np.angle(np.exp(1j * (theta + dx[3 * i + 2])))]
        for i, (x, y, theta) in enumerate(window["poses"])
    ]
    return np.array(poses), np.add(window["landmarks"], dx[split:].reshape(-1, 2))


def schur(Lam, eta, keep):
    drop = sorted(set(range(len(eta))) - set(np.asarray(keep).tolist()))
    L = np.linalg.cholesky(Lam[np.ix_(drop, drop)])
    half = np.linalg.solve(L, np.column_stack([Lam[np.ix_(drop, keep)], eta[drop]]))
    gone = half.T @ half
    return Lam[np.ix_(keep, keep)] - gone[:-1, :-1], eta[keep] - gone[:-1, -1]


def world_motions(poses, landmarks):
    def moved(x, y, turn):
        c, s = np.cos(turn), np.sin(turn)
        new = [[x + c * a - s * b, y + s * a + c * b, t + turn] for a, b, t in poses]
        return np.concatenate(
            [np.ravel(new), np.ravel([[x + c * a - s * b, y + s * a + c * b] for a, b in landmarks])]
        )

    h = 1e-6
    return np.column_stack([(moved(*(h * e)) - moved(*(-h * e))) / (2 * h) for e in np.eye(3)])


def construct(window, poses_at, landmarks_at):
    poses, landmarks, prior = window["poses"], window["landmarks"], window["prior"]
    split = 3 * len(poses)
    size = split + 2 * len(landmarks)
    rows, right = [np.zeros((0, size))], [np.zeros(0)]

    def stack(covariance, r, blocks):
        L = np.linalg.inv(np.linalg.cholesky(covariance))
        J = np.zeros((len(r), size))
        for start, block in blocks:
            J[:, start : start + len(block[0])] += block
        rows.append(L @ J)
        right.append(L @ r)

    for i, ((x, y, turn), Q) in enumerate(zip(window["motions"], window["Q"])):
        a, b = poses[i], poses[i + 1]
        way = (complex(*b[:2]) - complex(*a[:2])) * np.exp(-1j * a[2]) - complex(x, y)
        way *= np.exp(-1j * turn)
        r = np.array([way.real, way.imag, np.angle(np.exp(1j * (b[2] - a[2] - turn)))])
        a, b = poses_at[i], poses_at[i + 1]
        back = np.exp(-1j * (a[2] + turn))
        by_place = np.array([[back.real, -back.imag, 0], [back.imag, back.real, 0], [0, 0, 1]])
        away = -1j * (complex(*b[:2]) - complex(*a[:2])) * back
        by_old = -by_place + np.outer([away.real, away.imag, 0], [0, 0, 1])
        stack(Q, r, [(3 * i, by_old), (3 * i + 3, by_place)])
    for i, number, z, R in zip(window["pose_of"], window["landmark_of"], window["z"], window["R"]):
        away = (complex(*landmarks[number]) - complex(*poses[i][:2])) * np.exp(-1j * poses[i][2])
        r = np.array([abs(away) - z[0], np.angle(away * np.exp(-1j * z[1]))])
        away = complex(*landmarks_at[number]) - complex(*poses_at[i][:2])
        unit = away / abs(away)
        by_point = np.array([[unit.real, unit.imag], [-unit.imag / abs(away), unit.real / abs(away)]])
        by_pose = np.hstack([-by_point, [[0.0], [-1.0]]])
        stack(R, r, [(3 * i, by_pose), (split + 2 * number, by_point)])
    J, r = np.concatenate(rows), np.concatenate(right)
    Lam, eta = J.T @ J, -J.T @ r
    count = len(prior["eta"])
    S = np.zeros((count, size))
    S[:3, :3] = np.eye(3)
    S[3:, split : split + count - 3] = np.eye(count - 3)
    change = np.concatenate([poses[0], landmarks.ravel()])[:count] - prior["centre"]
    change[2] = np.angle(np.exp(1j * change[2]))
    return Lam + S.T @ prior["Lam"] @ S, eta + S.T @ (prior["eta"] - prior["Lam"] @ change)
