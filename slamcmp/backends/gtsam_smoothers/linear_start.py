"""A start for pose graphs by two linear least squares: first all rotations, then all positions.

An edge says R_j = R_i R_ij, which is linear in the entries of the rotations if one forgets that they are
rotations; each solution is then replaced by the nearest one (chordal relaxation). With rotations fixed, the
positions' cost p_j - p_i = R_i t_ij is linear. Both cost one sparse factorisation, where iSAM2 on a graph
with many closures costs one for each frame.

Martinec and Pajdla 2007, "Robust rotation and translation estimation in multiview reconstruction"; Carlone,
Tron, Daniilidis, Dellaert 2015, "Initialization techniques for 3D SLAM", sec. IV-A.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from slamcmp.types import FloatArray, Frame, IntArray


class Edges:
    """The motions between poses that frames tell: odometry and loop closures."""

    def __init__(self) -> None:
        self._pairs: list[tuple[int, int]] = []
        self._T: list[FloatArray] = []
        self._P: list[FloatArray] = []
        self.closures = 0

    def add(self, frame: Frame) -> None:
        """Those of one more frame."""
        if frame.k:
            self._append(frame.k - 1, frame.k, frame.T_prev_body, frame.Q)
        related = frame.relative_poses
        if related is not None:
            self.closures += related.frames.size
            for earlier, T, P in zip(related.frames.tolist(), related.T_earlier_body, related.P, strict=True):
                self._append(earlier, frame.k, T, P)

    def poses(self, T_first: FloatArray) -> FloatArray:
        """Every pose (K, n+1, n+1), the first at ``T_first`` (n+1, n+1)."""
        if not self._pairs:
            return T_first[None].copy()
        pairs, T, P = np.array(self._pairs), np.stack(self._T), np.stack(self._P)
        n = T_first.shape[0] - 1
        turn = slice(2, 3) if n == 2 else slice(0, 3)
        shift = slice(0, 2) if n == 2 else slice(3, 6)
        R = rotations(pairs, T[:, :n, :n], weights(P, turn), T_first[:n, :n])
        p = positions(pairs, R, T[:, :n, n], weights(P, shift), T_first[:n, n])
        found = np.tile(np.eye(n + 1), (len(R), 1, 1))
        found[:, :n, :n], found[:, :n, n] = R, p
        return found

    def _append(self, i: int, j: int, T: FloatArray, P: FloatArray) -> None:
        self._pairs.append((i, j))
        self._T.append(T)
        self._P.append(P)


def weights(P: FloatArray, states: slice) -> FloatArray:
    """(E,), one over the mean variance of these states; a chordal distance has no axes to tell apart."""
    mean = np.trace(P[:, states, states], axis1=1, axis2=2) / P[:, states, states].shape[1]
    return np.asarray(1.0 / mean, dtype=np.float64)


def rotations(pairs: IntArray, R_ij: FloatArray, w: FloatArray, R_first: FloatArray) -> FloatArray:
    """Rotations (K, n, n) that fit R_j = R_i R_ij on edges i, j (E, 2), weighted (E,), the first given."""
    n = R_first.shape[0]
    # One row of R after the other: row_j = row_i R_ij, the same matrix for every row.
    edge, axis = np.arange(len(pairs))[:, None], np.arange(n)
    rows = n * edge + axis
    root = np.sqrt(w)[:, None]
    of_j = coo_matrix(
        (np.broadcast_to(root, rows.shape).ravel(), (rows.ravel(), (n * pairs[:, 1:] + axis).ravel())),
        shape=(n * len(pairs), n * (int(pairs.max()) + 1)),
    )
    entries = (-root[:, :, None] * np.swapaxes(R_ij, 1, 2)).ravel()
    at = np.broadcast_to(rows[:, :, None], R_ij.shape).ravel()
    columns = np.broadcast_to((n * pairs[:, :1] + axis)[:, None, :], R_ij.shape).ravel()
    of_i = coo_matrix((entries, (at, columns)), shape=of_j.shape)
    rest = anchored_least_squares((of_j + of_i).tocsc(), np.zeros((of_j.shape[0], n)), R_first.T)
    # Each block of n unknowns is a row of R, stored as a column.
    blocks = np.swapaxes(rest.reshape(-1, n, n), 1, 2)
    U, _, Vt = np.linalg.svd(blocks)
    U[:, :, -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    nearest: FloatArray = U @ Vt
    nearest[0] = R_first
    return nearest


def positions(
    pairs: IntArray, R: FloatArray, t_ij: FloatArray, w: FloatArray, first: FloatArray
) -> FloatArray:
    """Positions (K, n) that fit p_j - p_i = R_i t_ij, with rotations (K, n, n) and weights (E,)."""
    root = np.sqrt(w)
    edge = np.arange(len(pairs))
    shape = (len(pairs), len(R))
    A = coo_matrix((root, (edge, pairs[:, 1])), shape=shape) - coo_matrix(
        (root, (edge, pairs[:, 0])), shape=shape
    )
    steps = np.einsum("eij,ej->ei", R[pairs[:, 0]], t_ij)
    return anchored_least_squares(A.tocsc(), root[:, None] * steps, first[None])


def anchored_least_squares(A: csc_matrix, b: FloatArray, first: FloatArray) -> FloatArray:
    """x (s, c) that minimises |A x - b|² with its first rows given, (f, c)."""
    held = len(first)
    free = A[:, held:]
    x = splu((free.T @ free).tocsc()).solve(free.T @ (b - A[:, :held] @ first))
    return np.concatenate([first, x])
