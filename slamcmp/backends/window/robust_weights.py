"""The weights of a window's observations under a kernel, and what left the window with them.

The window's cost keeps its observations as they are; wherever their noise counts, it is R / w. A pose that
leaves takes its observations with the weights that they had then, as it takes their Jacobians.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from slamcmp.backends.fit import BELIEVED
from slamcmp.backends.robust import NOTHING, Kernel
from slamcmp.types import BoolArray, FloatArray


class RobustWeights:
    """Weights (M,) of the observations, in their order.

    Args:
        kernel: of all but the newest pose's, whose kernel ``reweigh`` is told.
        d: components of an observation.
    """

    def __init__(self, kernel: Kernel, d: int) -> None:
        self.kernel = kernel
        self.weights = np.ones(0)
        self.outliers_left, self.left = 0, 0
        """Of the observations that have left the window, how many were outliers, and of all."""
        self.chi2_left = 0.0
        """What those outliers have added to chi-square."""
        self._d = d
        self._far = math.sqrt(chdtri(d, 1.0 - BELIEVED))
        self._newest, self._newest_kernel = np.zeros(0, dtype=bool), kernel

    def append(self, m: int) -> None:
        """Observations that have no weight yet."""
        self.weights = np.concatenate([self.weights, np.ones(m)])

    def reweigh(self, r: FloatArray, newest: BoolArray, kernel: Kernel) -> None:
        """Weights of residuals of these lengths (M,), those marked under ``kernel``."""
        self._newest, self._newest_kernel = newest, kernel
        w = np.where(newest, kernel.weight(r), self.kernel.weight(r))
        self.weights = np.maximum(w, NOTHING)

    def price(self, r: FloatArray) -> FloatArray:
        """What observations with residuals of these lengths (M,) cost, in squares: 2 rho."""
        cost: FloatArray = 2.0 * np.where(self._newest, self._newest_kernel.rho(r), self.kernel.rho(r))
        return cost

    def leave(self, m: int, r: FloatArray) -> None:
        """The first m observations leave, with residuals of these lengths (M,)."""
        far = r[:m] > self._far
        self.left, self.outliers_left = self.left + m, self.outliers_left + int(far.sum())
        self.chi2_left += float((self.weights[:m] * r[:m] ** 2)[far].sum())
        self.keep(np.arange(self.weights.size) >= m)

    def keep(self, rows: BoolArray) -> None:
        """The observations that are not marked (M,) are gone."""
        self.weights = self.weights[rows]
        self._newest = self._newest[rows] if self._newest.size == rows.size else np.zeros(0, dtype=bool)

    def of_outliers(self, r: FloatArray) -> tuple[float, int, int]:
        """What all outliers so far add to chi-square, their number, and that of all observations.

        Args:
            r: lengths (M,) of the residuals in the window.
        """
        far = r > self._far
        chi2 = self.chi2_left + float(self.price(r)[far].sum())
        return chi2, self.outliers_left + int(far.sum()), self.left + r.size
