"""Sliding-window smoothing: the dial from filter to smoother.

The course's three steps, each one method: cost construction (``_append_pose``, ``_observe``), Gauss-Newton
(``_solve``), and marginalisation (``_marginalise_oldest``). Two knobs turn a filter into a smoother: how
many poses are kept (``window``) and how often the window is solved (``iterations``). Window 1 with one
iteration is EKF-SLAM, with iterations to convergence the iterated EKF; an infinite window solved to
convergence is the batch solution at every frame (tests/oracles hold these to rounding).

A pose leaves the window with the Jacobians of the last solve, the ones that the reported covariance comes
from: nothing is relinearised between solving and marginalising. Afterwards the prior's origin is the current
estimate.

Errors of poses are additive in the world, as in ``ekf_slam``, and written in the body axes of the current
estimate: a step turns these axes, and with them all linear terms (``turn``).

========  =====================================================================
symbol    meaning (Sibley 2006; Dong-Si and Mourikis 2011 for first estimates)
========  =====================================================================
T         poses of the window, oldest first, (K, n+1, n+1)
Q, R, z   odometry and measurement covariances, measurements
W         whiteners, W^T W = R^-1 or Q^-1
P         covariances, poses in the body tangent
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from slamcmp.backends.entries import entering, has_blind_side, placed, places_by_itself, with_image
from slamcmp.backends.filters.unanchored import Linearisation, UnanchoredWindow
from slamcmp.backends.relaxation import relaxed_share
from slamcmp.backends.whitening import whitener, whiteners
from slamcmp.backends.window.cost import (
    ObservationTerms,
    OdometryTerms,
    observation_terms,
    odometry_terms,
    oldest_pose_cost,
    squared_residuals,
)
from slamcmp.backends.window.gauss_newton import GaussNewtonStep
from slamcmp.backends.window.marginalisation import Prior, Quadratic
from slamcmp.backends.window.sights import Sights, padded
from slamcmp.geometry import retract_in_world_axes
from slamcmp.models.sensors import entry_sensor
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, Trajectory

HALVINGS = 8
"""Most halvings of a step that raises the cost; what is left then moves nothing, and ends the frame."""


@back_ends.register("sliding_window")
class SlidingWindow:
    """Fixed-lag smoothing of the last poses and all landmarks, by Gauss-Newton with exact marginalisation.

    Every frame costs O(w (n L)²+ (n L)³) an iteration for w poses and L landmarks; with ``window: null``
    w is the number of frames so far, so a run is quadratic in its length (hundreds of frames, not tens of
    thousands).

    Args:
        problem: prior and sensor (planar or spatial).
        window: poses kept, the current one included; null keeps all (full smoothing).
        iterations: most Gauss-Newton iterations a frame; if more than one, a step after one that jumped over
            the minimum is shortened, and a step that would raise the cost is halved until it does not.
        tolerance: iterations end when no component of a whole step [m, rad] is larger.
        linearisation: where Jacobians are taken. "latest": at the current estimate. "fej": variables that
            share a cost with marginalised ones keep the point of their first one (first-estimates
            Jacobians). "frozen": every measurement keeps the linear form of the frame it came in.
        landmarks: "keep" all in the state, or "drop_unseen": marginalise those that no pose of the window
            has seen; seen again, they start anew (where one measurement does not place a landmark, as a
            single camera's does not, what is measured of it is dropped, and counted).

    Raises:
        UsageError: the prior or an odometry covariance is singular.
        DataError: a measurement that should place a landmark does not.
        DivergedError: the information matrix is not positive definite, or not finite, or most landmarks that
            a camera sees are behind it.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        window: Annotated[int, Ge(1)] | None = 10,
        iterations: Annotated[int, Ge(1)] = 10,
        tolerance: Annotated[float, Gt(0)] = 1e-6,
        linearisation: Literal["latest", "fej", "frozen"] = "latest",
        landmarks: Literal["keep", "drop_unseen"] = "keep",
    ) -> None:
        self._sights = Sights(problem.sensor, entry_sensor(problem.sensor))
        self._sensor = problem.sensor
        self._window = window
        self._iterations, self._tolerance = iterations, tolerance
        self._first_estimates = linearisation == "fej"
        self._frozen = linearisation == "frozen"
        self._drop_unseen = landmarks == "drop_unseen"
        n, d, p = problem.sensor.space_dim, self._sights.dim, problem.P.shape[0]
        self._n, self._p = n, p

        W = whitener(problem.P, "the prior covariance Problem.P")
        self._T = problem.T_world_body[None].copy()
        start = Quadratic(W.T @ W, np.zeros(p))
        self._prior = Prior(start, self._T[0], np.empty((0, n)), self._first_estimates)
        self._linear_prior = self._prior.quadratic
        self._increments, self._odometry_W = np.empty((0, n + 1, n + 1)), np.empty((0, p, p))
        self._odometry = OdometryTerms(np.empty((0, p, p)), np.empty((0, p, p)), np.empty((0, p)))
        self._pose_of, self._landmark_of = np.empty(0, np.int64), np.empty(0, np.int64)
        self._z, self._W = np.empty((0, d)), np.empty((0, d, d))
        self._entering = np.empty(0, dtype=bool)
        self._observations = ObservationTerms(np.empty((0, d, p)), np.empty((0, d, n)), np.empty((0, d)))
        self._landmarks = np.empty((0, n))
        self._number: dict[int, int] = {}

        # Where the last solve took its Jacobians, and the part of it that first estimates pin.
        self._T_at, self._landmarks_at = self._T.copy(), self._landmarks.copy()
        self._pose_pinned, self._pinned = False, 0

        self._step: GaussNewtonStep
        # From the axes in which the step was computed to those in which covariances are told, (K, p, p).
        self._turn: FloatArray
        self._joint: FloatArray | None = None
        self._used, self._last_size = 0, 0.0
        self._dof, self._dropped = 0, 0
        self._t: list[float] = []
        self._left: list[tuple[FloatArray, FloatArray]] = []
        self._unanchored: UnanchoredWindow | None = None

    def update(self, frame: Frame) -> None:
        """Append the frame's pose, marginalise what leaves the window, take in observations and solve."""
        if frame.k > 0:
            self._append_pose(frame)
            if self._window is not None and len(self._T) > self._window:
                self._marginalise_oldest(set(frame.ids.tolist()))
        self._t.append(frame.t)
        self._observe(frame)
        self._solve()

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T[-1], turned(self._step.last_pose_covariance(), self._turn[-1]))

    def landmarks(self) -> Landmarks:
        """The landmarks in the state, in the order of first sight."""
        ids = np.fromiter(self._number, dtype=np.int64, count=len(self._number))
        n, p = self._n, self._p
        blocks = self._cached_joint()[p:, p:].reshape(ids.size, n, ids.size, n)
        index = np.arange(ids.size)
        return Landmarks(ids, self._landmarks, blocks[index, :, index, :])

    def joint_covariance(self) -> FloatArray:
        """P of the current pose and the landmarks, (p + n L, p + n L)."""
        return self._cached_joint().copy()

    def trajectory(self) -> Trajectory:
        """Each pose as it left the window, or as it stands in it: with a hindsight of at most w - 1 frames.

        With ``window: null`` every pose with full hindsight; with window 1 the filter's own estimates.
        """
        poses = [T for T, _ in self._left] + list(self._T)
        covariances = [P for _, P in self._left] + list(turned(self._step.pose_covariances(), self._turn))
        return Trajectory(np.array(self._t), np.array(poses), np.array(covariances))

    def diagnostics(self) -> Mapping[str, float]:
        """Landmarks, iterations used, largest component of the last step, chi-square with its dof, and how
        many of the frame's measurements were dropped (entries.py).

        Chi-square is that of all measurements so far: the window's plus what marginalisation left over. For
        window 1 with one iteration it is the sum of the NIS.
        """
        return {
            "landmarks": len(self._number),
            "iterations": self._used,
            "last_step": self._last_size,
            "chi2": self._step.chi2,
            "dof": self._dof,
            "dropped": self._dropped,
        }

    def record_linearisation(self) -> None:
        """Keep what :meth:`linearisation` needs, from the first frame on."""
        self._unanchored = UnanchoredWindow(self._p)

    def linearisation(self) -> Linearisation:
        """What the last solve's linear system claims about the pose, and where its Jacobians were taken."""
        assert self._unanchored is not None
        root, scale = self._unanchored.told(
            self._odometry, self._observations, self._pose_of, self._landmark_of
        )
        numbers = self._landmark_of[self._pose_of == len(self._T) - 1]
        if not numbers.size:
            return Linearisation(root, scale)
        at = self._landmarks_at[numbers]
        return Linearisation(root, scale, self._T_at[-1], at, self._landmarks[numbers])

    def _append_pose(self, frame: Frame) -> None:
        predicted = self._T[-1] @ frame.T_prev_body
        W = whitener(frame.Q, f"the odometry covariance Q of frame {frame.k}")
        self._T = np.concatenate([self._T, predicted[None]])
        self._increments = np.concatenate([self._increments, frame.T_prev_body[None]])
        self._odometry_W = np.concatenate([self._odometry_W, W[None]])
        at, _ = self._jacobian_points()
        new = odometry_terms(self._T[-2:], at[-2:], self._increments[-1:], self._odometry_W[-1:])
        self._odometry = self._odometry.followed_by(new)
        self._T_at = np.concatenate([self._T_at, predicted[None]])

    def _observe(self, frame: Frame) -> None:
        """The frame's observations, with new landmarks where the predicted pose sees them."""
        unknown = np.array([landmark not in self._number for landmark in frame.ids.tolist()], dtype=bool)
        entries = entering(frame, unknown, self._sensor)
        self._dropped = entries.dropped
        self._require_images(frame, ~unknown)
        if entries.ids.size:
            positions = placed(self._sights.entry_sensor, self._T[-1], entries, frame.k)
            for landmark in entries.ids.tolist():
                self._number[landmark] = len(self._number)
            self._landmarks = np.concatenate([self._landmarks, positions])
            self._landmarks_at = np.concatenate([self._landmarks_at, positions])
        self._dof -= self._n * entries.ids.size
        before = len(self._z)
        if places_by_itself(self._sensor):
            self._append(frame.ids, frame.z, frame.R, entering=False)
        else:
            self._append(entries.ids, entries.z, entries.R, entering=True)
            self._append(frame.ids[~unknown], frame.z[~unknown], frame.R[~unknown], entering=False)
        if self._frozen:
            fresh = self._observation_terms(slice(before, None))
            self._observations = self._observations.followed_by(fresh)

    def _append(self, ids: IntArray, z: FloatArray, R: FloatArray, *, entering: bool) -> None:
        """Observations from the newest pose, with those of the window."""
        if ids.size == 0:
            return
        self._dof += z.size
        z, W = padded(z, whiteners(R), self._sights.dim)
        self._pose_of = np.concatenate([self._pose_of, np.full(ids.size, len(self._T) - 1)])
        numbers = [self._number[landmark] for landmark in ids.tolist()]
        self._landmark_of = np.concatenate([self._landmark_of, numbers])
        self._z, self._W = np.concatenate([self._z, z]), np.concatenate([self._W, W])
        self._entering = np.concatenate([self._entering, np.full(ids.size, entering)])

    def _require_images(self, frame: Frame, known: NDArray[np.bool_]) -> None:
        """Count the frame's measurements of landmarks behind the camera; they have no derivative."""
        if not has_blind_side(self._sensor) or not known.any():
            return
        numbers = [self._number[landmark] for landmark in frame.ids[known].tolist()]
        exists = with_image(self._sensor.predict(self._T[-1], self._landmarks[numbers]), frame.k)
        self._dropped += exists.size - int(exists.sum())

    def _solve(self) -> None:
        """Gauss-Newton from the predicted state until the step is small enough."""
        last_step: FloatArray | None = None
        share = 1.0
        for iteration in range(1, self._iterations + 1):
            if not self._frozen:
                self._linearise()
            step = GaussNewtonStep(
                self._linear_prior,
                self._odometry,
                self._observations,
                self._pose_of,
                self._landmark_of,
                len(self._landmarks),
                self._n,
            )
            whole_step = np.concatenate([step.pose_step.ravel(), step.landmark_step.ravel()])
            first_try = relaxed_share(whole_step, last_step, share)
            share, last_step = self._share_of(step, first_try), whole_step
            pose_step, landmark_step = share * step.pose_step, share * step.landmark_step
            self._T, self._turn = retract_in_world_axes(self._T, pose_step)
            self._landmarks = self._landmarks + landmark_step
            self._recentre(pose_step, landmark_step)
            self._step, self._joint, self._used = step, None, iteration
            self._last_size = float(np.abs(whole_step).max())
            # A step that was halved to nothing would only be computed once more.
            if self._last_size < self._tolerance or share <= first_try * 0.5**HALVINGS:
                break

    def _linearise(self) -> None:
        self._T_at, self._landmarks_at = self._jacobian_points()
        known = self._prior.landmarks.shape[0]
        self._linear_prior = self._prior.linearised(self._T[0], self._landmarks[:known])
        if self._unanchored is not None:
            self._unanchored.linearise(self._prior.jacobian(self._T[0]))
        self._odometry = odometry_terms(self._T, self._T_at, self._increments, self._odometry_W)
        self._observations = self._observation_terms(slice(None))

    def _jacobian_points(self) -> tuple[FloatArray, FloatArray]:
        """Poses and landmarks at which Jacobians are taken now."""
        if not self._first_estimates:
            return self._T, self._landmarks
        T, landmarks = self._T.copy(), self._landmarks.copy()
        if self._pose_pinned:
            T[0] = self._T_at[0]
        landmarks[: self._pinned] = self._landmarks_at[: self._pinned]
        return T, landmarks

    def _observation_terms(self, rows: slice) -> ObservationTerms:
        pose_of, landmark_of = self._pose_of[rows], self._landmark_of[rows]
        T_at, landmarks_at = self._jacobian_points()
        return observation_terms(
            self._sights_of(rows),
            self._T[pose_of],
            self._landmarks[landmark_of],
            T_at[pose_of],
            landmarks_at[landmark_of],
            self._z[rows],
            self._W[rows],
        )

    def _sights_of(self, rows: slice) -> Sights:
        if places_by_itself(self._sensor):
            return self._sights
        return replace(self._sights, entering=self._entering[rows])

    def _share_of(self, step: GaussNewtonStep, share: float) -> float:
        """``share``, or less where it would raise the cost; a single iteration is never questioned."""
        if self._iterations == 1 or self._frozen:
            return 1.0
        squares = float((self._odometry.b**2).sum() + (self._observations.b**2).sum())
        bound = (self._linear_prior.c + squares) * (1.0 + 1e-9) + 1e-9
        for _ in range(HALVINGS):
            T, _ = retract_in_world_axes(self._T, share * step.pose_step)
            if self._cost(T, self._landmarks + share * step.landmark_step) <= bound:
                break
            share *= 0.5
        return share

    def _cost(self, T: FloatArray, landmarks: FloatArray) -> float:
        known = self._prior.landmarks.shape[0]
        return self._prior.linearised(T[0], landmarks[:known]).c + squared_residuals(
            self._sights_of(slice(None)),
            T,
            self._increments,
            self._odometry_W,
            T[self._pose_of],
            landmarks[self._landmark_of],
            self._z,
            self._W,
        )

    def _recentre(self, pose_step: FloatArray, landmark_step: FloatArray) -> None:
        """Linear terms about the new estimate and in its axes, with the Jacobians of the solve."""
        self._odometry.recentre(pose_step)
        self._odometry.turn(self._turn)
        self._observations.recentre(pose_step[self._pose_of], landmark_step[self._landmark_of])
        self._observations.turn(self._turn[self._pose_of])
        known = (self._linear_prior.eta.size - self._p) // self._n
        moved = np.concatenate([pose_step[0], landmark_step[:known].ravel()])
        self._linear_prior = self._linear_prior.recentred(moved).with_pose_error(self._turn[0].T)
        if self._unanchored is not None:
            self._unanchored.turn(self._turn[0].T)

    def _marginalise_oldest(self, seen_now: set[int]) -> None:
        """Turn the oldest pose's costs into a prior on the next pose and the landmarks."""
        self._left.append((self._T[0], turned(self._step.first_pose_covariance(), self._turn[0])))
        leaving = self._pose_of == 0
        quadratic, known = oldest_pose_cost(
            self._linear_prior, self._odometry, self._observations.of(leaving), self._landmark_of[leaving]
        )
        quadratic = quadratic.eliminated(np.arange(self._p))
        if self._unanchored is not None:
            self._unanchored.marginalise(self._odometry, self._observations, self._pose_of, self._landmark_of)
        self._T, self._T_at = self._T[1:], self._T_at[1:]
        self._increments, self._odometry_W = self._increments[1:], self._odometry_W[1:]
        self._odometry = self._odometry.after_first()
        self._keep_observations(~leaving)
        self._pose_of -= 1
        self._pose_pinned, self._pinned = True, known
        if self._drop_unseen:
            quadratic = self._without_unseen(quadratic, seen_now)
        self._linear_prior = quadratic
        centre = self._landmarks[: self._pinned].copy()
        self._prior = Prior(quadratic, self._T[0], centre, self._first_estimates)

    def _keep_observations(self, keep: NDArray[np.bool_]) -> None:
        self._observations = self._observations.of(keep)
        self._pose_of, self._landmark_of = self._pose_of[keep], self._landmark_of[keep]
        self._z, self._W, self._entering = self._z[keep], self._W[keep], self._entering[keep]

    def _without_unseen(self, quadratic: Quadratic, seen_now: set[int]) -> Quadratic:
        """Marginalise the landmarks that neither the window nor the new frame sees."""
        ids = list(self._number)
        seen = np.zeros(len(ids), dtype=bool)
        seen[self._landmark_of] = True
        seen |= np.array([landmark in seen_now for landmark in ids], dtype=bool)
        if seen.all():
            return quadratic
        unseen = np.flatnonzero(~seen)
        states = (self._p + self._n * unseen[:, None] + np.arange(self._n)).ravel()
        quadratic = quadratic.eliminated(states)
        if self._unanchored is not None:
            self._unanchored.drop(unseen, self._n)
        self._landmarks, self._landmarks_at = self._landmarks[seen], self._landmarks_at[seen]
        renumbered = np.cumsum(seen) - 1
        self._landmark_of = renumbered[self._landmark_of]
        self._pinned -= unseen.size
        self._number = {ids[old]: new for new, old in enumerate(np.flatnonzero(seen).tolist())}
        return quadratic

    def _cached_joint(self) -> FloatArray:
        if self._joint is None:
            self._joint = self._step.joint_covariance()
            p, turn = self._p, self._turn[-1]
            self._joint[:p] = turn @ self._joint[:p]
            self._joint[:, :p] = self._joint[:, :p] @ turn.T
        return self._joint


def turned(P: FloatArray, turn: FloatArray) -> FloatArray:
    """Covariances (..., p, p) in other axes."""
    return turn @ P @ np.swapaxes(turn, -1, -2)
