"""The window: poses, landmarks, what was measured of them, and the cost of it all.

What the three steps of ``SlidingWindow`` work on. Landmarks are numbered by first sight; observations stand
in the order in which they came, so those of the oldest pose are the first.

========  =====================================================================
symbol    meaning (Sibley 2006; Dong-Si and Mourikis 2011 for first estimates)
========  =====================================================================
T, l      poses, oldest first, (K, n+1, n+1), and landmarks (L, n)
Q, R, z   odometry and measurement covariances, measurements
W         whiteners, W^T W = R^-1 or Q^-1
========  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamcmp.backends.entries import places_by_itself
from slamcmp.backends.far_points import FarPoints
from slamcmp.backends.robust import Kernel
from slamcmp.backends.sights import Measurements, Sights, padded
from slamcmp.backends.whitening import whitener, whiteners
from slamcmp.backends.window.cost import (
    LinearCost,
    ObservationTerms,
    OdometryTerms,
    lengths,
    observation_terms,
    odometry_terms,
    oldest_pose_cost,
    squared_residuals,
)
from slamcmp.backends.window.gauss_newton import GaussNewtonStep
from slamcmp.backends.window.marginalisation import Prior, Quadratic
from slamcmp.backends.window.robust_weights import RobustWeights
from slamcmp.geometry import retract_in_world_axes
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import BoolArray, FloatArray, Frame, IntArray, Problem

Policy = Literal["latest", "fej", "frozen"]
"""Where Jacobians are taken, as ``SlidingWindow`` describes it."""


class WindowListener:
    """Is told how the window's linear system changes; this one does nothing with it."""

    def linearised(self, prior: Prior, T: FloatArray) -> None:
        """The cost was linearised, the prior with its first pose at T (n+1, n+1)."""

    def turned(self, J: FloatArray) -> None:
        """The first pose's error so far is J (p, p) times the one from now on."""

    def marginalised(self, cost: LinearCost, measurements: Measurements) -> None:
        """The oldest pose of this cost became a prior on the next."""

    def dropped(self, landmarks: IntArray, n: int) -> None:
        """The landmarks (m,) with these numbers were marginalised."""


