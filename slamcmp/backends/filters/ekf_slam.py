"""EKF-SLAM: after every frame all past poses are marginalised.

The course's three steps, each one method: cost construction (``_construct``: the frame's observations, with
new landmarks joining the state), one Gauss–Newton step (``_correct``), state propagation (``_predict``:
moving to the next pose *is* marginalising the previous one).

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

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.backends.entries import Entries, entering, has_blind_side, placed, with_image
from slamcmp.backends.filters.covariance import JointCovariance, block_diagonal, multiplier
from slamcmp.backends.filters.postponed import PostponedCovariance
from slamcmp.backends.filters.unanchored import Linearisation, UnanchoredFilter, square_root
from slamcmp.errors import DivergedError, UsageError
from slamcmp.geometry import adjoint_of_inverse, exp, retract_in_world_axes
from slamcmp.models.sensors import entry_sensor
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem


@back_ends.register("ekf_slam")
class EkfSlam:
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

    Raises:
        UsageError: both ``active_landmarks`` and ``forget_after`` are given.
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
    ) -> None:
        if active_landmarks is not None and forget_after is not None:
            raise UsageError(
                "ekf_slam: active_landmarks postpones the work on landmarks out of sight, forget_after drops "
                "them; give one of the two"
            )
        self._sensor = problem.sensor
        self._entry_sensor = entry_sensor(problem.sensor)
        self._has_blind_side = has_blind_side(problem.sensor)
        self._n = problem.sensor.space_dim
        self._join_first = new_landmarks == "join_first"
        self._in_world_axes = error_state == "world"
        self._no_noise = np.zeros_like(problem.P)
        self._T = np.array(problem.T_world_body)
        self._P: JointCovariance | PostponedCovariance = (
            JointCovariance(problem.P)
            if active_landmarks is None
            else PostponedCovariance(problem.P, self._n, active_landmarks)
        )
        self._landmarks = np.empty((64, self._n))
        self._number: dict[int, int] = {}
        self._forget_after = forget_after
        self._last_seen: dict[int, int] = {}
        self._k = -1
        self._nis = 0.0
        self._nis_dof = 0
        self._dropped = 0
        self._unanchored: UnanchoredFilter | None = None
        self._points: tuple[FloatArray, FloatArray, IntArray] | None = None

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        self._k = frame.k
        self._nis, self._nis_dof, self._dropped = 0.0, 0, 0
        self._points = None
        if self._forget_after is not None:
            self._forget(frame, self._forget_after)
        if frame.k > 0:
            self._predict(frame.T_prev_body, frame.Q)
        numbers = [self._number.get(landmark, -1) for landmark in frame.ids.tolist()]
        if -1 not in numbers and frame.entries is None:
            if numbers:
                self._correct(np.array(numbers), frame.z, frame.R)
            return
        known = np.array(numbers) >= 0
        entries = entering(frame, ~known, self._sensor)
        self._dropped = entries.dropped
        if self._join_first:
            self._augment(entries)
        if known.any():
            self._correct(np.array(numbers)[known], frame.z[known], frame.R[known])
        if not self._join_first:
            self._augment(entries)

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T, self._P.pose_block())

    def landmarks(self) -> Landmarks:
        """The landmarks in the state, in the order in which they entered; not those forgotten."""
        self._P.settle(self._landmarks)
        count = len(self._number)
        ids = np.fromiter(self._number, dtype=np.int64, count=count)
        return Landmarks(ids, self._landmarks[:count], self._P.diagonal_blocks(self._n))

    def joint_covariance(self) -> FloatArray:
        """P of pose and landmarks, (p + n L, p + n L)."""
        return self._P.dense()

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, landmarks in the state, and how many of the
        frame's measurements were dropped (entries.py)."""
        return {
            "nis": self._nis if self._nis_dof else float("nan"),
            "nis_dof": self._nis_dof,
            "landmarks": len(self._number),
            "dropped": self._dropped,
        }

    def record_linearisation(self) -> None:
        """Keep what :meth:`linearisation` needs, from the first frame on."""
        self._unanchored = UnanchoredFilter(len(self._no_noise))

    def linearisation(self) -> Linearisation:
        """What the filter's own matrices claim about its pose, and where its last Jacobians were taken."""
        assert self._unanchored is not None
        root, scale = self._unanchored.told()
        if self._points is None:
            return Linearisation(root, scale)
        T_at, landmarks_at, numbers = self._points
        return Linearisation(root, scale, T_at, landmarks_at, self._landmarks[numbers])

    def _predict(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        self._T = self._T @ T_prev_body
        A = adjoint_of_inverse(T_prev_body)
        self._P.propagate(A, Q)
        if self._unanchored is not None:
            self._unanchored.move(A, None, square_root(Q))

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
        assert isinstance(self._P, JointCovariance)
        n, p = self._n, self._no_noise.shape[0]
        states = (p + n * np.flatnonzero(~stays)[:, None] + np.arange(n)).ravel()
        self._P.remove(states)
        if self._unanchored is not None:
            self._unanchored.drop(states)
        self._landmarks[: stays.sum()] = self._landmarks[: stays.size][stays]
        kept = [landmark for landmark, stay in zip(self._number, stays, strict=True) if stay]
        self._number = {landmark: number for number, landmark in enumerate(kept)}
        self._last_seen = {landmark: self._last_seen[landmark] for landmark in {*kept, *seen}}

    def _augment(self, entries: Entries) -> None:
        """New landmarks at their inverse observation, with their correlation to everything known."""
        ids, R = entries.ids, entries.R
        if ids.size == 0:
            return
        n, count = self._n, len(self._number)
        positions = placed(self._entry_sensor, self._T, entries, self._k)
        H_pose, H_land = self._entry_sensor.jacobians(self._T, positions)
        # 0 = H_pose xi + H_land dl - v, solved for dl: no sensor needs a Jacobian of its inverse.
        H_inv = np.linalg.inv(H_land)
        G = -(H_inv @ H_pose).reshape(ids.size * n, -1)
        N = block_diagonal(H_inv @ R @ np.swapaxes(H_inv, 1, 2))
        self._P.augment(G, N)
        if self._unanchored is not None:
            self._unanchored.grow(G, N)
        if count + ids.size > len(self._landmarks):
            self._landmarks = np.concatenate([self._landmarks, np.empty((count + ids.size, n))])
        self._landmarks[count : count + ids.size] = positions
        for offset, landmark in enumerate(ids.tolist()):
            self._number[landmark] = count + offset

    def _correct(self, numbers: IntArray, z: FloatArray, R: FloatArray) -> None:
        """One Gauss–Newton step on prior and observations, in covariance form."""
        # First, for a postponed correction of their means is due now.
        touched = self._P.touch(numbers, self._landmarks)
        seen = self._landmarks[numbers]
        z_predicted, H_pose, H_land = self._sensor.linearise(self._T, seen)
        if self._has_blind_side and not np.isfinite(z_predicted).all():
            exists = with_image(z_predicted, self._k)
            self._dropped += exists.size - int(exists.sum())
            self._correct(numbers[exists], z[exists], R[exists])
            return
        y = self._sensor.residual(z, z_predicted).ravel()
        p = H_pose.shape[2]
        times_H = multiplier(H_pose.reshape(y.size, p), H_land)
        PHt_t = times_H(self._P.columns(touched, self._n).T)
        S = times_H(PHt_t.T[touched]) + block_diagonal(R)
        L, failed = dpotrf(S, lower=1)
        W_t, _ = dtrtrs(L, PHt_t, lower=1, overwrite_b=1)
        e, _ = dtrtrs(L, y, lower=1)
        nis = float(e @ e)
        # dpotrf lets NaN through; it always reaches the NIS.
        if failed or not math.isfinite(nis):
            raise DivergedError(
                f"frame {self._k}: the innovation covariance is not positive definite, or the innovation "
                "not finite; the filter has lost its covariance, or a measurement is spoilt"
            )
        dx = e @ W_t
        self._P.downdate(W_t)
        if self._unanchored is not None:
            states = (p + self._n * numbers[:, None] + np.arange(self._n)).ravel()
            H = np.concatenate([H_pose.reshape(y.size, p), block_diagonal(H_land)], axis=1)
            self._unanchored.observe(np.concatenate([np.arange(p), states]), H, block_diagonal(R))
            self._points = self._T, seen, numbers
        if self._in_world_axes:
            self._T, J = retract_in_world_axes(self._T, dx[:p])
            self._P.propagate(J, self._no_noise)
            if self._unanchored is not None:
                self._unanchored.move(J)
        else:
            self._T = self._T @ exp(dx[:p])
        self._P.shift(self._landmarks, dx)
        self._nis, self._nis_dof = nis, y.size
