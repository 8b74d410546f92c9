"""What an estimator would know about its pose from measurements alone, had it known nothing at the start.

Nothing that a robot measures tells where in the world its map lies: a correct estimator would know nothing.
One whose Jacobians do not fit each other takes information about directions that no measurement sees; this
module lets its own linear system run a second time, without the prior on the first pose, and asks what is
left on the current pose once the map is eliminated. The null space of that information is carried by the
steps from that of the observability matrix [H_0; H_1 F_1; H_2 F_2 F_1; …] (Huang, Mourikis, Roumeliotis 2010,
eq. 22), so both have the same nullity: a row is zero for a direction exactly if the direction costs nothing.

The information is kept as a square root, as rows of R with cost |R x|² (Bierman 1977, ch. V and VI), because
zero is then told from rounding at 1e-16 of the Jacobians and not of their squares.

========  ===================================================================
symbol    meaning
========  ===================================================================
x         error of pose (p,) and landmarks (n L,), in the estimator's own chart
R         rows of the square-root information
F, D      a step's transition of the pose's error (p, p), and of each landmark's (n, n)
W, u      the step's noise is W u, u of unit covariance, W (pose or all states, q)
G, N      new landmarks' derivative by the pose's error, and their own noise
H         Jacobian of observations of known landmarks
========  ===================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.backends.filters.error_covariance import (
    Correction,
    Event,
    Growth,
    Joining,
    Leaving,
    Removal,
    Step,
)
from slamcmp.types import FloatArray, IntArray


@dataclass(frozen=True)
class Linearisation:
    """What a frame's linear system claims, and where its Jacobians were taken."""

    root: FloatArray
    """Square root (p, p) of the information about the current pose without a start, in the body tangent:
    its square is zero for a correct estimator."""
    scale: FloatArray
    """(p,): root-sum-square of the whitened observations' Jacobians by the pose, to judge zero by."""
    T_world_body: FloatArray | None = None
    """Pose (n+1, n+1) of the frame's observation Jacobians; None where there are none."""
    landmarks_at: FloatArray | None = None
    """Landmarks (m, n) of the frame's observation Jacobians."""
    landmarks: FloatArray | None = None
    """Where the estimate now has them, (m, n)."""


class UnanchoredFilter:
    """A filter's linear system without its start, driven by the filter's own matrices.

    States are numbered as the filter does: the pose's, then the landmarks' by first sight.

    Args:
        p: dimension of the pose's error.
    """

    def __init__(self, p: int) -> None:
        self._p = p
        self._noise = 0
        self._states = p
        # Columns: the noise of a step in progress, the landmarks, the pose.
        self._rows: list[FloatArray] = [np.empty((0, p))]
        self._squares = np.zeros(p)
        self._joined_at, self._joined_root = 0, np.empty((p, 0))

    def hear(self, event: Event) -> None:
        """Do what the filter did."""
        if isinstance(event, Step):
            W = event.W if event.Q is None else square_root(event.Q)
            if W is not None:
                self._shake(W.shape[1])
            self._step(event.F, event.D, W)
        elif isinstance(event, Growth):
            self._grow(event)
        elif isinstance(event, Correction):
            self._observe(event)
        elif isinstance(event, Removal):
            self._drop(event.states)
        elif isinstance(event, Joining):
            self._joined_at, self._joined_root = event.first, square_root(event.Q)
            self._shake(len(event.Q))
        elif isinstance(event, Leaving):
            self._step(event.F, event.D, event.W @ self._joined_root)

    def told(self) -> tuple[FloatArray, FloatArray]:
        """Root (p, p) of the information on the pose without the map, and its scale (p,), in the chart."""
        return last_block(self._triangle(), self._p), np.sqrt(self._squares)

    def _shake(self, q: int) -> None:
        """Let unit noise u (q,) of the step in progress join."""
        R = self._triangle()
        self._rows = [np.concatenate([np.eye(q, q + self._states), np.pad(R, ((0, 0), (q, 0)))])]
        self._noise = q

    def _step(self, F: FloatArray | None, D: FloatArray | None, W: FloatArray | None) -> None:
        """x becomes F, D times x plus W u, which takes u out again."""
        p, q = self._p, self._noise
        R = self._triangle()
        if F is not None:
            R[:, -p:] = R[:, -p:] @ np.linalg.inv(F)
        if D is not None:
            turned = R[:, q:-p].reshape(len(R), -1, len(D)) @ np.linalg.inv(D)
            R[:, q:-p] = turned.reshape(len(R), -1)
        if W is not None:
            R[:, :q] -= R[:, self._columns(np.arange(len(W)))] @ W
            R = triangular(R)[q:, q:]
        self._noise = 0
        self._rows = [R]

    def _grow(self, growth: Growth) -> None:
        a, p = growth.G.shape
        R = self._triangle()
        grown = np.concatenate([R[:, :-p], np.zeros((len(R), a)), R[:, -p:]], axis=1)
        row = np.zeros((a, grown.shape[1]))
        row[:, -p - a : -p] = np.eye(a)
        if growth.first:
            row[:, : self._noise] = -(growth.G @ self._joined_root)
        else:
            row[:, -p:] = -growth.G
        self._states += a
        self._rows = [grown, _whitened(row, growth.N)]
        self._squares += (self._rows[1][:, -p:] ** 2).sum(axis=0)

    def _observe(self, correction: Correction) -> None:
        touched, H = correction.touched, correction.H
        row = np.zeros((len(H), self._noise + self._states))
        if self._noise:
            at, p = self._joined_at, self._p
            joined = (touched >= at) & (touched < at + p)
            row[:, : self._noise] = H[:, joined] @ self._joined_root
            touched, H = touched[~joined], H[:, ~joined]
            touched = np.where(touched < at, touched, touched - p)
        row[:, self._columns(touched)] = H
        self._rows.append(_whitened(row, correction.R))
        self._squares += (self._rows[-1][:, -self._p :] ** 2).sum(axis=0)

    def _drop(self, states: IntArray) -> None:
        R = self._triangle()
        columns = self._columns(states)
        keep = np.setdiff1d(np.arange(R.shape[1]), columns)
        self._rows = [triangular(R[:, np.concatenate([columns, keep])])[states.size :, states.size :]]
        self._states -= states.size

    def _columns(self, states: IntArray) -> IntArray:
        p, map_size = self._p, self._states - self._p
        return self._noise + np.where(states < p, map_size + states, states - p)

    def _triangle(self) -> FloatArray:
        if len(self._rows) > 1 or len(self._rows[0]) > self._rows[0].shape[1]:
            self._rows = [triangular(np.concatenate(self._rows))]
        return self._rows[0]


def triangular(rows: FloatArray) -> FloatArray:
    """The triangular factor of rows (m, c): the same cost in at most c rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def square_root(P: FloatArray) -> FloatArray:
    """W (s, s) with W W^T = P, for P that may be singular."""
    variances, directions = np.linalg.eigh(P)
    root: FloatArray = directions * np.sqrt(np.maximum(variances, 0.0))
    return root


def last_block(R: FloatArray, p: int) -> FloatArray:
    """The last block (p, p) of a triangular factor that may lack its last rows."""
    block = R[R.shape[1] - p :, -p:]
    return np.pad(block, ((0, p - len(block)), (0, 0)))


def _whitened(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """L^-1 times the rows, covariance = L L^T."""
    whitened: FloatArray = np.linalg.solve(np.linalg.cholesky(covariance), rows)
    return whitened
