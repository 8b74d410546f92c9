"""Arrays that are checked once, made read-only, and then trusted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.types.arrays import FloatArray

TANGENT_DIM = {2: 3, 3: 6}
"""Dimension of the pose tangent for each dimension of space."""


def frozen(value: Any, name: str, shape: tuple[int | None, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """``value`` as a read-only array of the given shape (None: any length), copied unless it already is one.

    Raises:
        DataError: the shape differs; the message names the field and both shapes.
    """
    array: NDArray[Any] = np.asarray(value, dtype=dtype)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want is not None and want != have for want, have in zip(shape, array.shape, strict=True))
    ):
        wanted = tuple("any" if size is None else size for size in shape)
        raise DataError(f"{name}: shape {array.shape} where {wanted} is needed")
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


def assign(instance: object, **fields: Any) -> None:
    """Set fields of a frozen dataclass, once, while it is made."""
    for name, value in fields.items():
        object.__setattr__(instance, name, value)


def require_finite(array: NDArray[Any], name: str) -> None:
    """Raise DataError unless every entry is finite."""
    if not np.isfinite(array).all():
        raise DataError(f"{name}: has entries that are not finite")


def require_unique(ids: NDArray[Any], name: str) -> None:
    """Raise DataError if an id stands twice."""
    if ids.size > 1 and np.unique(ids).size != ids.size:
        values, counts = np.unique(ids, return_counts=True)
        raise DataError(f"{name}: id {values[counts > 1][0]} stands twice; each landmark has one")


def require_psd(covariances: FloatArray, name: str, *, definite: bool) -> None:
    """Check one covariance ``(d, d)`` or a batch of them for symmetry and sign."""
    if covariances.size == 0:
        return
    if covariances.ndim > 2 and (covariances == covariances[:1]).all():
        # A simulated sensor's are all one.
        covariances = covariances[0]
    if not np.allclose(covariances, np.swapaxes(covariances, -1, -2), rtol=1e-9, atol=1e-15):
        raise DataError(f"{name}: a covariance is not symmetric")
    # A direction known far better than another: there only correlations tell a sign from rounding.
    smallest = np.linalg.eigvalsh(covariances)[..., 0]
    scale = np.abs(covariances).max(axis=(-1, -2))
    bad = smallest <= 0 if definite else smallest < -1e-12 * scale
    if not np.any(bad):
        return
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    deviations = np.sqrt(np.where(variances > 0, variances, 1.0))
    least = np.linalg.eigvalsh(covariances / (deviations[..., :, None] * deviations[..., None, :]))[..., 0]
    bad &= least <= 0 if definite else least < -1e-12
    if np.any(bad):
        kind = "positive definite" if definite else "positive semi-definite"
        raise DataError(f"{name}: a covariance is not {kind} (smallest eigenvalue {smallest.min():.3g})")
