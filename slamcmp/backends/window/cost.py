"""The residuals of a window of poses and their Jacobians, whitened.

The cost is that of the filters: ``log(T_prev_body^-1 T_{k-1}^-1 T_k)`` for odometry and ``h(T, l) - z`` for
observations. Every function answers with terms of ``|b + A delta|^2``, delta in the body axes of the
*current* poses and additive for landmarks. A pose error (rotation, translation) keeps its world components
when it is read at another pose: after a step, and where Jacobians are taken at another point than the current
one (first estimates). That is what keeps the null space of rigid motions of the world, which is
[R^T (t + w x p), w] for poses and t + w x l for landmarks, at the points of the Jacobians.

========  =====================================================================
symbol    meaning
========  =====================================================================
A, b      whitened Jacobian and residual
Lam, eta  information matrix and vector (marginalisation.py)
H         A's blocks for observations: H_pose (M, d, p) and H_land (M, d, n)
W         square root of an information matrix, W^T W = R^-1 or Q^-1
T, l      poses (K, n+1, n+1) and landmarks (L, n) of the current estimate
J_r       right Jacobian of the group (Solà 2018, eq. 67)
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slamcmp.backends.sights import Measurements, Sights
from slamcmp.backends.window.marginalisation import Quadratic
from slamcmp.geometry import adjoint, change_of_axes, inverse, log, right_jacobian
from slamcmp.types import BoolArray, FloatArray, IntArray


@dataclass
class OdometryTerms:
    """Whitened terms of the increments between neighbours: row i ties pose i to pose i + 1."""

    A_prev: FloatArray
    """(K-1, p, p)."""
    A_next: FloatArray
    """(K-1, p, p)."""
    b: FloatArray
    """(K-1, p)."""

    def recentre(self, step: FloatArray) -> None:
        """Move the origin of delta by ``step`` (K, p)."""
        self.b += np.einsum("kij,kj->ki", self.A_prev, step[:-1])
        self.b += np.einsum("kij,kj->ki", self.A_next, step[1:])

    def turn(self, turn: FloatArray) -> None:
        """Read pose errors in other axes: ``turn`` (K, p, p) is orthogonal, new axes from old ones."""
        back = np.swapaxes(turn, 1, 2)
        self.A_prev, self.A_next = self.A_prev @ back[:-1], self.A_next @ back[1:]

    def followed_by(self, other: OdometryTerms) -> OdometryTerms:
        """These rows, then the other's."""
        return OdometryTerms(
            np.concatenate([self.A_prev, other.A_prev]),
            np.concatenate([self.A_next, other.A_next]),
            np.concatenate([self.b, other.b]),
        )

    def of(self, rows: slice) -> OdometryTerms:
        """These rows."""
        return OdometryTerms(self.A_prev[rows], self.A_next[rows], self.b[rows])


@dataclass
class ObservationTerms:
    """Whitened terms of the observations."""

    H_pose: FloatArray
    """(M, d, p)."""
    H_land: FloatArray
    """(M, d, n)."""
    b: FloatArray
    """(M, d)."""

    def recentre(self, step: FloatArray, land_step: FloatArray) -> None:
        """Move the origin of delta by the steps (M, p) and (M, n) of each observation's two variables."""
        self.b += np.einsum("mij,mj->mi", self.H_pose, step)
        self.b += np.einsum("mij,mj->mi", self.H_land, land_step)

    def turn(self, turn: FloatArray) -> None:
        """Read pose errors in other axes: ``turn`` (M, p, p) is orthogonal, new axes from old ones."""
        self.H_pose = self.H_pose @ np.swapaxes(turn, 1, 2)

    def followed_by(self, other: ObservationTerms) -> ObservationTerms:
        """These rows, then the other's."""
        return ObservationTerms(
            np.concatenate([self.H_pose, other.H_pose]),
            np.concatenate([self.H_land, other.H_land]),
            np.concatenate([self.b, other.b]),
        )

    def weighted(self, weights: FloatArray) -> ObservationTerms:
        """Each row's noise R becoming R / w, w (M,)."""
        root = np.sqrt(weights)[:, None, None]
        return ObservationTerms(root * self.H_pose, root * self.H_land, root[:, 0] * self.b)

    def of(self, rows: slice | BoolArray) -> ObservationTerms:
        """These rows."""
        return ObservationTerms(self.H_pose[rows], self.H_land[rows], self.b[rows])


