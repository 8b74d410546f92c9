"""Closed-loop gating: a back end decides by its own covariance which observations it believes.

In the shared mode one front end gates for all, by a prediction that belongs to none of them. Here each back
end gets the ungated stream and predicts, from its own pose, map and joint covariance, where every known
landmark should appear; what lies too far off is taken out of its copy of the frame. An overconfident back
end expects too little, and closes its eyes to the very observations that would correct it.

The test is the course's: each observation alone (individual compatibility), chi-square with d degrees of
freedom. Jacobians are the sensor's at the back end's own prediction, whatever policy it linearises by
itself. A landmark that is not in the map passes untested; one that was placed by an outlier stays rejected,
for to start it anew is a front end's business, not a gate's.

========  ===================================================================
symbol    meaning (Neira and Tardós 2001, eq. 4, for the test)
========  ===================================================================
T         predicted pose, the last one moved by the odometry increment
P         joint covariance, pose (body tangent) first, then landmarks (world)
A, Q      Ad(T_prev_body^-1) and the increment's covariance
H         Jacobians of the measurement by pose (m, d, p) and landmark (m, d, n)
y, S      innovations (m, d) and their covariances (m, d, d), R included
========  ===================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from slamcmp.errors import DivergedError, UsageError
from slamcmp.geometry import adjoint_of_inverse
from slamcmp.protocols import BackEnd, Diagnosed, JointEstimator, LocalEstimator
from slamcmp.types import TANGENT_DIM, BoolArray, Estimate, FloatArray, Frame, IntArray, Landmarks, Problem

PASSED_ON = ("trajectory", "record_linearisation", "linearisation")
"""What the gated back end offers if the one behind the gate does."""


class OwnGate:
    """A back end behind its own Mahalanobis gate; asked for anything else, it answers itself.

    Args:
        back_end: it must tell its joint covariance.
        problem: the one the back end was made with.
        probability: share of correct observations that pass if the covariance is right, in (0, 1).

    Raises:
        UsageError: the back end cannot tell its joint covariance, or the probability is not in (0, 1).
        DivergedError: an innovation covariance is singular.
    """

    def __init__(self, back_end: BackEnd, problem: Problem, probability: float) -> None:
        if not isinstance(back_end, JointEstimator):
            raise UsageError(
                f"own_gate: {type(back_end).__name__} has no joint_covariance(), which a gate of its own "
                "predicts innovations with; leave own_gate out and gate in the front end"
            )
        if not 0.0 < probability < 1.0:
            raise UsageError(f"own_gate is {probability:g}; a probability between 0 and 1 is needed")
        self._back_end: BackEnd = back_end
        self._map: JointEstimator = back_end
        self._sensor = problem.sensor
        self._p = TANGENT_DIM[problem.sensor.space_dim]
        self._threshold = float(chdtri(problem.sensor.dim, 1.0 - probability))
        self._seen: set[int] = set()
        self._kept: BoolArray = np.empty(0, dtype=bool)
        self._tested = 0
        # As attributes of its own: a protocol's isinstance looks for no others.
        for name in PASSED_ON:
            if hasattr(back_end, name):
                setattr(self, name, getattr(back_end, name))

    def update(self, frame: Frame) -> None:
        """Test the frame's observations of known landmarks and hand on those that pass."""
        distances = self._squared_distances(frame)
        # What is not finite passes: the back end then says itself that it has diverged.
        self._kept = ~(distances > self._threshold)
        self._tested = int((~np.isnan(distances)).sum())
        if not self._kept.all():
            frame = replace(frame, ids=frame.ids[self._kept], z=frame.z[self._kept], R=frame.R[self._kept])
        self._seen.update(frame.ids.tolist())
        if frame.entries is not None:
            self._seen.update(frame.entries.ids.tolist())
        self._back_end.update(frame)

    def estimate(self) -> Estimate:
        """The back end's."""
        return self._back_end.estimate()

    def landmarks(self) -> Landmarks:
        """The back end's."""
        return self._map.landmarks()

    def joint_covariance(self) -> FloatArray:
        """The back end's."""
        return self._map.joint_covariance()

    def kept_observations(self) -> BoolArray:
        """Which observations of the last frame were handed on, (m,)."""
        return self._kept

    def diagnostics(self) -> Mapping[str, float]:
        """The back end's, and how many observations of the last frame were tested and rejected."""
        own = self._back_end.diagnostics() if isinstance(self._back_end, Diagnosed) else {}
        rejected = self._kept.size - int(self._kept.sum())
        return {**own, "gate_tested": self._tested, "gate_rejected": rejected}

    def _squared_distances(self, frame: Frame) -> FloatArray:
        """Squared Mahalanobis distance of each innovation, (m,); NaN where the landmark is not known."""
        distances = np.full(frame.ids.size, np.nan)
        if self._seen.isdisjoint(frame.ids.tolist()):
            return distances
        ids, positions, P = self._local_map(frame.ids)
        rows = {landmark: row for row, landmark in enumerate(ids.tolist())}
        known = np.array([landmark in rows for landmark in frame.ids.tolist()])
        if not known.any():
            return distances
        order = np.array([rows[landmark] for landmark in frame.ids[known].tolist()])
        T = self._back_end.estimate().T_world_body @ frame.T_prev_body
        z_predicted, H_pose, H_land = self._sensor.linearise(T, positions[order])
        P_pose, P_cross, P_land = predicted_blocks(P, frame, self._p, positions.shape[1])
        S = innovation_covariances(H_pose, H_land, P_pose, P_cross[order], P_land[order], frame.R[known])
        y = self._sensor.residual(frame.z[known], z_predicted)
        try:
            distances[known] = (y * np.linalg.solve(S, y[..., None])[..., 0]).sum(axis=-1)
        except np.linalg.LinAlgError as error:
            raise DivergedError("its gate met a singular innovation covariance") from error
        return distances

    def _local_map(self, ids: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        if isinstance(self._back_end, LocalEstimator):
            return self._back_end.local_map(ids)
        landmarks = self._map.landmarks()
        return landmarks.ids, landmarks.positions, self._map.joint_covariance()


def predicted_blocks(
    P: FloatArray, frame: Frame, p: int, n: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The blocks that single innovations need, after the frame's odometry.

    Args:
        P: joint covariance before it, (p + n L, p + n L).
        frame: the odometry.
        p, n: dimensions of the pose's tangent and of space.

    Returns:
        The pose's (p, p), pose with landmark (L, p, n), the landmarks' own (L, n, n).
    """
    A = adjoint_of_inverse(frame.T_prev_body)
    count = (P.shape[0] - p) // n
    index = np.arange(count)
    P_cross = (A @ P[:p, p:]).reshape(p, count, n).transpose(1, 0, 2)
    P_land = P[p:, p:].reshape(count, n, count, n)[index, :, index, :]
    return A @ P[:p, :p] @ A.T + frame.Q, P_cross, P_land


def innovation_covariances(
    H_pose: FloatArray,
    H_land: FloatArray,
    P_pose: FloatArray,
    P_cross: FloatArray,
    P_land: FloatArray,
    R: FloatArray,
) -> FloatArray:
    """S of each observation alone, (m, d, d), from (m, d, p), (m, d, n), (p, p), (m, p, n), (m, n, n), R."""
    across = H_pose @ P_cross @ np.swapaxes(H_land, 1, 2)
    own = H_pose @ P_pose @ np.swapaxes(H_pose, 1, 2) + H_land @ P_land @ np.swapaxes(H_land, 1, 2)
    S: FloatArray = own + across + np.swapaxes(across, 1, 2) + R
    return S
