"""Factor graph of a planar robot with landmarks: built, solved, marginalised (Dellaert and Kaess 2017)."""

import numpy as np

from slamcmp.geometry import adjoint, exp, inverse, log, right_jacobian
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Estimate, Landmarks

SENSOR = RangeBearing()


def prior_factor(T, T_prior, P):
    """What is known about one pose beforehand."""
    r = log(inverse(T_prior) @ T)
    return whiten(P, r, np.linalg.inv(right_jacobian(r)))


def odometry_factor(T_i, T_j, T_ij, Q):
    """How far two poses are from the odometry between them."""
    r = log(inverse(T_ij) @ inverse(T_i) @ T_j)
    J_j = np.linalg.inv(right_jacobian(r))
    J_i = -J_j @ adjoint(inverse(T_j) @ T_i)
    return whiten(Q, r, J_i, J_j)


def observation_factor(T, landmark, z, R):
    """How far the prediction is from an observation."""
    H_pose, H_landmark = SENSOR.jacobians(T, landmark)
    r = -SENSOR.residual(z, SENSOR.predict(T, landmark))
    return whiten(R, r, H_pose, H_landmark)


def whiten(covariance, *arrays):
    """Each array times L⁻¹, with covariance = L Lᵀ."""
    L = np.linalg.cholesky(covariance)
    return tuple(np.linalg.solve(L, array) for array in arrays)


def linear_system(factors, size):
    """Lam dx = eta: the sum over all factors."""
    Lam, eta = np.zeros((size, size)), np.zeros(size)
    for r, blocks in factors:
        for start, J in blocks:
            rows = slice(start, start + J.shape[1])
            eta[rows] += -J.T @ r
            for other, J_other in blocks:
                Lam[rows, other : other + J_other.shape[1]] += J.T @ J_other
    return Lam, eta


def gauss_newton_step(poses, landmarks, Lam, eta):
    """To the minimum of the linearised cost."""
    dx = np.linalg.solve(Lam, eta)
    split = 3 * len(poses)
    moved = [T @ exp(step) for T, step in zip(poses, dx[:split].reshape(-1, 3), strict=True)]
    return np.array(moved), landmarks + dx[split:].reshape(-1, 2)


def marginalise(Lam, eta, keep):
    """Schur complement: what the system says about the variables that stay."""
    drop = np.setdiff1d(np.arange(len(eta)), keep)
    C = np.linalg.solve(Lam[np.ix_(drop, drop)], Lam[np.ix_(drop, keep)]).T
    Lam_keep = Lam[np.ix_(keep, keep)] - C @ Lam[np.ix_(drop, keep)]
    eta_keep = eta[keep] - C @ eta[drop]
    return (Lam_keep + Lam_keep.T) / 2, eta_keep


def marginal_covariance(Lam, keep):
    """Block of the inverse."""
    return np.linalg.inv(marginalise(Lam, np.zeros(len(Lam)), keep)[0])


def smooth(graph, poses, landmarks, iterations):
    """Gauss–Newton on the whole graph, linearised anew at every step."""
    last = 3 * len(poses) - 3 + np.arange(3)
    for _ in range(iterations):
        factors = linearise(graph, poses, landmarks)
        Lam, eta = linear_system(factors, 3 * len(poses) + 2 * len(landmarks))
        poses, landmarks = gauss_newton_step(poses, landmarks, Lam, eta)
    return poses, landmarks, marginal_covariance(Lam, last)


def linearise(graph, poses, landmarks):
    """Every factor at the current values, poses first in the state."""
    prior = graph["prior"]
    r, J = prior_factor(poses[0], prior["T"], prior["P"])
    factors = [(r, [(0, J)])]
    for move in graph["odometry"]:
        i, j = move["i"], move["j"]
        r, J_i, J_j = odometry_factor(poses[i], poses[j], move["T_ij"], move["Q"])
        factors.append((r, [(3 * i, J_i), (3 * j, J_j)]))
    for seen in graph["observations"]:
        i, number = seen["i"], seen["landmark"]
        r, J_pose, J_landmark = observation_factor(poses[i], landmarks[number], seen["z"], seen["R"])
        factors.append((r, [(3 * i, J_pose), (3 * len(poses) + 2 * number, J_landmark)]))
    return factors


class WindowOne:
    """Every past pose marginalised after one Gauss–Newton step."""

    def __init__(self, problem):
        self.T = problem.T_world_body
        self.positions, self.ids = np.empty((0, 2)), []
        # What marginalising left. Its minimum is at the estimate, so its eta is 0.
        self.Lam = np.linalg.inv(problem.P)

    def update(self, frame):
        """Cost construction, one Gauss–Newton step, marginalisation."""
        new = self.T @ frame.T_prev_body
        poses = np.stack([self.T, new]) if frame.k > 0 else new[None]
        self._join(frame, new)
        Lam, eta = self._cost(frame, poses)
        poses, self.positions = gauss_newton_step(poses, self.positions, Lam, eta)
        self.T = poses[-1]
        self.Lam, _ = marginalise(Lam, eta, np.arange(3 * len(poses) - 3, len(eta)))

    def _cost(self, frame, poses):
        """Normal equations of the past pose (if there is one), the new one and all landmarks."""
        split = 3 * len(poses)
        factors = []
        if frame.k > 0:
            r, J_i, J_j = odometry_factor(*poses, frame.T_prev_body, frame.Q)
            factors.append((r, [(0, J_i), (3, J_j)]))
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            number = self.ids.index(landmark)
            r, J_pose, J_landmark = observation_factor(poses[-1], self.positions[number], z, R)
            factors.append((r, [(split - 3, J_pose), (split + 2 * number, J_landmark)]))
        Lam, eta = linear_system(factors, split + 2 * len(self.ids))
        # The prior is on the past pose and on the landmarks that joined before.
        old = np.concatenate([np.arange(3), split + np.arange(len(self.Lam) - 3)])
        Lam[np.ix_(old, old)] += self.Lam
        return Lam, eta

    def _join(self, frame, T):
        for landmark, z in zip(frame.ids.tolist(), frame.z, strict=True):
            if landmark not in self.ids:
                self.positions = np.vstack([self.positions, SENSOR.invert(T, z)])
                self.ids.append(landmark)

    def estimate(self):
        """Pose and its covariance in the body tangent."""
        return Estimate(self.T, marginal_covariance(self.Lam, np.arange(3)))

    def landmarks(self):
        """The map."""
        Sigma = np.linalg.inv(self.Lam)
        blocks = [Sigma[i : i + 2, i : i + 2] for i in range(3, len(Sigma), 2)]
        return Landmarks(self.ids, self.positions, np.array(blocks).reshape(-1, 2, 2))
