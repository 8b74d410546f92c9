"""EKF-SLAM: after every frame all past poses are marginalised.

The course's three steps, each one method: ``construct`` writes the frame's cost, prior, odometry and
observations, with new landmarks joining the state; ``solve`` takes one Gauss–Newton step; ``marginalise``
leaves pose and map as the next frame's prior.

The pose's error is additive in the world (position and heading), as in the published filters, but stored in
the body tangent, ``p = p_hat + R v``, ``R = R_hat exp(omega)``: after a correction it is turned into the new
body axes (``J``). Without that turn, the error state ``body``, the covariance is read in axes that the
correction has just moved; the filter then takes information it does not have about the whole map's position
and heading. All Jacobians of a frame are taken at the predicted mean, and all its observations enter in one
stacked update, which makes this filter the same as a factor graph of window 1 with one Gauss–Newton
iteration (tests/oracles).

========  ===================================================================
symbol    meaning (Thrun, Burgard, Fox 2005, ch. 10; Solà 2018 for the tangent)
========  ===================================================================
x         mean: T_world_body (n+1, n+1) and landmarks (L, n)
P         joint covariance, pose tangent first
A         Ad(T_prev_body^-1): carries the pose error over an odometry increment
J         turns the pose error into the axes of the corrected pose
z, y      measurement and innovation, stacked (k d,)
H, R, S   stacked Jacobian, measurement noise, innovation covariance
W         P H^T L^-T with S = L L^T, so that K S K^T = W W^T
G, N      new landmarks' derivative by the pose, and their own noise
========  ===================================================================
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.filters.covariances.covariance import JointCovariance, block_diagonal
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance, StackedJacobian
from slamcmp.backends.filters.covariances.postponed import PostponedCovariance
from slamcmp.backends.filters.error_state.charts import Chart
from slamcmp.backends.filters.loops import Loops, Recipe
from slamcmp.backends.filters.map_filter import LinearisingFilter, Observed
from slamcmp.backends.robust import RobustKernel, robust_kernel
from slamcmp.errors import UsageError
from slamcmp.geometry import adjoint_of_inverse, exp, retract_in_world_axes
from slamcmp.registry import back_ends
from slamcmp.types import Frame, Problem


@back_ends.register("ekf_slam")
class EkfSlam(LinearisingFilter):
    """EKF-SLAM with one stacked update per frame.

    Args:
        problem: prior and sensor (planar or spatial).
        new_landmarks: "join_first" puts new landmarks into the state before the update (the course's cost
            construction: linearised at the predicted pose); "update_first" corrects the pose with the
            known landmarks first and initialises the new ones from the corrected pose.
        error_state: "world" is the standard EKF; "body" corrects by ``T exp(xi)`` and leaves the covariance
            as it is, which is what relinearising a marginal prior in GTSAM does.
        active_landmarks: with a number, at most that many landmarks, those seen last, are updated at every
            frame and all others only when it is due (postponed_covariance.py): the same numbers, sooner on a
            map of hundreds of landmarks of which few are in sight.
        forget_after: a landmark that this many frames have not seen leaves the state (its rows and columns
            are dropped, which changes nothing else if it is never seen again). Seen again, it enters anew,
            without the memory that would close a loop; where one measurement does not place a landmark
            (a single camera), what is measured of a forgotten one is dropped, and counted. None: never.
        robust: kernel on the observations' whitened residuals (robust.py); a landmark whose second sighting
            contradicts its first starts anew (doubtful.py).
        robust_width: of the kernel; default the width with 95 % efficiency on Gaussian noise.

    Raises:
        UsageError: ``active_landmarks`` is given with ``forget_after`` or a kernel.
        DataError: a measurement that should place a landmark does not.
        DivergedError: an innovation covariance is not positive definite or not finite, or most landmarks
            that a camera sees are behind it.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: Literal["join_first", "update_first"] = "join_first",
        error_state: Literal["world", "body"] = "world",
        active_landmarks: Annotated[int, Ge(1)] | None = None,
        forget_after: Annotated[int, Ge(1)] | None = None,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        kernel = robust_kernel(robust, robust_width)
        if active_landmarks is not None and forget_after is not None:
            raise UsageError(
                "ekf_slam: active_landmarks postpones the work on landmarks out of sight, forget_after drops "
                "them; give one of the two"
            )
        if active_landmarks is not None and kernel is not None:
            raise UsageError(
                "ekf_slam: active_landmarks postpones the work on landmarks out of sight, robust drops those "
                "that begin with an outlier; give one of the two"
            )
        n = problem.sensor.space_dim
        storage = (
            JointCovariance(problem.P)
            if active_landmarks is None
            else PostponedCovariance(problem.P, n, active_landmarks)
        )
        super().__init__(problem, Chart(n), ErrorCovariance(storage, n), kernel)
        self._join_first = new_landmarks == "join_first"
        self._in_world_axes = error_state == "world"
        self._forget_after = forget_after
        if forget_after is None:
            chart = "BODY_WORLD" if self._in_world_axes else "BODY"
            self._loops = Loops(self, Recipe(chart, self._join_first))
        self._last_seen: dict[int, int] = {}

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        if self._loops.take(frame):
            return
        seen = self.construct(frame)
        self.solve(seen)
        self.marginalise(frame)

    def construct(self, frame: Frame) -> Observed:
        """The frame's cost: the prior on pose and map carried over the odometry, and what was observed.

        The old pose leaves here already, for only the odometry refers to it (error_covariance.py), and so do
        landmarks that neither this frame nor those before it have seen.
        """
        self._begin(frame)
        if self._forget_after is not None:
            self._forget(frame, self._forget_after)
        if frame.k > 0:
            self._T = self._T @ frame.T_prev_body
            self._P.move(adjoint_of_inverse(frame.T_prev_body), Q=frame.Q)
        seen = self._sorted(frame)
        if self._join_first and seen.entries is not None:
            self._augment(seen.entries)
        return seen

    def solve(self, seen: Observed) -> None:
        """One Gauss–Newton step on it, in covariance form."""
        if seen.numbers.size:
            self._correct(seen)
        if not self._join_first and seen.entries is not None:
            self._augment(seen.entries)

    def marginalise(self, frame: Frame) -> None:
        """The posterior of pose and map is the next frame's prior."""
        self._P.end_frame(frame.t, self._T)

    def _forget(self, frame: Frame, after: int) -> None:
        """Marginalise the landmarks that have been out of sight long enough, this frame included."""
        seen = set(frame.ids.tolist())
        if frame.entries is not None:
            seen.update(frame.entries.ids.tolist())
        self._last_seen.update(dict.fromkeys(seen, frame.k))
        oldest = frame.k - after
        stays = np.array([self._last_seen[landmark] > oldest for landmark in self._number], dtype=bool)
        if stays.all():
            return
        self._keep(stays)
        self._last_seen = {landmark: self._last_seen[landmark] for landmark in {*self._number, *seen}}

    def _augment(self, entries: Entries) -> None:
        """New landmarks at their inverse observation, with their correlation to everything known."""
        positions = placed(self._entry_sensor, self._T, entries, self._P.frame)
        H_pose, H_land = self._entry_sensor.jacobians(self._T, positions)
        # 0 = H_pose xi + H_land dl - v, solved for dl: no sensor needs a Jacobian of its inverse.
        H_inv = np.linalg.inv(H_land)
        G = -(H_inv @ H_pose).reshape(positions.size, -1)
        self._enter(entries, positions, G, block_diagonal(H_inv @ entries.R @ np.swapaxes(H_inv, 1, 2)))

    def _correct(self, seen: Observed) -> None:
        # First, for a postponed correction of their means is due now.
        touched = self._P.touch(seen.numbers, self._landmarks)
        landmarks = self._landmarks[seen.numbers]
        z_predicted, H_pose, H_land = self._sensor.linearise(self._T, landmarks)
        if self._has_blind_side and not np.isfinite(z_predicted).all():
            self._correct(self._with_image(seen, z_predicted))
            return
        y = self._sensor.residual(seen.z, z_predicted).ravel()
        self._points = self._T, landmarks, seen.numbers
        dx = self._P.observe(touched, StackedJacobian(H_pose, H_land), block_diagonal(seen.R), y)
        xi = dx[: self._chart.p]
        if self._in_world_axes:
            self._T, J = retract_in_world_axes(self._T, xi)
            self._P.move(J)
        else:
            self._T = self._T @ exp(xi)
        self._P.shift(self._landmarks, dx)
