"""Covariances and means in single precision."""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse


def f(array):
    return np.asarray(array, dtype=np.float32)


def predict(T_world_body, P, T_prev_body, Q):
    F = np.eye(len(P), dtype=np.float32)
    F[:3, :3] = f(adjoint(inverse(T_prev_body)))
    new = F @ f(P) @ F.T
    new[:3, :3] += f(Q)
    return f(T_world_body) @ f(T_prev_body), new


def augment(T_world_body, landmarks, P, z, R):
    position = f(SENSOR.invert(T_world_body, z))
    H_pose, H_landmark = map(f, SENSOR.jacobians(T_world_body, position))
    back = np.linalg.inv(H_landmark)
    whole = np.eye(len(P) + 2, len(P), dtype=np.float32)
    whole[-2:, :3] = -back @ H_pose
    new = whole @ f(P) @ whole.T
    new[-2:, -2:] += back @ f(R) @ back.T
    return np.vstack([f(landmarks), position]), new


def update(T_world_body, landmarks, P, numbers, z, R):
    y = f(SENSOR.residual(z, SENSOR.predict(T_world_body, landmarks[numbers]))).ravel()
    H = f(stacked_jacobian(T_world_body, landmarks, numbers))
    P = f(P)
    S = H @ P @ H.T + f(block_diagonal(R))
    K = P @ H.T @ np.linalg.inv(S)
    step = K @ y
    return f(T_world_body @ exp(step[:3])), f(landmarks) + step[3:].reshape(-1, 2), P - K @ S @ K.T


class EkfSlam(EkfSlam):
    def __init__(self, problem):
        super().__init__(problem)
        self.T, self.P, self.positions = f(self.T), f(self.P), f(self.positions)
