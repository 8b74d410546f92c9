"""The back end as a graph of two poses in information form: the past one goes when the next frame comes."""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse
from slamcmp.types import Estimate, Landmarks


class EkfSlam(EkfSlam):
    def __init__(self, problem):
        self.T, self.Lam = problem.T_world_body, np.linalg.inv(problem.P)
        self.positions, self.ids = np.empty((0, 2)), []
        self.poses = 1

    def update(self, frame):
        if self.poses == 2:
            self.Lam = without_first_pose(self.Lam)
        if frame.k > 0:
            J = np.hstack([-adjoint(inverse(frame.T_prev_body)), np.eye(3)])
            size = len(self.Lam) + 3
            grown = np.zeros((size, size))
            old = np.r_[0:3, 6:size]
            grown[np.ix_(old, old)] = self.Lam
            grown[:6, :6] += J.T @ np.linalg.inv(frame.Q) @ J
            self.Lam, self.T, self.poses = grown, self.T @ frame.T_prev_body, 2
        seen, eta = len(self.ids), np.zeros(len(self.Lam))
        for name, z, R in zip(frame.ids.tolist(), frame.z, frame.R):
            if name in self.ids:
                continue
            self.ids.append(name)
            self.positions = np.vstack([self.positions, SENSOR.invert(self.T, z)])
            self.Lam = np.pad(self.Lam, ((0, 2), (0, 2)))
            eta = np.pad(eta, (0, 2))
            self._take(name, z, R, eta)
        for name, z, R in zip(frame.ids.tolist(), frame.z, frame.R):
            if self.ids.index(name) < seen:
                self._take(name, z, R, eta)
        step = np.linalg.solve(self.Lam, eta)
        first = 3 * self.poses
        self.T = self.T @ exp(step[first - 3 : first])
        self.positions = self.positions + step[first:].reshape(-1, 2)

    def _take(self, name, z, R, eta):
        number = self.ids.index(name)
        H_pose, H_landmark = SENSOR.jacobians(self.T, self.positions[number])
        J = np.zeros((2, len(self.Lam)))
        first = 3 * self.poses
        J[:, first - 3 : first] = H_pose
        J[:, first + 2 * number : first + 2 * number + 2] = H_landmark
        weight = J.T @ np.linalg.inv(R)
        self.Lam = self.Lam + weight @ J
        eta += weight @ SENSOR.residual(z, SENSOR.predict(self.T, self.positions[number]))

    def _covariance(self):
        return np.linalg.inv(without_first_pose(self.Lam) if self.poses == 2 else self.Lam)

    def estimate(self):
        return Estimate(self.T, self._covariance()[:3, :3])

    def landmarks(self):
        P = self._covariance()
        blocks = [P[i : i + 2, i : i + 2] for i in range(3, len(P), 2)]
        return Landmarks(self.ids, self.positions, np.array(blocks).reshape(-1, 2, 2))


def without_first_pose(Lam):
    return Lam[3:, 3:] - Lam[3:, :3] @ np.linalg.inv(Lam[:3, :3]) @ Lam[:3, 3:]
