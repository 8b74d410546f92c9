"""The observations of a window as rows of one height, whichever of a stream's two sensors made them.

A camera that cannot place a landmark has a second sensor for those that enter (entries.py), whose
measurements may have another dimension. The smaller ones are filled up with zeros, which cost nothing.

========  =====================================================================
symbol    meaning
========  =====================================================================
z         measurements, (M, d)
W         their whiteners, W^T W = R^-1, (M, d, d)
T, l      pose and landmark of each, (M, n+1, n+1) and (M, n)
H         derivatives of h by the body tangent (M, d, p) and the landmark (M, d, n)
========  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamcmp.backends.entries import behind, derivatives, errors
from slamcmp.types import BoolArray, FloatArray, IntArray, SensorModel


@dataclass(frozen=True)
class Sights:
    """How M observations were measured."""

    sensor: SensorModel
    entry_sensor: SensorModel
    entering: BoolArray | None = None
    """Which the entry sensor made, (M,); None: none, or both sensors are one."""

    @property
    def dim(self) -> int:
        """d, the larger dimension of the two sensors' measurements."""
        return max(self.sensor.dim, self.entry_sensor.dim)

    def errors(self, T: FloatArray, landmarks: FloatArray, z: FloatArray) -> FloatArray:
        """h(T, l) - z, (M, d)."""
        if self.entering is None:
            return errors(self.sensor, T, landmarks, z)
        error = np.zeros((len(z), self.dim))
        for sensor, rows in self._parts(self.entering):
            error[rows, : sensor.dim] = errors(sensor, T[rows], landmarks[rows], z[rows, : sensor.dim])
        return error

    def derivatives(
        self, at: FloatArray, landmarks_at: FloatArray, T: FloatArray, landmarks: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """H at poses and landmarks ``at``; zero for what has no image there, or at the estimate T, l."""
        if self.entering is None:
            H_pose, H_land = derivatives(self.sensor, at, landmarks_at)
        else:
            p, n = {3: 3, 4: 6}[at.shape[-1]], landmarks_at.shape[-1]
            H_pose, H_land = np.zeros((len(at), self.dim, p)), np.zeros((len(at), self.dim, n))
            for sensor, rows in self._parts(self.entering):
                d = sensor.dim
                H_pose[rows, :d], H_land[rows, :d] = derivatives(sensor, at[rows], landmarks_at[rows])
        hidden = behind(self.sensor, T, landmarks)
        if hidden is not None and hidden.any():
            H_pose[hidden], H_land[hidden] = 0.0, 0.0
        return H_pose, H_land

    def _parts(self, entering: BoolArray) -> tuple[tuple[SensorModel, BoolArray], ...]:
        return (self.sensor, ~entering), (self.entry_sensor, entering)


@dataclass(frozen=True)
class Measurements:
    """The observations of a window, whitened and filled up, in the order in which they came."""

    z: FloatArray
    """(M, d)."""
    W: FloatArray
    """(M, d, d)."""
    pose_of: IntArray
    """Index in the window of the pose that each was made from, (M,): they ascend."""
    landmark_of: IntArray
    """Number of the landmark that each is of, (M,)."""
    entering: BoolArray
    """Which the entry sensor made, (M,)."""

    @classmethod
    def none(cls, d: int) -> Measurements:
        """No rows of dimension d."""
        no_number = np.empty(0, dtype=np.int64)
        return cls(np.empty((0, d)), np.empty((0, d, d)), no_number, no_number, np.empty(0, dtype=bool))

    def followed_by(self, other: Measurements) -> Measurements:
        """These rows, then the other's."""
        return Measurements(
            np.concatenate([self.z, other.z]),
            np.concatenate([self.W, other.W]),
            np.concatenate([self.pose_of, other.pose_of]),
            np.concatenate([self.landmark_of, other.landmark_of]),
            np.concatenate([self.entering, other.entering]),
        )

    def of(self, rows: slice | BoolArray) -> Measurements:
        """These rows."""
        return Measurements(
            self.z[rows], self.W[rows], self.pose_of[rows], self.landmark_of[rows], self.entering[rows]
        )

    def from_first_pose(self) -> int:
        """How many were made from the window's oldest pose: the first ones."""
        return int(np.searchsorted(self.pose_of, 0, side="right"))

    def renumbered(self, pose_of: IntArray, landmark_of: IntArray) -> Measurements:
        """The same rows with other indices of poses and landmarks."""
        return replace(self, pose_of=pose_of, landmark_of=landmark_of)


def padded(z: FloatArray, W: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Measurements (m, e) and whiteners (m, e, e) with zeros up to dimension d."""
    missing = d - z.shape[1]
    if not missing:
        return z, W
    return np.pad(z, ((0, 0), (0, missing))), np.pad(W, ((0, 0), (0, missing), (0, missing)))