@dataclass
class LinearCost:
    """The whole cost of a window about its estimate, delta = 0."""

    prior: Quadratic
    """On the first pose and the first landmarks."""
    odometry: OdometryTerms
    observations: ObservationTerms

    @property
    def value(self) -> float:
        """At delta = 0: chi-square of everything so far."""
        squares = float((self.odometry.b**2).sum() + (self.observations.b**2).sum())
        return self.prior.c + squares

    def moved(
        self, rows: Measurements, pose_step: FloatArray, landmark_step: FloatArray, turn: FloatArray
    ) -> None:
        """Stand about another estimate, with the same Jacobians.

        Args:
            rows: the observations, M.
            pose_step: to it, (K, p).
            landmark_step: (L, n).
            turn: from the axes of pose errors before to those after, (K, p, p).
        """
        self.odometry.recentre(pose_step)
        self.odometry.turn(turn)
        self.observations.recentre(pose_step[rows.pose_of], landmark_step[rows.landmark_of])
        self.observations.turn(turn[rows.pose_of])
        known = self.prior.eta.size - pose_step.shape[1]
        step = np.concatenate([pose_step[0], landmark_step.ravel()[:known]])
        self.prior = self.prior.recentred(step).with_pose_error(turn[0].T)


def odometry_terms(T: FloatArray, at: FloatArray, increments: FloatArray, W: FloatArray) -> OdometryTerms:
    """Terms of the increments (K-1, n+1, n+1) between poses T (K, …), Jacobians at the poses ``at``."""
    back = inverse(increments)
    residual = log(back @ inverse(T[:-1]) @ T[1:])
    relative = inverse(at[:-1]) @ at[1:]
    # Whatever stands here, the same in both: rigid motions of the world stay invisible.
    A_next = W @ np.linalg.inv(right_jacobian(residual))
    A_prev = -A_next @ adjoint(inverse(relative))
    turn = change_of_axes(T, at)
    return OdometryTerms(A_prev @ turn[:-1], A_next @ turn[1:], np.einsum("kij,kj->ki", W, residual))


def observation_terms(
    sights: Sights,
    T: FloatArray,
    landmarks: FloatArray,
    at: FloatArray,
    landmarks_at: FloatArray,
    z: FloatArray,
    W: FloatArray,
) -> ObservationTerms:
    """Terms of M observations z (M, d); poses (M, …) and landmarks (M, n) stand once per observation."""
    residual = sights.errors(T, landmarks, z)
    H_pose, H_land = sights.derivatives(at, landmarks_at, T, landmarks)
    H_pose = H_pose @ change_of_axes(T, at)
    return ObservationTerms(W @ H_pose, W @ H_land, np.einsum("mij,mj->mi", W, residual))


def lengths(b: FloatArray) -> FloatArray:
    """Of whitened residuals (M, d), (M,)."""
    found: FloatArray = np.sqrt((b**2).sum(axis=1))
    return found


def squared_residuals(
    sights: Sights,
    T: FloatArray,
    increments: FloatArray,
    odometry_W: FloatArray,
    T_seen_from: FloatArray,
    landmarks: FloatArray,
    z: FloatArray,
    W: FloatArray,
    price: Callable[[FloatArray], FloatArray] | None = None,
) -> float:
    """Sum of squares of the whitened residuals of all increments and observations, without Jacobians.

    ``price`` says what an observation costs whose residual has the length r (M,), where that is not r².
    """
    steps = log(inverse(increments) @ inverse(T[:-1]) @ T[1:])
    errors = sights.errors(T_seen_from, landmarks, z)
    total = (np.einsum("kij,kj->ki", odometry_W, steps) ** 2).sum()
    whitened = np.einsum("mij,mj->mi", W, errors)
    total += (whitened**2).sum() if price is None else price(lengths(whitened)).sum()
    return float(total)


def oldest_pose_cost(
    prior: Quadratic, odometry: OdometryTerms, observations: ObservationTerms, numbers: IntArray
) -> tuple[Quadratic, int]:
    """All terms that hold the oldest pose, as one cost on [oldest, next, landmarks].

    Args:
        prior: on the oldest pose and the first landmarks.
        odometry: its first row ties the oldest pose to the next.
        observations: those from the oldest pose.
        numbers: their landmarks, (m,).

    Returns:
        The cost and how many landmarks it is about: the first ones, for they are numbered by first sight.
    """
    H_pose, H_land, b = observations.H_pose, observations.H_land, observations.b
    p, n = H_pose.shape[2], H_land.shape[2]
    known = max((prior.eta.size - p) // n, int(numbers.max(initial=-1)) + 1)
    size = 2 * p + n * known
    Lam, eta = np.zeros((size, size)), np.zeros(size)
    own = np.concatenate([np.arange(p), np.arange(2 * p, p + prior.eta.size)])
    Lam[np.ix_(own, own)] = prior.Lam
    eta[own] = prior.eta
    pair = np.concatenate([odometry.A_prev[0], odometry.A_next[0]], axis=1)
    Lam[: 2 * p, : 2 * p] += pair.T @ pair
    eta[: 2 * p] -= pair.T @ odometry.b[0]
    A = np.zeros((b.size, size))
    A[:, :p] = H_pose.reshape(b.size, p)
    rows = np.arange(b.size).reshape(b.shape)[:, :, None]
    columns = (2 * p + n * numbers[:, None] + np.arange(n))[:, None, :]
    A[rows, columns] = H_land
    Lam += A.T @ A
    eta -= A.T @ b.ravel()
    return Quadratic(Lam, eta, prior.c + float((odometry.b[0] ** 2).sum() + (b**2).sum())), known
