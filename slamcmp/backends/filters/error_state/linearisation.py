"""Where an EKF-SLAM takes its Jacobians: the one difference between standard, FEJ, OC and ideal filters.

All in the world-additive chart, where the global translations and rotations that no measurement can see are
(per axis of rotation) N = [axis x p_N; axis; axis x l_N …]. A motion Jacobian taken between the points p_from
and p_to carries p_N to p_N + p_to - p_from; an observation Jacobian at (p, l) has H N = 0 exactly if
l - p = l_N - p_N. A policy that keeps this for every frame keeps the unobservable directions unobservable
(Huang, Mourikis, Roumeliotis 2010, "Observability-based rules …", eq. 26 to 40).
"""

from __future__ import annotations

import numpy as np

from slamcmp.backends.far_points import FarPoints
from slamcmp.errors import UsageError
from slamcmp.types import BoolArray, FloatArray, GroundTruth, IntArray

Points = tuple[FloatArray, FloatArray]
"""A pose (n+1, n+1) and landmarks (m, n), or two poses."""


class LatestEstimate:
    """Every Jacobian at the newest estimate: the standard EKF."""

    def motion(
        self,
        k: int,  # noqa: ARG002
        T_before: FloatArray,
        T_after: FloatArray,
        seen: IntArray,  # noqa: ARG002
        landmarks: FloatArray,  # noqa: ARG002
    ) -> Points:
        """Poses at which the step from frame k-1 to k is linearised.

        Args:
            k: the frame that the step leads to.
            T_before: the mean after frame k-1's update.
            T_after: the predicted mean.
            seen: numbers (m,) of the known landmarks that frame k observes.
            landmarks: their means, (m, n).
        """
        return T_before, T_after

    def known(self, T: FloatArray, numbers: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        """Pose and landmarks at which observations of known landmarks are linearised, the means being T
        (predicted) and ``landmarks`` (m, n)."""
        return T, landmarks

    def new(self, T: FloatArray, ids: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        """The same for landmarks that now join the state at ``landmarks`` (m, n); T is the mean now."""
        return T, landmarks

    def keep(self, stays: BoolArray) -> None:
        """The landmarks that are not marked (L,) have left the state."""

    def require_near(self, k: int, T: FloatArray, landmarks: FloatArray, at: Points) -> None:
        """Nothing: the newest estimate is its own point, and the truth no estimate's."""


class RememberedPoints(LatestEstimate):
    """Points that stay behind when the estimates move on, and may be left too far behind (far_points.py)."""

    def __init__(self) -> None:
        self._far = FarPoints()

    def require_near(self, k: int, T: FloatArray, landmarks: FloatArray, at: Points) -> None:
        """Compare where frame k's landmarks lie from the robot, by the points and by the estimates.

        Raises:
            DivergedError: one lies too far off.
        """
        T_at, landmarks_at = at
        self._far.require_near(k, landmarks_at - T_at[:-1, -1], landmarks - T[:-1, -1])


class FirstEstimates(RememberedPoints):
    """First-estimates Jacobians (Huang, Mourikis, Roumeliotis 2008): each variable only at its first one.

    Args:
        T: prior mean of the first pose.
        new_at_predicted: linearise the initialisation of a landmark at the frame's predicted pose, which is
            what keeps the unobservable directions; at the updated pose, as in its authors' published
            code, a frame that corrects and then adds landmarks loses them.
    """

    def __init__(self, T: FloatArray, *, new_at_predicted: bool = True) -> None:
        super().__init__()
        self._T_first = T
        self._landmarks = np.empty((0, T.shape[0] - 1))
        self._new_at_predicted = new_at_predicted

    def motion(
        self,
        k: int,  # noqa: ARG002
        T_before: FloatArray,  # noqa: ARG002
        T_after: FloatArray,
        seen: IntArray,  # noqa: ARG002
        landmarks: FloatArray,  # noqa: ARG002
    ) -> Points:
        T_from, self._T_first = self._T_first, T_after
        return T_from, T_after

    def known(self, T: FloatArray, numbers: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        return T, self._landmarks[numbers]

    def keep(self, stays: BoolArray) -> None:
        self._landmarks = self._landmarks[stays]

    def new(self, T: FloatArray, ids: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        self._landmarks = np.concatenate([self._landmarks, landmarks])
        self._far.placed(landmarks - T[:-1, -1])
        return (self._T_first if self._new_at_predicted else T), landmarks


class ObservabilityConstrained(RememberedPoints):
    """The points nearest to the newest estimates that keep the unobservable directions (OC-EKF 2010).

    Per frame, a shift s of the pose left behind and the landmarks' points l* minimise
    |s|² + sum |l* - l_hat|² under l* - p = l_N - p_N, which couples all landmarks of the frame through s:
    s = sum (l_hat - l_N - p_before + p_N) / (m + 1). A new landmark is linearised at the predicted pose.

    A metre of a landmark weighs as much as one of the pose there, which is fair where every measurement tells
    a landmark's place. A single camera's depths move by tens of metres while they become known: their mean
    would take the pose's point along (on KITTI by up to 14 m in a step of 1.2 m). Where poses are far better
    known than landmarks the same least squares, weighted, leaves them where they are: s = 0.

    Args:
        T: prior mean of the first pose.
        shift_pose: False takes s = 0.
    """

    def __init__(self, T: FloatArray, *, shift_pose: bool = True) -> None:
        super().__init__()
        self._shift_pose = shift_pose
        self._T_predicted = T
        self._null_position = T[:-1, -1].copy()
        self._null_landmarks = np.empty((0, T.shape[0] - 1))

    def motion(
        self,
        k: int,  # noqa: ARG002
        T_before: FloatArray,
        T_after: FloatArray,
        seen: IntArray,
        landmarks: FloatArray,
    ) -> Points:
        T_from = T_before.copy()
        # A robot that has not moved is at the same pose still: there is no step whose point to choose.
        if self._shift_pose and not np.array_equal(T_before, T_after):
            drift = landmarks - self._null_landmarks[seen] - T_before[:-1, -1] + self._null_position
            T_from[:-1, -1] += drift.sum(axis=0) / (len(drift) + 1)
        self._null_position = self._null_position + T_after[:-1, -1] - T_from[:-1, -1]
        self._T_predicted = T_after
        return T_from, T_after

    def known(self, T: FloatArray, numbers: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        return T, self._null_landmarks[numbers] + T[:-1, -1] - self._null_position

    def keep(self, stays: BoolArray) -> None:
        self._null_landmarks = self._null_landmarks[stays]

    def new(self, T: FloatArray, ids: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        self._far.placed(landmarks - T[:-1, -1])
        shifted = landmarks - self._T_predicted[:-1, -1] + self._null_position
        self._null_landmarks = np.concatenate([self._null_landmarks, shifted])
        return self._T_predicted, landmarks


class Truth(LatestEstimate):
    """Every Jacobian at the true poses and landmarks: the ideal filter, a yardstick that no robot has.

    Raises:
        UsageError: a landmark that the truth does not know.
    """

    def __init__(self, truth: GroundTruth) -> None:
        if not truth.known().all():
            gap = int(np.argmin(truth.known()))
            raise UsageError(f"ekf_ideal: the truth has a gap at frame {gap}; it needs every frame's")
        self._truth = truth
        self._row = {int(landmark): row for row, landmark in enumerate(truth.ids)}
        self._landmarks = np.empty((0, truth.positions.shape[1]))
        self._T = truth.T_world_body[0]

    @property
    def true_landmarks(self) -> FloatArray:
        """Those that have joined the state, (L, n)."""
        return self._landmarks

    def poses(self, frames: IntArray) -> FloatArray:
        """The true poses at frames (K,), (K, n+1, n+1)."""
        poses: FloatArray = self._truth.T_world_body[frames]
        return poses

    def motion(
        self,
        k: int,
        T_before: FloatArray,  # noqa: ARG002
        T_after: FloatArray,  # noqa: ARG002
        seen: IntArray,  # noqa: ARG002
        landmarks: FloatArray,  # noqa: ARG002
    ) -> Points:
        T_from, self._T = self._truth.T_world_body[k - 1], self._truth.T_world_body[k]
        return T_from, self._T

    def known(self, T: FloatArray, numbers: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        return self._T, self._landmarks[numbers]

    def keep(self, stays: BoolArray) -> None:
        self._landmarks = self._landmarks[stays]

    def new(self, T: FloatArray, ids: IntArray, landmarks: FloatArray) -> Points:  # noqa: ARG002
        missing = [landmark for landmark in ids.tolist() if landmark not in self._row]
        if missing:
            raise UsageError(f"ekf_ideal: the truth has no landmark {missing[0]}; it needs every landmark's")
        true = self._truth.positions[[self._row[landmark] for landmark in ids.tolist()]]
        self._landmarks = np.concatenate([self._landmarks, true])
        return self._T, true
