"""One Gauss-Newton step for a chain of poses and the landmarks seen from it, and what share of it to take.

The poses but the last are tied only to their neighbours, so their information matrix is block tridiagonal
and a banded Cholesky factorisation eliminates them (all at once, with the landmarks as right-hand sides);
what remains, the head, is dense on the landmarks and the last pose. The last pose stands last, so its
marginal covariance is the inverse of the factor's last block. For K poses, L landmarks the step costs
O(K p² + K p (n L)² + (n L)³).

========  =====================================================================
symbol    meaning
========  =====================================================================
A         information matrix of the chain without its last pose, banded
B         its coupling with the head, (c, h)
C         information matrix of the head (h, h): landmarks, then the last pose
L_A       Cholesky factor of A, banded; W = L_A^-1 B
L_S       Cholesky factor of the Schur complement S = C - W^T W
========  =====================================================================

Source: Triggs et al. 2000, "Bundle adjustment: a modern synthesis", sec. 6; for the share, Aitken's
relaxation (Irons and Tuck 1969).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpotrf, dpotri, dtbtrs, dtrtrs

from slamcmp.backends.window.cost import ObservationTerms, OdometryTerms
from slamcmp.backends.window.marginalisation import Quadratic
from slamcmp.errors import DivergedError
from slamcmp.types import FloatArray, IntArray


class GaussNewtonStep:
    """The minimum of the linearised cost, and its covariances.

    Args:
        prior: on the first pose and the first landmarks.
        odometry: between neighbours.
        observations: of all poses.
        pose_of, landmark_of: indices (M,) of each observation's variables; a pair at most once.
        landmarks: L.
        n: dimension of space.

    Raises:
        DivergedError: the information matrix is not positive definite, or not finite.
    """

    def __init__(
        self,
        prior: Quadratic,
        odometry: OdometryTerms,
        observations: ObservationTerms,
        pose_of: IntArray,
        landmark_of: IntArray,
        landmarks: int,
        n: int,
    ) -> None:
        p = observations.H_pose.shape[2]
        self._p, self._n, self._count = p, n, landmarks
        self._poses = odometry.b.shape[0] + 1
        diagonal, link, slope = _chain_information(prior, odometry, observations, pose_of)
        land, land_slope = _landmark_information(prior, observations, landmark_of, landmarks)
        cross = np.zeros((self._poses, p, landmarks, n))
        H_pose_t = np.swapaxes(observations.H_pose, 1, 2)
        cross[pose_of, :, landmark_of, :] = H_pose_t @ observations.H_land
        cross = cross.reshape(self._poses * p, landmarks * n)
        cross[:p, : prior.eta.size - p] += prior.Lam[:p, p:]

        h = landmarks * n
        c = self._chain = (self._poses - 1) * p
        C = np.zeros((h + p, h + p))
        C[:h, :h] = land
        C[h:, h:] = diagonal[-1]
        C[h:, :h] = cross[c:]
        C[:h, h:] = cross[c:].T
        head_slope = np.concatenate([land_slope, slope[-1]])
        e: FloatArray = np.empty(0)
        failed = 0
        if c:
            right = np.zeros((c, h + p + 1), order="F")
            right[:, :h] = cross[:c]
            right[c - p :, h : h + p] = link[-1]
            right[:, -1] = slope[:-1].ravel()
            self._L_A, failed = dpbtrf(_banded(diagonal[:-1], link[:-1]), lower=1, overwrite_ab=1)
            solved = dtbtrs(self._L_A, right, uplo="L", overwrite_b=1)[0]
            self._W, e = solved[:, :-1], solved[:, -1]
            C -= self._W.T @ self._W
            head_slope -= self._W.T @ e
        self._L_S, head_failed = dpotrf(C, lower=1)
        y = dtrtrs(self._L_S, head_slope, lower=1)[0]
        head = dtrtrs(self._L_S, y, lower=1, trans=1)[0]
        # A NaN passes through both factorisations; it always reaches the solution.
        if failed or head_failed or not np.isfinite(head).all():
            raise DivergedError(
                "the information matrix of the window is not positive definite, or not finite: the estimate "
                "has left the region where the measurements determine it"
            )
        chain = self._chain_solve(e - self._W @ head) if c else e
        self.pose_step = np.concatenate([chain, head[h:]]).reshape(self._poses, p)
        """(K, p)."""
        self.landmark_step = head[:h].reshape(landmarks, n)
        """(L, n)."""
        squares = float((odometry.b**2).sum() + (observations.b**2).sum())
        self.chi2 = prior.c + squares - float(y @ y) - float(e @ e)
        """Of the linearised cost at its minimum."""

    def last_pose_covariance(self) -> FloatArray:
        """(p, p)."""
        L = self._L_S[-self._p :, -self._p :]
        inverse = dtrtrs(L, np.eye(self._p), lower=1)[0]
        P: FloatArray = inverse.T @ inverse
        return P

    def joint_covariance(self) -> FloatArray:
        """Of the last pose and the landmarks, in this order, (p + n L, p + n L)."""
        lower, _ = dpotri(self._L_S, lower=1)
        h = self._count * self._n
        P = np.tril(lower) + np.tril(lower, -1).T
        order = np.concatenate([np.arange(h, h + self._p), np.arange(h)])
        joint: FloatArray = P[np.ix_(order, order)]
        return joint

    def first_pose_covariance(self) -> FloatArray:
        """(p, p)."""
        if not self._chain:
            return self.last_pose_covariance()
        p = self._p
        unit = np.zeros((self._chain, p), order="F")
        unit[:p] = np.eye(p)
        half = dtbtrs(self._L_A, unit, uplo="L")[0]
        rest = dtrtrs(self._L_S, self._W.T @ half, lower=1)[0]
        P: FloatArray = half.T @ half + rest.T @ rest
        return P

    def pose_covariances(self) -> FloatArray:
        """(K, p, p), each pose's own block: those of the chain alone plus what the head adds."""
        p, poses = self._p, self._poses
        P = np.empty((poses, p, p))
        P[-1] = self.last_pose_covariance()
        if not self._chain:
            return P
        V = dtbtrs(self._L_A, self._W, uplo="L", trans="T")[0]
        X = dtrtrs(self._L_S, V.T, lower=1)[0].reshape(-1, poses - 1, p)
        X = np.moveaxis(X, 0, 1)
        P[:-1] = np.swapaxes(X, 1, 2) @ X
        # Takahashi's recursion for a block tridiagonal matrix: blocks of its inverse, last to first.
        own, below = _factor_blocks(self._L_A, poses - 1, p)
        inverses = np.linalg.inv(own)
        Z = inverses[-1].T @ inverses[-1]
        P[-2] += Z
        for i in range(poses - 3, -1, -1):
            G = below[i] @ inverses[i]
            Z = inverses[i].T @ inverses[i] + G.T @ Z @ G
            P[i] += Z
        return P

    def _chain_solve(self, right: FloatArray) -> FloatArray:
        solution: FloatArray = dtbtrs(self._L_A, right[:, None], uplo="L", trans="T")[0][:, 0]
        return solution


