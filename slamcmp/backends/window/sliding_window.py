"""Sliding-window smoothing: the dial from filter to smoother.

The course's three steps, each one method of ``SlidingWindow``: ``construct`` builds the cost of a frame,
``marginalise`` makes of the pose that leaves a prior on the rest, and ``solve`` is Gauss-Newton. Two knobs
turn a filter into a smoother: how many poses are kept (``window``) and how often the window is solved
(``iterations``). Window 1 with one iteration is EKF-SLAM, with iterations to convergence the iterated EKF; an
infinite window solved to convergence is the batch solution at every frame (tests/oracles hold these to
rounding).

A pose leaves the window when the next frame's odometry says what to do with it: in window 1 that is the
filter's prediction. It leaves with the Jacobians of the last solve, the ones that the reported covariance
comes from: nothing is relinearised between solving and marginalising. Afterwards the prior's origin is the
current estimate.

Errors of poses are additive in the world, as in ``ekf_slam``, and written in the body axes of the current
estimate: a step turns these axes, and with them all linear terms (``turn``).

========  =====================================================================
symbol    meaning (Sibley 2006; Dong-Si and Mourikis 2011 for first estimates)
========  =====================================================================
T         poses of the window, oldest first, (K, n+1, n+1)
P         covariances, poses in the body tangent
========  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.doubtful import DoubtfulLandmarks
from slamcmp.backends.entries import entering, has_blind_side, placed, places_by_itself, with_image
from slamcmp.backends.fit import MAX_CHI2_PER_DOF, require_fit, require_majority
from slamcmp.backends.recent_landmarks import MOST_LANDMARKS, RecentLandmarks
from slamcmp.backends.relaxation import relaxed_share
from slamcmp.backends.robust import DOUBTED, Kernel, RobustKernel, robust_kernel
from slamcmp.backends.unanchored import Linearisation
from slamcmp.backends.window.cost import lengths
from slamcmp.backends.window.gauss_newton import GaussNewtonStep
from slamcmp.backends.window.unanchored import UnanchoredWindow
from slamcmp.backends.window.window import Policy, Window
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, Trajectory

HALVINGS = 8
"""Most halvings of a step that raises the cost; what is left then moves nothing, and ends the frame."""
STAGE_ITERATIONS = 2
"""Under each kernel before the last, which only has to come near."""
REWEIGHTED = 3
"""So many times the iterations under the last one, whose weights converge linearly."""


@back_ends.register("sliding_window")
class SlidingWindow:
    """Fixed-lag smoothing of the last poses and all landmarks, by Gauss-Newton with exact marginalisation.

    Every frame costs O(w (n L)²+ (n L)³) an iteration for w poses and L landmarks in the state, which
    ``most_landmarks`` bounds, so that the cost of a frame grows no further there; with ``window: null``
    w is the number of frames so far, so a run is quadratic in its length (hundreds of frames, not tens of
    thousands).

    Args:
        problem: prior and sensor (planar or spatial).
        window: poses kept, the current one included; null keeps all (full smoothing).
        iterations: most Gauss-Newton iterations a frame (with a kernel three times as many, unless it is one:
            weights settle slowly); if more than one, a step after one that jumped over
            the minimum is shortened, and a step that would raise the cost is halved until it does not.
        tolerance: iterations end when no component of a whole step [m, rad] is larger.
        linearisation: where Jacobians are taken. "latest": at the current estimate. "fej": variables that
            share a cost with marginalised ones keep the point of their first one (first-estimates
            Jacobians). "frozen": every measurement keeps the linear form of the frame it came in.
        landmarks: "keep" all in the state, or "drop_unseen": marginalise those that no pose of the window
            has seen; seen again, they start anew (where one measurement does not place a landmark, as a
            single camera's does not, what is measured of it is dropped, and counted).
        most_landmarks: with "keep": where there are more in the state, those leave it that have not been seen
            for longest and that no pose of the window sees, as with "drop_unseen" with a marginal prior; null
            keeps every one, at a cost that grows with the cube of their number.
        max_chi2_per_dof: as in ``batch``: a final solution above it counts as diverged.
        robust: kernel on the observations' whitened residuals (robust.py): each iteration takes the weights
            of the residuals where it begins, the newest frame's under one kernel after the other where the
            kernel is not convex. A pose leaves with the weights that its observations had then; a landmark
            whose second sighting contradicts its first starts anew (doubtful.py).
        robust_width: of the kernel; default the width with 95 % efficiency on Gaussian noise.

    Raises:
        UsageError: the prior or an odometry covariance is singular.
        DataError: a measurement that should place a landmark does not.
        DivergedError: the information matrix is not positive definite, or not finite, most landmarks that
            a camera sees are behind it, or first estimates are far from the present ones (far_points.py).
    """

    def __init__(
        self,
        problem: Problem,
        *,
        window: Annotated[int, Ge(1)] | None = 10,
        iterations: Annotated[int, Ge(1)] = 10,
        tolerance: Annotated[float, Gt(0)] = 1e-6,
        linearisation: Policy = "latest",
        landmarks: Literal["keep", "drop_unseen"] = "keep",
        most_landmarks: Annotated[int, Ge(1)] | None = MOST_LANDMARKS,
        max_chi2_per_dof: Annotated[float, Gt(0)] = MAX_CHI2_PER_DOF,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        self._kernel = robust_kernel(robust, robust_width)
        self._doubtful = None if self._kernel is None else DoubtfulLandmarks(problem.sensor)
        self._restarted = 0
        self._window = Window(problem, linearisation, self._kernel)
        self._length = window
        self._iterations, self._tolerance = iterations, tolerance
        self._frozen = linearisation == "frozen"
        # Weights take more than one step, even of a cost that is linear.
        self._one_step = iterations == 1 or (self._frozen and self._kernel is None)
        self._drop_unseen = landmarks == "drop_unseen"
        self._recent = (
            None if most_landmarks is None or self._drop_unseen else RecentLandmarks(most_landmarks)
        )
        self._max_chi2_per_dof = max_chi2_per_dof
        self._solution: Solution
        self._chi2: float | None = None
        self._dof, self._dropped = 0, 0
        self._t: list[float] = []
        self._left: list[tuple[FloatArray, FloatArray]] = []
        self._unanchored: UnanchoredWindow | None = None

    def update(self, frame: Frame) -> None:
        """Add the frame's costs, marginalise what leaves the window, and solve."""
        self.construct(frame)
        self.marginalise()
        self.solve()

    def construct(self, frame: Frame) -> None:
        """The frame's pose, and its observations, with new landmarks where the predicted pose sees them."""
        window, sensor = self._window, self._window.sights.sensor
        if self._doubtful is not None:
            again = self._doubtful.contradicted(frame, window.number)
            self._restarted = len(again)
            # Each was in the state by a single measurement, which is gone with it.
            window.forget(again)
        if frame.k > 0:
            window.append_pose(frame)
        self._t.append(frame.t)
        if self._recent is not None:
            self._recent.see(frame)
        unknown = np.array([landmark not in window.number for landmark in frame.ids.tolist()], dtype=bool)
        entries = entering(frame, unknown, sensor)
        self._dropped = entries.dropped + self._without_image(frame, frame.ids[~unknown])
        if entries.ids.size:
            positions = placed(window.sights.entry_sensor, window.T[-1], entries, frame.k)
            window.append_landmarks(entries.ids, positions)
        self._dof -= window.n * entries.ids.size
        known = ~unknown
        if places_by_itself(sensor):
            self._observe(frame.ids, frame.z, frame.R)
        else:
            self._observe(entries.ids, entries.z, entries.R, entering=True)
            self._observe(frame.ids[known], frame.z[known], frame.R[known])
        if self._frozen:
            window.linearise_new()

    def marginalise(self) -> None:
        """Make the oldest pose a prior on the others if the window has one too many."""
        window = self._window
        if self._length is None or len(window.T) <= self._length:
            return
        self._left.append((window.T[0], self._solution.first_pose_covariance()))
        window.marginalise_oldest_pose()
        if self._drop_unseen:
            window.marginalise_unseen()
        elif self._recent is not None:
            first = len(self._t) - len(window.T)
            window.marginalise_unseen(self._recent.too_many(window.number, unseen_since=first))
        window.centre_prior()

    def solve(self) -> None:
        """Gauss-Newton from the predicted state until the step is small enough."""
        self._chi2 = None
        if self._kernel is None:
            self._iterate(None, 0, self._iterations)
            return
        done, most = 0, self._iterations if self._one_step else REWEIGHTED * self._iterations
        *others, last = self._kernel.stages(self._largest_residual())
        for kernel in others:
            done = self._iterate(kernel, done, min(STAGE_ITERATIONS, most))
        self._iterate(last, done, most)

    def _iterate(self, kernel: Kernel | None, done: int, most: int) -> int:
        """At most so many iterations with the newest frame's observations under a kernel, after ``done``."""
        window = self._window
        last_step: FloatArray | None = None
        share = 1.0
        iteration = done
        for iteration in range(done + 1, done + most + 1):
            if not self._frozen:
                window.linearise()
            if iteration == 1:
                window.require_near_points(len(self._t) - 1)
            if kernel is not None:
                window.reweigh(kernel)
            step = window.gauss_newton_step()
            whole_step = np.concatenate([step.pose_step.ravel(), step.landmark_step.ravel()])
            first_try = relaxed_share(whole_step, last_step, share)
            share, last_step = self._share_of(step, first_try), whole_step
            turn = window.move(share * step.pose_step, share * step.landmark_step)
            self._solution = Solution(step, turn, iteration, float(np.abs(whole_step).max()))
            # A step that was halved to nothing would only be computed once more.
            if self._solution.last_step < self._tolerance or share <= first_try * 0.5**HALVINGS:
                break
        return iteration

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._window.T[-1], self._solution.last_pose_covariance())

    def landmarks(self) -> Landmarks:
        """The landmarks in the state, in the order of first sight."""
        window = self._window
        ids = np.fromiter(window.number, dtype=np.int64, count=len(window.number))
        n, p = window.n, window.p
        blocks = self._solution.joint_covariance[p:, p:].reshape(ids.size, n, ids.size, n)
        index = np.arange(ids.size)
        return Landmarks(ids, window.landmarks, blocks[index, :, index, :])

    def joint_covariance(self) -> FloatArray:
        """P of the current pose and the landmarks, (p + n L, p + n L)."""
        return self._solution.joint_covariance.copy()

    def trajectory(self) -> Trajectory:
        """Each pose as it left the window, or as it stands in it: with a hindsight of at most w - 1 frames.

        With ``window: null`` every pose with full hindsight; with window 1 the filter's own estimates.

        Raises:
            DivergedError: chi-square per dof is above ``max_chi2_per_dof``.
        """
        what = "sliding_window" if self._converged() else "sliding_window, without convergence"
        chi2, dof = self._chi_square(), self._dof
        robust = self._window.robust
        if robust is not None:
            of_outliers, outliers, total = robust.of_outliers(lengths(self._window.cost.observations.b))
            require_majority(outliers, total, "sliding_window")
            chi2, dof = chi2 - of_outliers, dof - outliers * self._window.sights.sensor.dim
        require_fit(chi2, dof, self._max_chi2_per_dof, what, "a longer window, more iterations")
        poses = [T for T, _ in self._left] + list(self._window.T)
        covariances = [P for _, P in self._left] + list(self._solution.pose_covariances())
        return Trajectory(np.array(self._t), np.array(poses), np.array(covariances))

    def diagnostics(self) -> Mapping[str, float]:
        """Landmarks, iterations used, largest component of the last step, chi-square with its dof, and how
        many of the frame's measurements were dropped (entries.py); of a window that iterates also whether the
        last step was below the tolerance (``converged``: 1, else 0).

        Chi-square is that of all measurements so far: of the window's residuals at the estimate, plus what
        marginalisation left over. Where each frame is one linear step, with a single iteration or frozen
        Jacobians, it is that of the linear residuals: for window 1 the sum of the NIS. With a kernel it is
        what the residuals cost, and told are also the smallest weight of an observation in the window, how
        many it ``downweighted`` to less than a half, and how many landmarks were ``restarted``.
        """
        told = {
            "landmarks": len(self._window.number),
            "iterations": self._solution.iterations,
            "last_step": self._solution.last_step,
            "chi2": self._chi_square(),
            "dof": self._dof,
            "dropped": self._dropped,
        }
        robust = self._window.robust
        if robust is not None:
            told["smallest_weight"] = robust.weights.min(initial=1.0)
            told["downweighted"] = int((robust.weights < DOUBTED).sum())
            told["restarted"] = self._restarted
        return told if self._one_step else {**told, "converged": float(self._converged())}

    def record_linearisation(self) -> None:
        """Keep what :meth:`linearisation` needs, from the first frame on."""
        self._unanchored = self._window.listener = UnanchoredWindow(self._window.p)

    def linearisation(self) -> Linearisation:
        """What the last solve's linear system claims about the pose, and where its Jacobians were taken."""
        assert self._unanchored is not None
        window, rows = self._window, self._window.measurements
        root, scale = self._unanchored.told(window.weighted_cost(), rows)
        numbers = rows.landmark_of[rows.pose_of == len(window.T) - 1]
        if not numbers.size:
            return Linearisation(root, scale)
        at = window.points.landmarks[numbers]
        return Linearisation(root, scale, window.points.T[-1], at, window.landmarks[numbers])

    def _observe(self, ids: IntArray, z: FloatArray, R: FloatArray, *, entering: bool = False) -> None:
        self._dof += z.size
        self._window.append_observations(ids, z, R, entering=entering)

    def _without_image(self, frame: Frame, known: IntArray) -> int:
        """How many of the known landmarks that the frame saw are behind the camera: no derivative there."""
        window = self._window
        if not has_blind_side(window.sights.sensor) or not known.size:
            return 0
        seen = window.landmarks[window.numbers_of(known)]
        exists = with_image(window.sights.sensor.predict(window.T[-1], seen), frame.k)
        return exists.size - int(exists.sum())

    def _largest_residual(self) -> float:
        """Of the newest frame's observations where its solve begins, whitened."""
        window = self._window
        if not self._frozen:
            window.linearise()
        newest = window.measurements.pose_of == len(window.T) - 1
        return float(lengths(window.cost.observations.b[newest]).max(initial=0.0))

    def _converged(self) -> bool:
        return self._one_step or self._solution.last_step < self._tolerance

    def _chi_square(self) -> float:
        if self._chi2 is None:
            self._chi2 = self._solution.step.chi2 if self._one_step else self._window.chi_square()
        return self._chi2

    def _share_of(self, step: GaussNewtonStep, share: float) -> float:
        """``share``, or less where it would raise the cost; a single iteration is never questioned."""
        if self._one_step or self._frozen:
            return 1.0
        # Under a kernel the squares of the linear cost are not what the residuals cost.
        now = self._window.cost.value if self._kernel is None else self._window.chi_square()
        bound = now * (1.0 + 1e-9) + 1e-9
        for _ in range(HALVINGS):
            if self._window.cost_after(share * step.pose_step, share * step.landmark_step) <= bound:
                break
            share *= 0.5
        return share


