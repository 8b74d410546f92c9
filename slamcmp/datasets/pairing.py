"""Which recording of one sensor belongs to which of another: the nearest in time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def nearest_in_time(t: NDArray[Any], others: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Indices (K,) of the nearest of ``others`` (N ≥ 1, any order) to each of t (K,), and the distances (K,).

    Both are in one unit, whole numbers or not; of two equally near ones the earlier is taken.
    """
    order = np.argsort(others, kind="stable")
    later = np.clip(np.searchsorted(others[order], t), 1, max(order.size - 1, 1))
    candidates = order[np.minimum([later - 1, later], order.size - 1)]
    off = np.abs(others[candidates] - t)
    best = np.argmin(off, axis=0)
    return candidates[best, np.arange(t.size)], off.min(axis=0)