@dataclass
class LinearisationPoints:
    """Where the last solve took its Jacobians, and what of it first estimates pin."""

    T: FloatArray
    """(K, n+1, n+1)."""
    landmarks: FloatArray
    """(L, n)."""
    first_estimates: bool
    pose_pinned: bool = False
    """Whether the oldest pose is."""
    landmarks_pinned: int = 0
    """How many landmarks are, the first ones."""

    def at(self, T: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where Jacobians are taken when the estimate is T, l."""
        if not self.first_estimates:
            return T, landmarks
        T, landmarks = T.copy(), landmarks.copy()
        if self.pose_pinned:
            T[0] = self.T[0]
        landmarks[: self.landmarks_pinned] = self.landmarks[: self.landmarks_pinned]
        return T, landmarks


class Window:
    """The last poses and all landmarks, with everything that is known of them.

    Args:
        problem: prior and sensor (planar or spatial).
        policy: where Jacobians are taken.
        kernel: of the observations; None: they are quadratic.

    Raises:
        UsageError: the prior is singular.
    """

    def __init__(self, problem: Problem, policy: Policy, kernel: Kernel | None = None) -> None:
        self.sights = Sights(problem.sensor, entry_sensor(problem.sensor))
        n, d, p = problem.sensor.space_dim, self.sights.dim, problem.P.shape[0]
        self.n, self.p = n, p
        self.T = problem.T_world_body[None].copy()
        self.landmarks: FloatArray = np.empty((0, n))
        self.number: dict[int, int] = {}
        """Of each landmark, by id."""
        self.measurements = Measurements.none(d)
        self.points = LinearisationPoints(self.T, self.landmarks, policy == "fej")
        self._far = FarPoints()
        self.listener = WindowListener()
        self.robust = None if kernel is None else RobustWeights(kernel, d)

        W = whitener(problem.P, "the prior covariance Problem.P")
        start = Quadratic(W.T @ W, np.zeros(p))
        self.prior = Prior(start, self.T[0], self.landmarks, policy == "fej")
        """What is left of all that was marginalised: on the oldest pose and the first landmarks."""
        self.cost = LinearCost(
            start,
            OdometryTerms(np.empty((0, p, p)), np.empty((0, p, p)), np.empty((0, p))),
            ObservationTerms(np.empty((0, d, p)), np.empty((0, d, n)), np.empty((0, d))),
        )
        """About the current estimate, of all observations that have been linearised."""
        self._increments, self._odometry_W = np.empty((0, n + 1, n + 1)), np.empty((0, p, p))

    def append_pose(self, frame: Frame) -> None:
        """The frame's pose, where odometry takes the last one.

        Raises:
            UsageError: the odometry covariance is singular.
        """
        predicted = self.T[-1] @ frame.T_prev_body
        W = whitener(frame.Q, f"the odometry covariance Q of frame {frame.k}")
        self.T = np.concatenate([self.T, predicted[None]])
        self._increments = np.concatenate([self._increments, frame.T_prev_body[None]])
        self._odometry_W = np.concatenate([self._odometry_W, W[None]])
        at, _ = self.points.at(self.T, self.landmarks)
        new = odometry_terms(self.T[-2:], at[-2:], self._increments[-1:], self._odometry_W[-1:])
        self.cost.odometry = self.cost.odometry.followed_by(new)
        self.points.T = np.concatenate([self.points.T, predicted[None]])

    def append_landmarks(self, ids: IntArray, positions: FloatArray) -> None:
        """New landmarks (m,) at positions (m, n)."""
        if not ids.size:
            return
        for landmark in ids.tolist():
            self.number[landmark] = len(self.number)
        self._far.placed(positions - self.T[-1, :-1, -1])
        self.landmarks = np.concatenate([self.landmarks, positions])
        self.points.landmarks = np.concatenate([self.points.landmarks, positions])

    def append_observations(self, ids: IntArray, z: FloatArray, R: FloatArray, *, entering: bool) -> None:
        """Observations (m,) of known landmarks from the newest pose; ``cost`` does not have them yet."""
        if not ids.size:
            return
        z, W = padded(z, whiteners(R), self.sights.dim)
        pose_of = np.full(ids.size, len(self.T) - 1)
        new = Measurements(z, W, pose_of, self.numbers_of(ids), np.full(ids.size, entering))
        self.measurements = self.measurements.followed_by(new)
        if self.robust is not None:
            self.robust.append(ids.size)

    def numbers_of(self, ids: IntArray) -> IntArray:
        """Numbers (m,) of the landmarks with these ids (m,)."""
        return np.array([self.number[landmark] for landmark in ids.tolist()], dtype=np.int64)

    def linearise(self) -> None:
        """The whole cost anew about the current estimate."""
        points = self.points
        points.T, points.landmarks = points.at(self.T, self.landmarks)
        known = self.prior.landmarks.shape[0]
        self.cost = LinearCost(
            self.prior.linearised(self.T[0], self.landmarks[:known]),
            odometry_terms(self.T, points.T, self._increments, self._odometry_W),
            self._observation_terms(slice(None)),
        )
        self.listener.linearised(self.prior, self.T[0])

    def require_near_points(self, k: int) -> None:
        """Compare where landmarks lie from the poses that see them, by the last linearisation and by the
        estimates; only first estimates can differ.

        Args:
            k: the newest pose's frame, for the message.

        Raises:
            DivergedError: one lies too far off (far_points.py).
        """
        points, rows = self.points, self.measurements
        if not points.first_estimates:
            return
        r_at = points.landmarks[rows.landmark_of] - points.T[rows.pose_of, :-1, -1]
        r = self.landmarks[rows.landmark_of] - self.T[rows.pose_of, :-1, -1]
        self._far.require_near(k, r_at, r)

    def linearise_new(self) -> None:
        """The observations that ``cost`` does not have yet."""
        new = self._observation_terms(slice(len(self.cost.observations.b), None))
        self.cost.observations = self.cost.observations.followed_by(new)

    def reweigh(self, kernel: Kernel) -> None:
        """Weights of the residuals as the cost has them, the newest pose's under ``kernel``."""
        if self.robust is not None:
            newest = self.measurements.pose_of == len(self.T) - 1
            self.robust.reweigh(lengths(self.cost.observations.b), newest, kernel)

    def weighted_cost(self) -> LinearCost:
        """The linear cost with every observation's noise as its weight makes it."""
        if self.robust is None:
            return self.cost
        # The newest observations may not be in the cost yet.
        weights = self.robust.weights[: len(self.cost.observations.b)]
        return replace(self.cost, observations=self.cost.observations.weighted(weights))

    def gauss_newton_step(self) -> GaussNewtonStep:
        """The minimum of the linear cost.

        Raises:
            DivergedError: the information matrix is not positive definite, or not finite.
        """
        cost, rows = self.weighted_cost(), self.measurements
        return GaussNewtonStep(
            cost.prior,
            cost.odometry,
            cost.observations,
            rows.pose_of,
            rows.landmark_of,
            len(self.landmarks),
            self.n,
        )

    def chi_square(self) -> float:
        """The true cost of the current estimate."""
        return self.cost_after(np.zeros((len(self.T), self.p)), np.zeros_like(self.landmarks))

    def cost_after(self, pose_step: FloatArray, landmark_step: FloatArray) -> float:
        """The true cost where steps (K, p) and (L, n) would lead."""
        T, _ = retract_in_world_axes(self.T, pose_step)
        landmarks, rows = self.landmarks + landmark_step, self.measurements
        known = self.prior.landmarks.shape[0]
        return self.prior.linearised(T[0], landmarks[:known]).c + squared_residuals(
            self._sights_of(rows),
            T,
            self._increments,
            self._odometry_W,
            T[rows.pose_of],
            landmarks[rows.landmark_of],
            rows.z,
            rows.W,
            None if self.robust is None else self.robust.price,
        )

    def move(self, pose_step: FloatArray, landmark_step: FloatArray) -> FloatArray:
        """Take steps (K, p) and (L, n); the linear cost keeps its Jacobians.

        Returns:
            What turns pose errors from the axes before to those after, (K, p, p).
        """
        self.T, turn = retract_in_world_axes(self.T, pose_step)
        self.landmarks = self.landmarks + landmark_step
        self.cost.moved(self.measurements, pose_step, landmark_step, turn)
        self.listener.turned(turn[0].T)
        return turn

    def marginalise_oldest_pose(self) -> None:
        """Turn all costs of the oldest pose into a prior on the next pose and the landmarks.

        Raises:
            DivergedError: the pose is not determined.
        """
        rows, cost = self.measurements, self.weighted_cost()
        leaving = rows.from_first_pose()
        if self.robust is not None:
            self.robust.leave(leaving, lengths(self.cost.observations.b))
        quadratic, known = oldest_pose_cost(
            cost.prior, cost.odometry, cost.observations.of(slice(leaving)), rows.landmark_of[:leaving]
        )
        quadratic = quadratic.eliminated(np.arange(self.p))
        self.listener.marginalised(cost, rows)
        self.T, self.points.T = self.T[1:], self.points.T[1:]
        self._increments, self._odometry_W = self._increments[1:], self._odometry_W[1:]
        self.cost = LinearCost(
            quadratic, cost.odometry.of(slice(1, None)), self.cost.observations.of(slice(leaving, None))
        )
        rows = rows.of(slice(leaving, None))
        self.measurements = rows.renumbered(rows.pose_of - 1, rows.landmark_of)
        self.points.pose_pinned, self.points.landmarks_pinned = True, known

    def marginalise_unseen(self, ids: list[int] | None = None) -> None:
        """The same for the landmarks that no pose has seen; with ``ids`` for these of them.

        Raises:
            DivergedError: a landmark is not determined.
        """
        rows = self.measurements
        stays = np.zeros(len(self.landmarks), dtype=bool)
        if ids is not None:
            stays[:] = True
            stays[self.numbers_of(np.array(ids, dtype=np.int64))] = False
        stays[rows.landmark_of] = True
        if not stays.all():
            self._keep(stays)

    def forget(self, ids: list[int]) -> None:
        """Take these landmarks out of the window, with all that was measured of them.

        The linear cost loses them at once, the prior when it is next centred.

        Raises:
            DivergedError: a landmark is not determined.
        """
        if not ids:
            return
        stays = np.ones(len(self.landmarks), dtype=bool)
        stays[self.numbers_of(np.array(ids))] = False
        rows = stays[self.measurements.landmark_of]
        self.measurements = self.measurements.of(rows)
        self.cost.observations = self.cost.observations.of(rows)
        if self.robust is not None:
            self.robust.keep(rows)
        self._keep(stays)

    def _keep(self, stays: BoolArray) -> None:
        """Marginalise the landmarks that are not marked (L,) and that no observation is of."""
        rows = self.measurements
        gone = np.flatnonzero(~stays)
        in_prior = gone[self.p + self.n * gone < self.cost.prior.eta.size]
        states = (self.p + self.n * in_prior[:, None] + np.arange(self.n)).ravel()
        if states.size:
            self.cost.prior = self.cost.prior.eliminated(states)
        self.listener.dropped(gone, self.n)
        self.landmarks, self.points.landmarks = self.landmarks[stays], self.points.landmarks[stays]
        self.measurements = rows.renumbered(rows.pose_of, (np.cumsum(stays) - 1)[rows.landmark_of])
        self.points.landmarks_pinned -= in_prior.size
        ids = list(self.number)
        self.number = {ids[old]: new for new, old in enumerate(np.flatnonzero(stays).tolist())}

    def centre_prior(self) -> None:
        """Let the linear prior be the prior from now on, about the current estimate."""
        centre = self.landmarks[: self.points.landmarks_pinned].copy()
        self.prior = Prior(self.cost.prior, self.T[0], centre, self.points.first_estimates)

    def _observation_terms(self, rows: slice) -> ObservationTerms:
        some = self.measurements.of(rows)
        T_at, landmarks_at = self.points.at(self.T, self.landmarks)
        return observation_terms(
            self._sights_of(some),
            self.T[some.pose_of],
            self.landmarks[some.landmark_of],
            T_at[some.pose_of],
            landmarks_at[some.landmark_of],
            some.z,
            some.W,
        )

    def _sights_of(self, rows: Measurements) -> Sights:
        entering: BoolArray | None = None if places_by_itself(self.sights.sensor) else rows.entering
        return replace(self.sights, entering=entering)
