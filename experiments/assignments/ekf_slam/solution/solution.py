"""EKF-SLAM in the plane, pose error in the body tangent (Solà 2014, sec. 5; Solà 2018, eq. 152-168)."""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Estimate, Landmarks

SENSOR = RangeBearing()


def predict(T_world_body, P, T_prev_body, Q):
    """Move to the next pose; the past one is marginalised."""
    A = adjoint(inverse(T_prev_body))
    P_new = P.copy()
    P_new[:3, :3] = A @ P[:3, :3] @ A.T + Q
    P_new[:3, 3:] = A @ P[:3, 3:]
    P_new[3:, :3] = P_new[:3, 3:].T
    return T_world_body @ T_prev_body, P_new


def augment(T_world_body, landmarks, P, z, R):
    """Let a new landmark join the state."""
    position = SENSOR.invert(T_world_body, z)
    H_pose, H_landmark = SENSOR.jacobians(T_world_body, position)
    back = np.linalg.inv(H_landmark)
    G = -back @ H_pose
    cross = G @ P[:3]
    corner = G @ P[:3, :3] @ G.T + back @ R @ back.T
    return np.vstack([landmarks, position]), np.block([[P, cross.T], [cross, corner]])


def update(T_world_body, landmarks, P, numbers, z, R):
    """One update with all observations of known landmarks."""
    seen = landmarks[numbers]
    y = SENSOR.residual(z, SENSOR.predict(T_world_body, seen)).ravel()
    H = stacked_jacobian(T_world_body, landmarks, numbers)
    noise = block_diagonal(R)
    S = H @ P @ H.T + noise
    gain = np.linalg.solve(S, H @ P).T
    step = gain @ y
    P_new = P - gain @ H @ P
    moved = landmarks + step[3:].reshape(-1, 2)
    return T_world_body @ exp(step[:3]), moved, (P_new + P_new.T) / 2


def stacked_jacobian(T_world_body, landmarks, numbers):
    """H of all observations by the whole state, (2 m, 3 + 2 L)."""
    H_pose, H_landmark = SENSOR.jacobians(T_world_body, landmarks[numbers])
    H = np.zeros((2 * len(numbers), 3 + 2 * len(landmarks)))
    for row, number in enumerate(numbers):
        H[2 * row : 2 * row + 2, :3] = H_pose[row]
        H[2 * row : 2 * row + 2, 3 + 2 * number : 5 + 2 * number] = H_landmark[row]
    return H


def block_diagonal(blocks):
    """(2 m, 2 m) from (m, 2, 2)."""
    whole = np.zeros((2 * len(blocks), 2 * len(blocks)))
    for index, block in enumerate(blocks):
        whole[2 * index : 2 * index + 2, 2 * index : 2 * index + 2] = block
    return whole


class EkfSlam:
    """The whole back end."""

    def __init__(self, problem):
        self.T, self.P = problem.T_world_body, problem.P
        self.positions = np.empty((0, 2))
        self.ids = []

    def update(self, frame):
        """Move, let new landmarks join, update with the known ones."""
        if frame.k > 0:
            self.T, self.P = predict(self.T, self.P, frame.T_prev_body, frame.Q)
        known = np.array([landmark in self.ids for landmark in frame.ids.tolist()], dtype=bool)
        numbers = np.array([self.ids.index(landmark) for landmark in frame.ids[known].tolist()], dtype=int)
        self._join(frame, ~known)
        if len(numbers):
            self.T, self.positions, self.P = update(
                self.T, self.positions, self.P, numbers, frame.z[known], frame.R[known]
            )

    def _join(self, frame, new):
        for index in np.flatnonzero(new):
            self.positions, self.P = augment(self.T, self.positions, self.P, frame.z[index], frame.R[index])
            self.ids.append(int(frame.ids[index]))

    def estimate(self):
        """Pose and its covariance in the body tangent."""
        return Estimate(self.T, self.P[:3, :3])

    def landmarks(self):
        """The map."""
        blocks = [self.P[i : i + 2, i : i + 2] for i in range(3, len(self.P), 2)]
        return Landmarks(self.ids, self.positions, np.array(blocks).reshape(-1, 2, 2))
