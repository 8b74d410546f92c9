"""Where a landmark may be that one measurement does not place: Gaussians with weights, until one has won.

A range leaves a ring, a bearing a ray. Either is covered by a row of narrow Gaussians, evenly along what was
not measured: bearings round the ring, inverse distances along the ray (from its far end, which may be
infinite, to its near one). Each is carried along by the odometry, corrected by the next measurements and
weighed by how likely these were under it; those that have become one are merged, those that nothing speaks
for any more are dropped, one that has grown wide is divided again. What is left is the posterior as a sum of
Gaussians (Alspach and Sorenson 1972; for ranges Blanco, Fernández-Madrigal and González 2008; the row along
a ray with inverse distances is that of Montiel, Civera and Davison 2006, in several pieces).

Everything is in polar coordinates about the robot, where the measurement is one of the two coordinates: the
correction is linear, and a ring is as straight as a ray (Aidala and Hammel 1983 track by bearings in these
coordinates). Only the robot's motion bends anything, by little in a step.

========  =========================================================================
symbol    meaning
========  =========================================================================
y         one hypothesis: (range, bearing), or (1 / range, bearing), (h, 2)
P         its covariance, (h, 2, 2)
w         log weights, (h,)
z, s2     a measurement and its variance
t, R      the step: translation (2,) and rotation (2, 2) of ``T_prev_body``
m         a vector along the landmark's direction after the step, (h, 2): the landmark itself, or it
          divided by its range before the step
========  =========================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from slamcmp.geometry import wrap
from slamcmp.types import BoolArray, FloatArray, IntArray

Measured = Literal["range", "bearing"]

ROOM = 2.0
"""Neighbours in a row stand so many of their sigmas apart: their sum is level to 1.4 %."""
WIDEST = 1.5
"""A hypothesis wider than so many times the sigma it was made with is divided."""
WIDEST_NEAR = 0.25
"""On a ray, one may also be as wide as this share of its inverse range: a near one is not cut to pieces."""
SAME = 1.0
"""Squared Mahalanobis distance below which two hypotheses are merged."""
LEAST_WEIGHT = 1e-9
"""Share below which a hypothesis is dropped."""
DIVIDED_TO = 3.0
"""How many sigmas to each side the parts of a divided hypothesis reach."""
MOST_PARTS = 12
"""To each side of its middle."""
MOST = 400
"""Hypotheses of one landmark; beyond it the lightest go."""
EVEN = math.pi**2 / 3.0
"""Variance of a bearing that nothing is known about."""


class Winner(NamedTuple):
    """The heaviest hypothesis, in the terms of the sensor ``range_bearing``."""

    probability: float
    z: FloatArray
    """Range [m] and bearing [rad], (2,)."""
    R: FloatArray
    """Their covariance, (2, 2)."""

    @property
    def spread(self) -> float:
        """Largest sigma of its position as a share of its distance; infinite for a range below 0."""
        r = float(self.z[0])
        if r <= 0:
            return math.inf
        scale = np.array([1.0 / r, 1.0])
        return math.sqrt(max(0.0, float(np.linalg.eigvalsh(self.R * np.outer(scale, scale))[-1])))


@dataclass
class Hypotheses:
    """One landmark's.

    Args:
        measured: which of its polar coordinates the sensor reports.
        z, variance: the first measurement.
        count: hypotheses in the row.
        gate: largest squared Mahalanobis distance of a measurement that corrects a hypothesis; one farther
            off leaves it as it is, and counts as if it were on the gate.
        nearest_m, farthest_m: ends of the ray; the farther may be infinite.
    """

    measured: Measured
    y: FloatArray
    P: FloatArray
    w: FloatArray
    sigma: float
    """With which the row was made, of what is not measured."""
    gate: float

    @classmethod
    def begin(
        cls,
        measured: Measured,
        z: float,
        variance: float,
        *,
        count: int,
        gate: float,
        nearest_m: float,
        farthest_m: float,
    ) -> Hypotheses:
        """The row that the first measurement leaves."""
        y = np.empty((count, 2))
        if measured == "range":
            room = 2.0 * math.pi / count
            y[:, 0] = z
            y[:, 1] = wrap(np.arange(count) * room)
        else:
            near, far = 1.0 / nearest_m, 1.0 / farthest_m
            room = (near - far) / count
            y[:, 0] = far + (np.arange(count) + 0.5) * room
            y[:, 1] = z
        sigma = room / ROOM
        own = [variance, sigma**2] if measured == "range" else [sigma**2, variance]
        P = np.tile(np.diag(own), (count, 1, 1))
        return cls(measured, y, P, np.full(count, -math.log(count)), sigma, gate)

    @property
    def _seen(self) -> int:
        """Index of the measured coordinate."""
        return 0 if self.measured == "range" else 1

    @property
    def probabilities(self) -> FloatArray:
        """(h,), of sum 1."""
        shares: FloatArray = np.exp(self.w)
        return shares

    def move(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Carry all into the new body frame; Q (3, 3) is the step's covariance in its tangent."""
        R, t = T_prev_body[:2, :2], T_prev_body[:2, 2]
        first, bearing = self.y[:, 0], self.y[:, 1]
        u = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        across = np.stack([-u[:, 1], u[:, 0]], axis=-1)
        if self.measured == "range":
            m = (first[:, None] * u - t) @ R
            by_y = np.stack([u @ R, first[:, None] * across @ R], axis=-1)
            moves = np.ones(len(m))
        else:
            m = (u - first[:, None] * t) @ R
            by_y = np.stack([np.broadcast_to(-t @ R, m.shape), across @ R], axis=-1)
            moves = first
        # dq = -v - theta J q of models/sensors.py; m is q, or q / r.
        by_step = np.zeros((len(m), 2, 3))
        by_step[:, 0, 0] = by_step[:, 1, 1] = -moves
        by_step[:, 0, 2], by_step[:, 1, 2] = m[:, 1], -m[:, 0]
        length = np.maximum(np.hypot(m[:, 0], m[:, 1]), np.finfo(float).tiny)
        along = m / length[:, None]
        turned = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, None]
        F, G = np.empty((len(m), 2, 2)), np.empty((len(m), 2, 3))
        for J, by in ((F, by_y), (G, by_step)):
            J[:, 0] = np.einsum("hi,hij->hj", along, by)
            J[:, 1] = np.einsum("hi,hij->hj", turned, by)
        if self.measured == "range":
            self.y[:, 0] = length
        else:
            F[:, 0] *= (-first / length**2)[:, None]
            G[:, 0] *= (-first / length**2)[:, None]
            F[:, 0, 0] += 1.0 / length
            self.y[:, 0] = first / length
        self.y[:, 1] = np.arctan2(m[:, 1], m[:, 0])
        P = F @ self.P @ np.swapaxes(F, 1, 2) + G @ Q @ np.swapaxes(G, 1, 2)
        # Right beside a landmark its bearing may be any, and no more than that.
        excess = np.ones((len(P), 2))
        excess[:, 1] = np.sqrt(np.minimum(1.0, EVEN / np.maximum(P[:, 1, 1], EVEN)))
        P *= excess[:, :, None] * excess[:, None, :]
        self.P = 0.5 * (P + np.swapaxes(P, 1, 2))
        self._divide_wide()

    def observe(self, z: float, variance: float) -> bool:
        """Correct and weigh all by a measurement; False where it is outside every hypothesis' gate."""
        c = self._seen
        y = z - self.y[:, c]
        if c == 1:
            y = wrap(y)
        S = self.P[:, c, c] + variance
        distance = y**2 / S
        near = distance <= self.gate
        self.w = self.w - 0.5 * (np.minimum(distance, self.gate) + np.log(S))
        self.w -= self.w.max()
        self.w -= math.log(float(np.exp(self.w).sum()))
        K = np.where(near[:, None], self.P[:, :, c] / S[:, None], 0.0)
        self.y = self.y + K * y[:, None]
        P = self.P - K[:, :, None] * self.P[:, None, c, :]
        self.P = 0.5 * (P + np.swapaxes(P, 1, 2))
        if c == 0:
            self.y[:, 0] = np.abs(self.y[:, 0])
        self.y[:, 1] = wrap(self.y[:, 1])
        self._keep_heavy()
        self._merge()
        return bool(near.any())

    def winner(self) -> Winner:
        """The heaviest hypothesis as range and bearing."""
        best = int(np.argmax(self.w))
        (first, bearing), P = self.y[best], self.P[best]
        probability = float(self.probabilities[best])
        if self.measured == "range":
            return Winner(probability, self.y[best].copy(), P.copy())
        if first <= 0:
            return Winner(probability, np.array([-1.0, bearing]), P.copy())
        J = np.diag([-1.0 / first**2, 1.0])
        return Winner(probability, np.array([1.0 / first, bearing]), J @ P @ J.T)

    def _widest(self, y: FloatArray) -> FloatArray:
        """How wide a hypothesis at y (..., 2) may be in what is not measured, (...)."""
        widest = np.full(y.shape[:-1], WIDEST * self.sigma)
        return widest if self.measured == "range" else np.maximum(widest, WIDEST_NEAR * y[..., 0])

    def _keep_heavy(self) -> None:
        """Drop those that nothing speaks for, and of too many the lightest."""
        order = np.argsort(-self.w, kind="stable")[:MOST]
        rows: IntArray = np.sort(order[self.w[order] >= self.w.max() + math.log(LEAST_WEIGHT)])
        self.y, self.P, self.w = self.y[rows], self.P[rows], self.w[rows]
        self.w = self.w - math.log(float(np.exp(self.w).sum()))

    def _merge(self) -> None:
        """Give each group that has become one its common mean and covariance, the heaviest first."""
        close = self._close()
        if not close.any():
            return
        left = np.argsort(-self.w, kind="stable")
        means, covariances, weights = [], [], []
        while left.size:
            head, others = left[0], left[1:]
            beside = close[head, others]
            group = np.concatenate([[head], others[beside]])
            y, P = self._together(group)
            if P[1 - self._seen, 1 - self._seen] > self._widest(self.y[head]) ** 2 and group.size > 1:
                # Too wide to be one: the head stays as it is, and the others have their own turn.
                beside = np.zeros(others.size, dtype=bool)
                group, y, P = group[:1], self.y[head], self.P[head]
            means.append(y)
            covariances.append(P)
            weights.append(math.log(float(np.exp(self.w[group]).sum())))
            left = others[~beside]
        self.y, self.P, self.w = np.array(means), np.array(covariances), np.array(weights)

    def _close(self) -> BoolArray:
        """Which pairs are as good as one, (h, h); nobody is close to itself."""
        difference = self.y[:, None] - self.y[None]
        difference[..., 1] = wrap(difference[..., 1])
        S = self.P[:, None] + self.P[None]
        x, y = np.moveaxis(difference, -1, 0)
        determinant = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
        distance = x**2 * S[..., 1, 1] - 2.0 * x * y * S[..., 0, 1] + y**2 * S[..., 0, 0]
        close: BoolArray = distance < SAME * determinant
        np.fill_diagonal(close, val=False)
        return close

    def _together(self, group: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean (2,) and covariance (2, 2) of several, of whose bearings the first's is the origin."""
        offset = self.y[group] - self.y[group[0]]
        offset[:, 1] = wrap(offset[:, 1])
        share = np.exp(self.w[group] - self.w[group].max())
        share /= share.sum()
        mean = share @ offset
        apart = offset - mean
        P = np.einsum("h,hij->ij", share, self.P[group] + apart[:, :, None] * apart[:, None, :])
        y = self.y[group[0]] + mean
        y[1] = wrap(y[1])
        return y, P

    def _divide_wide(self) -> None:
        """Replace what has grown too wide by a row of narrower ones with the same mean and covariance."""
        free = 1 - self._seen
        variance = self.P[:, free, free]
        wide = np.flatnonzero(variance > self._widest(self.y) ** 2)
        if not wide.size:
            return
        stay = np.setdiff1d(np.arange(len(self.w)), wide)
        means, covariances, weights = [self.y[stay]], [self.P[stay]], [self.w[stay]]
        for row in wide.tolist():
            whole = math.sqrt(variance[row])
            steps = min(math.ceil(DIVIDED_TO * whole / (ROOM * self.sigma)), MOST_PARTS)
            part = max(self.sigma, DIVIDED_TO * whole / (ROOM * steps))
            at = ROOM * part * np.arange(-steps, steps + 1)
            between = max(whole**2 - part**2, np.finfo(float).tiny)
            share = np.exp(-0.5 * at**2 / between)
            slope = self.P[row][:, free] / variance[row]
            y = self.y[row] + at[:, None] * slope
            y[:, 1] = wrap(y[:, 1])
            P = self.P[row] - (variance[row] - part**2) * np.outer(slope, slope)
            means.append(y)
            covariances.append(np.tile(P, (at.size, 1, 1)))
            weights.append(self.w[row] + np.log(share / share.sum()))
        self.y, self.P, self.w = (
            np.concatenate(means),
            np.concatenate(covariances),
            np.concatenate(weights),
        )
        self._keep_heavy()
