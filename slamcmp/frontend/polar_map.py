"""The front end's own map of the plane with a chart that a wrong heading does not bend.

A robot that turned by more than was told finds its landmarks on arcs around itself. Their deviations are
taken along these arcs: in range, and in bearing times range. In this chart an error of the heading, however
large, is linear, and the covariance that odometry has accumulated says how far along the arc a landmark can
be. Straight deviations leave the arc by r (1 - cos e) with an error e: half a metre at 6 m and 0.4 rad,
which no gate holds after half a minute without a sighting.

========  =====================================================================
symbol    meaning
========  =====================================================================
u, r      direction and range of a landmark q = r u in the body frame
d         deviation (m), in the axes of the body: along u the range's, across it r times the bearing's
========  =====================================================================
"""

from __future__ import annotations

from typing import Self

import numpy as np

from slamcmp.frontend.own_map import SCALES, OwnMap
from slamcmp.geometry import rotation, se2
from slamcmp.types import FloatArray, IntArray

NEAREST_M = 0.5
"""Landmarks nearer than this move straight: around the robot itself there is no bearing."""
JOINED_M = 1e-3
"""How far apart two landmarks that are one may be [m]; zero would leave P singular."""


class PolarMap(OwnMap):
    """OwnMap of the plane in ranges and bearings.

    Args:
        scale_sigma: of each share a.
    """

    def __init__(self, scale_sigma: float) -> None:
        super().__init__(2, scale_sigma)

    def copy(self) -> Self:
        """One that moves on by itself; nothing is changed in place."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other

    def correct(self, rows: IntArray, x: FloatArray, N: FloatArray) -> None:
        """Take in detections (m, 2) of the landmarks ``rows`` (m,); see :meth:`OwnMap.correct`.

        The noise (m, 2, 2) turns with the bearing from where a detection was made to where it was expected.
        """
        R = _turns(-_bearings(self.q[rows], x))
        super().correct(rows, x, R @ N @ np.swapaxes(R, 1, 2))

    def separations(self) -> tuple[FloatArray, FloatArray]:
        """Differences q_a - q_b (L, L, 2) of the landmarks, and their covariances (L, L, 2, 2)."""
        rows = np.arange(len(self.q))
        C = self._blocks(rows, rows)
        own = C[rows, rows]
        return self.q[:, None] - self.q[None], own[:, None] + own[None] - C - np.swapaxes(C, 0, 1)

    def join(self, row: int, other: int) -> None:
        """Two landmarks are one: the ``other`` row is taken into the ``row`` and dropped."""
        H = np.zeros((2, len(self.P)))
        H[[0, 1], self._states(np.array([row]))] = 1.0
        H[[0, 1], self._states(np.array([other]))] = -1.0
        self._update(H, self.q[other] - self.q[row], JOINED_M**2 * np.eye(2))
        self.drop(other)

    def _deviations(self, q: FloatArray, x: FloatArray) -> FloatArray:
        r, u = _polar(q)
        across = np.stack([-u[..., 1], u[..., 0]], axis=-1)
        along = np.linalg.norm(x, axis=-1) - r
        return np.asarray(u * along[..., None] + across * (r * _bearings(q, x))[..., None])

    def _move(self, d: FloatArray) -> None:
        r, u = _polar(self.q)
        along, across = (u * d).sum(axis=-1), u[:, 0] * d[:, 1] - u[:, 1] * d[:, 0]
        near = (r < NEAREST_M) | (r + along < NEAREST_M / 2)
        R = _turns(np.where(near, 0.0, across / r))
        self.q = np.where(near[:, None], self.q + d, (R @ u[..., None])[..., 0] * (r + along)[:, None])
        # The axes of each tangent turn with its landmark.
        size = len(self.P)
        P = self.P[SCALES:].reshape(-1, 2, size)
        rows = np.concatenate([self.P[:SCALES], (R @ P).reshape(-1, size)])
        columns = (R @ rows.T[SCALES:].reshape(-1, 2, size)).reshape(-1, size)
        turned = np.concatenate([rows.T[:SCALES], columns])
        self.P = 0.5 * (turned + turned.T)


def _polar(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ranges (…) and directions (…, 2)."""
    r = np.maximum(np.linalg.norm(q, axis=-1), 1e-6)
    return r, q / r[..., None]


def _bearings(q: FloatArray, x: FloatArray) -> FloatArray:
    """Of points x (…, 2) as seen from the robot, from landmarks q (…, 2), in (-pi, pi]."""
    across = q[..., 0] * x[..., 1] - q[..., 1] * x[..., 0]
    return np.asarray(np.arctan2(across, (q * x).sum(axis=-1)))


def _turns(angles: FloatArray) -> FloatArray:
    """Rotations (…, 2, 2)."""
    return rotation(se2(np.zeros_like(angles), np.zeros_like(angles), angles))
