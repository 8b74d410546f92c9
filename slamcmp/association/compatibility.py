"""What is known about detections before anybody decides whose they are.

A detection i and a landmark j have an innovation and its covariance. Those of several pairs are correlated:
one pose predicts all landmarks, and what is detected may itself be a track of several sightings.

========  =====================================================================
symbol    meaning (Neira and Tardós 2001, eq. 4 to 10)
========  =====================================================================
y         innovation of detection i with landmark j, (m, L, d)
C         covariance of the L predictions, (L, L, d, d)
R         covariance of the m detections, (m, m, d, d)
X         of detections with predictions, (m, L, d, d)
S         of the innovation of one pair: C_jj + R_ii - X_ij - X_ij^T, (m, L, d, d)
========  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from slamcmp.errors import DivergedError
from slamcmp.types import BoolArray, FloatArray, IntArray

NOBODY = -1
"""In place of a landmark's row: the detection is of none of them."""


@dataclass(frozen=True)
class Innovations:
    """Of every detection with every landmark.

    Raises:
        DivergedError: a covariance is singular, from the squared distances on.
    """

    y: FloatArray
    """(m, L, d)."""
    C: FloatArray
    """(L, L, d, d)."""
    R: FloatArray
    """(m, m, d, d)."""
    X: FloatArray | None = None
    """(m, L, d, d); None: detections know nothing of the predictions."""

    @property
    def dim(self) -> int:
        """d, degrees of freedom of one pair."""
        return int(self.y.shape[2])

    def covariance(self, pair: tuple[int, int], other: tuple[int, int]) -> FloatArray:
        """Of the innovations of two pairs (detection, landmark), (d, d)."""
        (i, j), (other_i, other_j) = pair, other
        S: FloatArray = self.C[j, other_j] + self.R[i, other_i]
        return S if self.X is None else S - self.X[i, other_j] - self.X[other_i, j].T

    @cached_property
    def S(self) -> FloatArray:
        """Covariance of each pair alone, (m, L, d, d)."""
        landmarks, detections = np.arange(len(self.C)), np.arange(len(self.R))
        S: FloatArray = self.C[landmarks, landmarks] + self.R[detections, detections][:, None]
        return S if self.X is None else S - self.X - np.swapaxes(self.X, -1, -2)

    @cached_property
    def squared_distances(self) -> FloatArray:
        """Squared Mahalanobis distance of each pair alone, (m, L)."""
        try:
            weighted = np.linalg.solve(self.S, self.y[..., None])[..., 0]
        except np.linalg.LinAlgError as error:
            raise DivergedError("association met a singular innovation covariance") from error
        return np.asarray((self.y * weighted).sum(axis=-1))

    @cached_property
    def log_determinants(self) -> FloatArray:
        """log |S| of each pair, (m, L)."""
        return np.asarray(np.linalg.slogdet(self.S)[1])

    def compatible(self, probability: float) -> BoolArray:
        """Which pairs pass the gate that holds this share of right ones, (m, L)."""
        return np.asarray(self.squared_distances <= gate(self.dim, probability))


class JointDistance:
    """Squared Mahalanobis distance of several pairs together, grown and shrunk pair by pair.

    With L the Cholesky factor of the joint covariance so far and w = L^-1 y, a further pair adds the block
    row [A, D] to the factor, v = D^-1 (y_new - A w) to w, |v|^2 to the distance, 2 log |D| to log |S|.
    """

    def __init__(self, innovations: Innovations) -> None:
        self._innovations = innovations
        room = innovations.y.shape[0] * innovations.dim
        self._L, self._w = np.zeros((room, room)), np.zeros(room)
        self.pairs: list[tuple[int, int]] = []
        self.distances = [0.0]
        """With no pair, one, two, …"""
        self.log_determinants = [0.0]

    def push(self, pair: tuple[int, int]) -> None:
        """Add a pair.

        Raises:
            DivergedError: the joint covariance is not positive definite.
        """
        d = self._innovations.dim
        done = len(self.pairs) * d
        own = slice(done, done + d)
        y = self._innovations.y[pair]
        inner = self._innovations.covariance(pair, pair)
        if done:
            across = np.hstack([self._innovations.covariance(pair, known) for known in self.pairs])
            A = np.linalg.solve(self._L[:done, :done], across.T).T
            self._L[own, :done] = A
            y = y - A @ self._w[:done]
            inner = inner - A @ A.T
        try:
            D = np.linalg.cholesky(inner)
        except np.linalg.LinAlgError as error:
            raise DivergedError("association met a singular innovation covariance") from error
        self._L[own, own] = D
        v = self._w[own] = np.linalg.solve(D, y)
        self.pairs.append(pair)
        self.distances.append(self.distances[-1] + float(v @ v))
        self.log_determinants.append(self.log_determinants[-1] + 2.0 * float(np.log(np.diagonal(D)).sum()))

    def pop(self) -> None:
        """Take the last pair away."""
        for each in (self.pairs, self.distances, self.log_determinants):
            each.pop()


def gate(dof: int, probability: float) -> float:
    """The chi-square quantile that holds this share, with ``dof`` degrees of freedom."""
    return float(chdtri(dof, 1.0 - probability))


def uncorrelated(blocks: FloatArray) -> FloatArray:
    """Covariances (m, d, d) of what is independent, as (m, m, d, d)."""
    m, d, _ = blocks.shape
    full = np.zeros((m, m, d, d))
    full[np.arange(m), np.arange(m)] = blocks
    return full


def as_rows(pairs: list[tuple[int, int]], detections: int) -> IntArray:
    """The landmark's row of each detection, (m,), or NOBODY."""
    given = np.full(detections, NOBODY, dtype=np.int64)
    for row, column in pairs:
        given[row] = column
    return given
