"""Rigid and similarity transforms that carry an estimated trajectory onto the true one, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.errors import DataError
from slamcmp.geometry import inverse, pose, transform
from slamcmp.types import FloatArray


@dataclass(frozen=True)
class Alignment:
    """``p_true ≈ scale R p_estimated + t``."""

    T_true_estimated: FloatArray
    """(n+1, n+1)."""
    scale: float = 1.0

    def points(self, p_estimated: FloatArray) -> FloatArray:
        """Points (..., n) of the estimate's world moved into the truth's."""
        return transform(self.T_true_estimated, self.scale * p_estimated)


def align_points(p_estimated: FloatArray, p_true: FloatArray, *, with_scale: bool = False) -> Alignment:
    """The least-squares transform between paired points (K, n), n = 2 or 3 (Umeyama 1991, eq. 34-43).

    Raises:
        DataError: the points do not determine the rotation (all at one place, or for n = 3 on one line).
    """
    n = p_true.shape[-1]
    mean_estimated, mean_true = p_estimated.mean(axis=0), p_true.mean(axis=0)
    centred_estimated, centred_true = p_estimated - mean_estimated, p_true - mean_true
    covariance = centred_true.T @ centred_estimated / len(p_true)
    U, singular_values, Vt = np.linalg.svd(covariance)
    if np.linalg.matrix_rank(covariance) < n - 1:
        raise DataError("alignment: the positions lie on one point or line and leave the rotation open")
    signs = np.ones(n)
    # Without this the best orthogonal matrix may be a reflection (eq. 39).
    signs[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = (U * signs) @ Vt
    scale = 1.0
    if with_scale:
        scale = float(singular_values @ signs / (centred_estimated**2).sum(axis=1).mean())
    return Alignment(pose(R, mean_true - scale * (R @ mean_estimated)), scale)


def align_first_pose(T_estimated: FloatArray, T_true: FloatArray) -> Alignment:
    """The rigid transform that makes the first of the poses (K, n+1, n+1) coincide."""
    return Alignment(T_true[0] @ inverse(T_estimated[0]))