@dataclass(frozen=True)
class Solution:
    """What a frame's last Gauss-Newton step says, in the axes of the poses after it."""

    step: GaussNewtonStep
    turn: FloatArray
    """From the axes in which the step was computed, (K, p, p)."""
    iterations: int
    last_step: float
    """Largest component of the whole step."""

    def last_pose_covariance(self) -> FloatArray:
        """(p, p)."""
        return turned(self.step.last_pose_covariance(), self.turn[-1])

    def first_pose_covariance(self) -> FloatArray:
        """(p, p)."""
        return turned(self.step.first_pose_covariance(), self.turn[0])

    def pose_covariances(self) -> FloatArray:
        """(K, p, p)."""
        return turned(self.step.pose_covariances(), self.turn)

    @cached_property
    def joint_covariance(self) -> FloatArray:
        """Of the last pose and the landmarks, (p + n L, p + n L)."""
        joint, turn = self.step.joint_covariance(), self.turn[-1]
        p = len(turn)
        joint[:p] = turn @ joint[:p]
        joint[:, :p] = joint[:, :p] @ turn.T
        return joint


def turned(P: FloatArray, turn: FloatArray) -> FloatArray:
    """Covariances (..., p, p) in other axes."""
    return turn @ P @ np.swapaxes(turn, -1, -2)
