"""From information to covariance and back, whatever the units."""

from __future__ import annotations

import numpy as np

from slamcmp.types import FloatArray

_SINGULAR = 1e-15
"""Smallest eigenvalue beside the largest: below it an inverse would hold rounding only."""


def inverse_of_definite(matrix: FloatArray) -> FloatArray | None:
    """The inverse (d, d) of a symmetric matrix, or None where that is not positive definite.

    Whether it is, its correlations tell: an information of 1e18 beside one of 100 is a direction that is
    known well and one that is not, no fault.
    """
    diagonal = np.diagonal(matrix)
    if not (diagonal > 0).all():
        return None
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] > _SINGULAR * abs(eigenvalues[-1]):
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    # Powers of two, so that scaling rounds nothing.
    scale: FloatArray = 2.0 ** -np.round(0.5 * np.log2(diagonal))
    scaled = matrix * scale[:, None] * scale[None, :]
    eigenvalues = np.linalg.eigvalsh(scaled)
    if not eigenvalues[0] > _SINGULAR * abs(eigenvalues[-1]):
        return None
    inverse: FloatArray = np.linalg.inv(scaled) * scale[:, None] * scale[None, :]
    return inverse
