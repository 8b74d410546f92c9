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
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.backends.covariance import JointCovariance, block_diagonal
from slamcmp.backends.postponed_covariance import PostponedCovariance
from slamcmp.backends.unanchored import Linearisation, UnanchoredFilter, square_root
from slamcmp.errors import DivergedError
from slamcmp.geometry import adjoint_of_inverse, exp, retract_in_world_axes
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, Frame, Landmarks, Problem

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@back_ends.register("ekf_slam")
class EkfSlam:
    """EKF-SLAM with one stacked update per frame.

    Args:
        problem: prior and sensor (planar or spatial; the sensor must be invertible, d = n).
        new_landmarks: "join_first" puts new landmarks into the state before the update (the course's cost
            construction: linearised at the predicted pose); "update_first" corrects the pose with the
            known landmarks first and initialises the new ones from the corrected pose.
        error_state: "world" is the standard EKF; "body" corrects by ``T exp(xi)`` and leaves the covariance
            as it is, which is what relinearising a marginal prior in GTSAM does.
        active_landmarks: with a number, at most that many landmarks, those seen last, are updated at every
            frame and all others only when it is due (postponed_covariance.py): the same numbers, sooner on a
            map of hundreds of landmarks of which few are in sight.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: Literal["join_first", "update_first"] = "join_first",
        error_state: Literal["world", "body"] = "world",
        active_landmarks: Annotated[int, Ge(1)] | None = None,
    ) -> None:
        self._sensor = problem.sensor
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
        self._k = -1
        self._nis = 0.0
        self._nis_dof = 0
        self._unanchored: UnanchoredFilter | None = None
        self._points: tuple[FloatArray, FloatArray, IntArray] | None = None

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        self._k = frame.k
        self._nis, self._nis_dof = 0.0, 0
        self._points = None
        if frame.k > 0:
            self._predict(frame.T_prev_body, frame.Q)
        if frame.ids.size == 0:
            return
        numbers = [self._number.get(landmark, -1) for landmark in frame.ids.tolist()]
        if -1 not in numbers:
            self._correct(np.array(numbers), frame.z, frame.R)
            return
        known = np.array(numbers) >= 0
        new = ~known
        if self._join_first:
            self._augment(frame.ids[new], frame.z[new], frame.R[new])
        if known.any():
            self._correct(np.array(numbers)[known], frame.z[known], frame.R[known])
        if not self._join_first:
            self._augment(frame.ids[new], frame.z[new], frame.R[new])

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T, self._P.pose_block())

    def landmarks(self) -> Landmarks:
        """Every landmark ever seen, in the order of first sight."""
        self._P.settle(self._landmarks)
        count = len(self._number)
        ids = np.fromiter(self._number, dtype=np.int64, count=count)
        return Landmarks(ids, self._landmarks[:count], self._P.diagonal_blocks(self._n))

    def joint_covariance(self) -> FloatArray:
        """P of pose and landmarks, (p + n L, p + n L)."""
        return self._P.dense()

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, and the number of landmarks."""
        return {
            "nis": self._nis if self._nis_dof else float("nan"),
            "nis_dof": self._nis_dof,
            "landmarks": len(self._number),
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

    def _augment(self, ids: IntArray, z: FloatArray, R: FloatArray) -> None:
        """New landmarks at their inverse observation, with their correlation to everything known."""
        n, count = self._n, len(self._number)
        positions = self._sensor.invert(self._T, z)
        H_pose, H_land = self._sensor.jacobians(self._T, positions)
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
        y = self._sensor.residual(z, z_predicted).ravel()
        p = H_pose.shape[2]
        # H without its zero columns: pose first, then the landmarks seen, block by block.
        H = np.concatenate([H_pose.reshape(y.size, p), block_diagonal(H_land)], axis=1)
        PHt = self._P.columns(touched, self._n) @ H.T
        S = H @ PHt[touched] + block_diagonal(R)
        L, failed = dpotrf(S, lower=1)
        W_t, _ = dtrtrs(L, PHt.T, lower=1, overwrite_b=1)
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
            states = np.concatenate(
                [np.arange(p), (p + self._n * numbers[:, None] + np.arange(self._n)).ravel()]
            )
            self._unanchored.observe(states, H, block_diagonal(R))
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
