"""The state inside begins with the landmarks, the youngest first, and ends with the pose; told as asked."""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse


def inside(size):
    """Where each entry of the order inside stands in the order asked for."""
    landmarks = np.arange(3, size).reshape(-1, 2)[::-1].ravel()
    return np.concatenate([landmarks, np.arange(3)])


def predict(T_world_body, P, T_prev_body, Q):
    order = inside(len(P))
    F, noise = np.eye(len(P)), np.zeros_like(P)
    F[-3:, -3:] = adjoint(inverse(T_prev_body))
    noise[-3:, -3:] = Q
    told = np.empty_like(P)
    told[np.ix_(order, order)] = F @ P[np.ix_(order, order)] @ F.T + noise
    return T_world_body @ T_prev_body, told


def update(T_world_body, landmarks, P, numbers, z, R):
    order = inside(len(P))
    mine = P[np.ix_(order, order)]
    back = np.argsort(numbers)[::-1]
    H = stacked_jacobian(T_world_body, landmarks, np.asarray(numbers)[back])[:, order]
    y = SENSOR.residual(z, SENSOR.predict(T_world_body, landmarks[numbers]))[back].ravel()
    K = np.linalg.solve(H @ mine @ H.T + block_diagonal(R[back]), H @ mine).T
    step, told = np.empty(len(P)), np.empty_like(P)
    step[order] = K @ y
    told[np.ix_(order, order)] = mine - K @ H @ mine
    return T_world_body @ exp(step[:3]), landmarks + step[3:].reshape(-1, 2), told


class EkfSlam(EkfSlam):
    """Known landmarks are taken in from the last of the frame to the first."""

    def update(self, frame):
        if frame.k > 0:
            self.T, self.P = predict(self.T, self.P, frame.T_prev_body, frame.Q)
        known = [i for i, name in enumerate(frame.ids) if name in self.ids][::-1]
        numbers = [self.ids.index(frame.ids[i]) for i in known]
        for i, name in enumerate(frame.ids):
            if name not in self.ids:
                self.positions, self.P = augment(self.T, self.positions, self.P, frame.z[i], frame.R[i])
                self.ids.append(int(name))
        if numbers:
            self.T, self.positions, self.P = update(
                self.T, self.positions, self.P, numbers, frame.z[known], frame.R[known]
            )