def _chain_information(
    prior: Quadratic, odometry: OdometryTerms, observations: ObservationTerms, pose_of: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the poses: diagonal blocks (K, p, p), those right of them (K-1, p, p), and the vector (K, p)."""
    poses, p = odometry.b.shape[0] + 1, observations.H_pose.shape[2]
    prev_t, next_t = np.swapaxes(odometry.A_prev, 1, 2), np.swapaxes(odometry.A_next, 1, 2)
    H_pose_t = np.swapaxes(observations.H_pose, 1, 2)
    diagonal, slope = np.zeros((poses, p, p)), np.zeros((poses, p))
    diagonal[:-1] += prev_t @ odometry.A_prev
    diagonal[1:] += next_t @ odometry.A_next
    slope[:-1] -= (prev_t @ odometry.b[..., None])[..., 0]
    slope[1:] -= (next_t @ odometry.b[..., None])[..., 0]
    np.add.at(diagonal, pose_of, H_pose_t @ observations.H_pose)
    np.add.at(slope, pose_of, -(H_pose_t @ observations.b[..., None])[..., 0])
    diagonal[0] += prior.Lam[:p, :p]
    slope[0] += prior.eta[:p]
    return diagonal, prev_t @ odometry.A_next, slope


def _landmark_information(
    prior: Quadratic, observations: ObservationTerms, landmark_of: IntArray, landmarks: int
) -> tuple[FloatArray, FloatArray]:
    """Information matrix (n L, n L) and vector (n L,) of the landmarks."""
    p, n = observations.H_pose.shape[2], observations.H_land.shape[2]
    H_land_t = np.swapaxes(observations.H_land, 1, 2)
    blocks, slopes = np.zeros((landmarks, n, n)), np.zeros((landmarks, n))
    np.add.at(blocks, landmark_of, H_land_t @ observations.H_land)
    np.add.at(slopes, landmark_of, -(H_land_t @ observations.b[..., None])[..., 0])
    Lam, slope = np.zeros((landmarks * n, landmarks * n)), slopes.ravel()
    starts = np.arange(landmarks) * n
    for i in range(n):
        for j in range(n):
            Lam[starts + i, starts + j] = blocks[:, i, j]
    known = prior.eta.size - p
    Lam[:known, :known] += prior.Lam[p:, p:]
    slope[:known] += prior.eta[p:]
    return Lam, slope


def _banded(diagonal: FloatArray, link: FloatArray) -> FloatArray:
    """Lower band storage (2p, K p) of blocks (K, p, p) with ``link[i] = A[i, i+1]`` (K-1, p, p)."""
    poses, p, _ = diagonal.shape
    band = np.zeros((2 * p, poses * p), order="F")
    view = band.T.reshape(poses, p, 2 * p)
    for column in range(p):
        view[:, column, : p - column] = diagonal[:, column:, column]
        view[:-1, column, p - column : 2 * p - column] = link[:, column, :]
    return band


def _factor_blocks(L_A: FloatArray, poses: int, p: int) -> tuple[FloatArray, FloatArray]:
    """Diagonal (K, p, p) and sub-diagonal (K-1, p, p) blocks of a banded factor."""
    view = L_A.T.reshape(poses, p, 2 * p)
    own, below = np.zeros((poses, p, p)), np.zeros((max(poses - 1, 0), p, p))
    for column in range(p):
        own[:, column:, column] = view[:, column, : p - column]
        below[:, :, column] = view[:-1, column, p - column : 2 * p - column]
    return own, below
