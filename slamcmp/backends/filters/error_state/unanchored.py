"""What a filter's linear system would claim about the pose, had nothing been known at the start.

As ../../unanchored.py says, which has what windows share with it.

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

import numpy as np

from slamcmp.backends.filters.covariances.error_covariance import (
    Correction,
    Event,
    Growth,
    Joining,
    Leaving,
    Removal,
    Step,
)
from slamcmp.backends.unanchored import last_block, triangular
from slamcmp.types import FloatArray, IntArray


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


def square_root(P: FloatArray) -> FloatArray:
    """W (s, s) with W W^T = P, for P that may be singular."""
    variances, directions = np.linalg.eigh(P)
    root: FloatArray = directions * np.sqrt(np.maximum(variances, 0.0))
    return root


def _whitened(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """L^-1 times the rows, covariance = L L^T."""
    whitened: FloatArray = np.linalg.solve(np.linalg.cholesky(covariance), rows)
    return whitened
