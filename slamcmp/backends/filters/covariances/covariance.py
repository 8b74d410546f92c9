"""The joint covariance of an EKF-SLAM state, changed in place by a few named verbs.

The measurement update ``P -= W W^T`` is the whole cost of EKF-SLAM: for n states and k measured components
it takes n² k multiply-adds if only one triangle is kept. Two layouts, measured in benchmarks/README.md:

* up to ``FULL_LIMIT`` states, both triangles in C order: columns are plain indexing and BLAS call overhead,
  not arithmetic, decides;
* above, and for compiled loops at any size, one Fortran-ordered buffer of which only the lower triangle is
  valid, updated by BLAS ``dsyrk`` in place. Its leading view is not contiguous and f2py would silently copy
  it, so BLAS always gets the whole buffer; the unused rows and columns are zero and stay zero.

========  ========================================================
symbol    meaning
========  ========================================================
P         joint covariance (n, n): pose tangent first, then landmarks
A         derivative of the pose's new error by its old one, (p, p)
G         derivative of new states by the pose, (a, p)
W         square root of the downdate, (n, k)
========  ========================================================
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg.blas import dsyrk

from slamcmp.types import FloatArray, IntArray

FULL_LIMIT = 256
"""Most states for which both triangles are kept."""


class JointCovariance:
    """P of a pose (first) and a growing map.

    Args:
        P: covariance of the pose, (p, p).
    """

    def __init__(self, P: FloatArray) -> None:
        self._p = P.shape[0]
        self._pose_states = np.arange(self._p)
        self._landmark_states = np.empty((0, 1), dtype=np.int64)
        """Each landmark's places in P, (L, size); as of the last ``touch``."""
        self._n = self._p
        self._full, self._full_limit = True, FULL_LIMIT
        self._buffer = np.array(P, dtype=np.float64, order="C")
        self._scratch = np.empty_like(self._buffer)

    @property
    def size(self) -> int:
        """n, the number of states."""
        n: int = self._n
        return n

    def keep_one_triangle(self) -> None:
        """From now on one triangle only, at any size: the layout of compiled loops."""
        self._full_limit = 0
        self._move(self._n)

    def rows(self) -> FloatArray:
        """The buffer, whose rows are contiguous and whose upper triangle counts, to be changed in place."""
        return self._buffer.T

    def make_room(self, size: int) -> None:
        """Let ``size`` states count, of which the new ones are for somebody else to fill in."""
        self._reserve(size)
        self._n = size

    def pose_block(self) -> FloatArray:
        """(p, p), a copy."""
        p = self._p
        block = self._buffer[:p, :p].copy()
        return block if self._full else _mirrored(block)

    def dense(self) -> FloatArray:
        """P as an ordinary symmetric matrix (n, n), a copy."""
        P = self._buffer[: self._n, : self._n]
        return P.copy() if self._full else _mirrored(P)

    def diagonal_blocks(self, size: int) -> FloatArray:
        """The landmarks' own blocks, (L, size, size), a copy."""
        starts = np.arange(self._p, self._n, size)
        blocks = np.empty((starts.size, size, size))
        for i in range(size):
            for j in range(i + 1):
                blocks[:, i, j] = blocks[:, j, i] = self._buffer[starts + i, starts + j]
        return blocks

    def touch(self, numbers: IntArray, landmarks: FloatArray) -> IntArray:
        """States (c,) of the pose and of these landmarks (m,) of the map ``landmarks`` (L, size)."""
        n, p = self._n, self._p
        if len(self._landmark_states) * landmarks.shape[1] != n - p:
            self._landmark_states = np.arange(p, n).reshape(-1, landmarks.shape[1])
        return np.concatenate([self._pose_states, self._landmark_states[numbers].ravel()])

    def states(self, touched: IntArray) -> IntArray:
        """Places in P of the states that ``touch`` told."""
        return touched

    def columns(self, states: IntArray, size: int) -> FloatArray:
        """Columns of P, (n, c), for ``states`` (c,): the pose's, then those of whole landmarks."""
        n, p = self._n, self._p
        P = self._buffer
        if self._full:
            # Rows of a symmetric C-ordered matrix are its columns, and contiguous.
            return P[states].T
        columns = np.empty((n, states.size), order="F")
        columns[:, :p] = P[:n, :p]
        columns[:p, :p] = _mirrored(P[:p, :p])
        to = p
        for start in states[p::size].tolist():
            columns[:start, to : to + size] = P[start : start + size, :start].T
            columns[start:n, to : to + size] = P[start:n, start : start + size]
            for i in range(1, size):
                columns[start : start + i, to + i] = P[start + i, start : start + i]
            to += size
        return columns

    def propagate(self, A: FloatArray | None, Q: FloatArray | None) -> None:
        """Move the pose: P_xx = A P_xx A^T + Q, P_mx = P_mx A^T; None: A is the identity, Q zero."""
        n, p = self._n, self._p
        P = self._buffer
        if A is None:
            P_xx = self.pose_block()
        elif self._full:
            rows = A @ P[:p]
            P_xx = rows[:, :p] @ A.T
            P[:p] = rows
            P[:, :p] = rows.T
        else:
            P_xx = A @ self.pose_block() @ A.T
            P[p:n, :p] = P[p:n, :p] @ A.T
        if Q is not None:
            P_xx += Q
        P[:p, :p] = 0.5 * (P_xx + P_xx.T)

    def inflate(self, W_t: FloatArray) -> None:
        """``P += W W^T`` from W^T (k, n): noise that reaches every state."""
        n = self._n
        if self._full:
            np.matmul(W_t.T, W_t, out=self._scratch)
            self._buffer += self._scratch
            return
        self._add_product(1.0, W_t, n)

    def turn_landmarks(self, C: FloatArray) -> None:
        """Rotate every landmark's error by C (d, d): P_mm = D P_mm D^T, D block-diagonal of C."""
        n, p, d = self._n, self._p, C.shape[0]
        P = self.dense()
        P[p:] = (C @ P[p:].reshape(-1, d, n)).reshape(-1, n)
        P[:, p:] = (P[:, p:].reshape(n, -1, d) @ C.T).reshape(n, -1)
        if self._full:
            np.add(0.5 * P, 0.5 * P.T, out=self._buffer)
        else:
            self._buffer[:n, :n] = np.tril(P)

    def augment(self, G: FloatArray, N: FloatArray) -> None:
        """Add states s = G xi + noise of covariance N (a, a), uncorrelated with all else."""
        n, p = self._n, self._p
        # The pose's rows against all states: its own block, then the map's columns transposed.
        pose_rows = np.concatenate([self.pose_block(), self._buffer[p:n, :p].T], axis=1)
        rows = G @ pose_rows
        self.append(rows, rows[:, :p] @ G.T + N)

    def append(self, rows: FloatArray, corner: FloatArray) -> None:
        """Add states: ``rows`` (a, n) with the present ones, ``corner`` (a, a) among themselves."""
        n, a = self._n, rows.shape[0]
        self._reserve(n + a)
        P = self._buffer
        P[n : n + a, :n] = rows
        P[n : n + a, n : n + a] = 0.5 * (corner + corner.T)
        if self._full:
            P[:n, n : n + a] = rows.T
        self._n = n + a

    def remove(self, states: IntArray) -> None:
        """Marginalise ``states``: their rows and columns go, the others close ranks in their order."""
        n = self._n
        keep = np.delete(np.arange(n), states)
        # Transposed, the Fortran buffer is in the order that numpy copies fastest.
        kept = self._buffer.T[np.ix_(keep, keep)].T
        self._n = keep.size
        if keep.size <= self._full_limit:
            self._buffer = np.array(kept if self._full else _mirrored(kept), order="C")
            self._scratch = np.empty_like(self._buffer)
            self._full = True
            return
        P = self._buffer
        P[: keep.size, : keep.size] = kept
        P[keep.size : n, :n] = 0.0
        P[: keep.size, keep.size : n] = 0.0

    def overwrite(self, states: IntArray, rows: FloatArray, size: int) -> None:
        """Set the rows (c, n) of ``states`` (c,), and their columns: the pose's, then whole landmarks'."""
        n, p = self._n, self._p
        P = self._buffer
        if self._full:
            P[states] = rows
            P[:, states] = rows.T
            return
        P[:n, :p] = rows[:p].T
        for at, start in enumerate(states[p::size].tolist()):
            block = rows[p + at * size : p + (at + 1) * size]
            P[start : start + size, :start] = block[:, :start]
            P[start:n, start : start + size] = block[:, start:].T

    def downdate(self, W_t: FloatArray) -> None:
        """``P -= W W^T`` from W^T (k, n)."""
        n = self._n
        if self._full:
            # numpy turns a product with its own transpose into syrk and mirrors it: exactly symmetric.
            np.matmul(W_t.T, W_t, out=self._scratch)
            self._buffer -= self._scratch
            return
        self._add_product(-1.0, W_t, n)

    def shift(self, landmarks: FloatArray, dx: FloatArray) -> None:
        """Correct the means of the map (L, size) in place by dx (n,), the correction of the states."""
        p, size = self._p, landmarks.shape[1]
        landmarks[: (self._n - p) // size] += dx[p:].reshape(-1, size)

    def settle(self, _landmarks: FloatArray) -> None:
        """Nothing: no correction is ever postponed here."""

    def _add_product(self, sign: float, W_t: FloatArray, n: int) -> None:
        if self._buffer.shape[0] > n + max(64, n // 8):
            self._move(n)
        padded = np.zeros((W_t.shape[0], self._buffer.shape[0]), order="F")
        padded[:, :n] = W_t
        dsyrk(sign, padded, beta=1.0, c=self._buffer, trans=1, lower=1, overwrite_c=1)

    def _reserve(self, size: int) -> None:
        if size > self._buffer.shape[0]:
            self._move(size)

    def _move(self, size: int) -> None:
        """Into a buffer for ``size`` states and a few more."""
        n = self._n
        stays_full = size <= self._full_limit
        # Slack costs flops in every dsyrk, reallocation a copy: 1/64 keeps the first near 3 %.
        capacity = size if stays_full else size + max(16, size // 64)
        moved = np.zeros((capacity, capacity), order="C" if stays_full else "F")
        moved[:n, :n] = self._buffer[:n, :n]
        self._buffer, self._full = moved, stays_full
        self._scratch = np.empty_like(moved) if stays_full else np.empty((0, 0))


def block_diagonal(blocks: FloatArray) -> FloatArray:
    """(m, a, b) as one (m a, m b) matrix."""
    m, a, b = blocks.shape
    matrix = np.zeros(m * a * m * b)
    matrix[_diagonal_entries(m, a, b)] = blocks.ravel()
    return matrix.reshape(m * a, m * b)


def stacked(H_pose: FloatArray, H_land: FloatArray) -> FloatArray:
    """H (m d, p + m n) of the pose's (m, d, p) and the landmarks' (m, d, n) derivatives, block by block."""
    m, d, n = H_land.shape
    p = H_pose.shape[2]
    H = np.zeros(m * d * (p + m * n))
    H[_diagonal_entries(m, d, n, p)] = H_land.ravel()
    H = H.reshape(m * d, p + m * n)
    H[:, :p] = H_pose.reshape(m * d, p)
    return H


@lru_cache(maxsize=256)
def _diagonal_entries(m: int, a: int, b: int, left: int = 0) -> IntArray:
    """Flat positions of the blocks' entries, ``left`` columns from the border; a few shapes recur."""
    block, row, column = np.ogrid[:m, :a, :b]
    entries: IntArray = ((block * a + row) * (left + m * b) + left + block * b + column).ravel()
    return entries


def _mirrored(lower: FloatArray) -> FloatArray:
    """A symmetric matrix from its lower triangle."""
    triangle = np.tril(lower)
    symmetric: FloatArray = triangle + np.tril(lower, -1).T
    return symmetric
