"""Robust kernels: what an observation's whitened residual costs, in filters, windows and GTSAM alike.

An estimator minimises prior and odometry, both quadratic, plus the sum of ``rho(r)`` over the observations,
where r is the length of an observation's residual in units of its own noise. A kernel is that rho; where it
stands still, so does least squares with every observation's noise R replaced by R / w, w = rho'(r) / r
(iteratively reweighted least squares; Zhang 1997, "Parameter estimation techniques", sec. 9.4).

==================  ==========================================  =======================
kernel              rho(r), c its width                         weight w(r)
==================  ==========================================  =======================
``huber``           r²/2, beyond c: c r - c²/2                  1, beyond c: c / r
``cauchy``          c²/2 log(1 + r²/c²)                         1 / (1 + r²/c²)
``tukey``           c²/6 (1 - (1 - r²/c²)³), beyond c: c²/6     (1 - r²/c²)², beyond c: 0
``geman_mcclure``   r²/2 / (1 + r²/c²)                          1 / (1 + r²/c²)²
``dcs``             r²/2, beyond c: c² (3/2 - s)                s², s = min(1, 2c² / (c² + r²))
``gnc``             that of ``geman_mcclure``                   the same
==================  ==========================================  =======================

All but Huber's have more than one minimum, and which one is found depends on the start. ``gnc`` (graduated
non-convexity; Yang, Antonante, Tzoumas, Carlone 2020) begins with a width at which no residual is past the
inflection, which is almost least squares, and narrows it step by step. The others are started from Huber's
solution where a filter or a window solves a frame, and by GTSAM where its estimate stands.

Dynamic covariance scaling (Agarwal et al. 2013) has c² for its Phi, as GTSAM's has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.types import FloatArray

RobustKernel = Literal["none", "huber", "cauchy", "tukey", "geman_mcclure", "dcs", "gnc"]
"""What the norm of an observation's whitened residual goes through; odometry and prior stay quadratic."""

WIDTHS = {
    "huber": 1.345,
    "cauchy": 2.3849,
    "tukey": 4.6851,
    "geman_mcclure": 3.7874,
    "dcs": 1.8983,
    "gnc": 3.7874,
}
"""Widths with 95 % efficiency on Gaussian data (Zhang 1997, table 1; the last three by the same integral)."""

NARROWING = 4.0
"""By which ``gnc`` divides its surrogate's squared width from one stage to the next."""
NOTHING = 1e-9
"""Smallest weight: R / w stays finite, and an observation of this weight moves nothing."""
DOUBTED = 0.5
"""An observation of less weight counts as down-weighted."""


@dataclass(frozen=True)
class Kernel:
    """A kernel with its width."""

    name: str
    width: float
    """In standard deviations."""

    def rho(self, r: FloatArray | float) -> FloatArray:
        """The cost of whitened residuals of length r; r²/2 near 0."""
        r, c = np.asarray(r, dtype=np.float64), self.width
        squared, u = r**2, (r / c) ** 2
        if self.name == "huber":
            cost = np.where(r <= c, 0.5 * squared, c * r - 0.5 * c**2)
        elif self.name == "cauchy":
            cost = 0.5 * c**2 * np.log1p(u)
        elif self.name == "tukey":
            u = np.minimum(u, 1.0)
            cost = 0.5 * c**2 * u * (1.0 - u + u**2 / 3.0)
        elif self.name == "dcs":
            s = np.minimum(1.0, 2.0 / (1.0 + u))
            cost = np.where(r <= c, 0.5 * squared, c**2 * (1.5 - s))
        else:
            cost = 0.5 * squared / (1.0 + u)
        return np.asarray(cost, dtype=np.float64)

    def weight(self, r: FloatArray | float) -> FloatArray:
        """rho'(r) / r: 1 for a residual that counts in full."""
        r = np.asarray(r, dtype=np.float64)
        u = (r / self.width) ** 2
        if self.name == "huber":
            weight = self.width / np.maximum(r, self.width)
        elif self.name == "cauchy":
            weight = 1.0 / (1.0 + u)
        elif self.name == "tukey":
            weight = np.maximum(1.0 - u, 0.0) ** 2
        elif self.name == "dcs":
            weight = np.minimum(1.0, 2.0 / (1.0 + u)) ** 2
        else:
            weight = 1.0 / (1.0 + u) ** 2
        return np.asarray(weight, dtype=np.float64)

    def stages(self, largest: float) -> list[Kernel]:
        """The kernels through which a least-squares solution comes to this one's minimum; it is the last.

        Args:
            largest: residual of that solution, whitened.
        """
        if self.name == "gnc":
            return self._narrowing(largest)
        if self.name == "huber" or largest <= self.width:
            return [self]
        return [Kernel("huber", WIDTHS["huber"]), self]

    def _narrowing(self, largest: float) -> list[Kernel]:
        """Geman-McClure's kernels of squared widths mu c², from where it is convex for all residuals down.

        rho'' is positive for r² < mu c² / 3 (Yang et al., remark 5, begin a little lower, at 2 r² = mu c²).
        """
        mu = 3.0 * (largest / self.width) ** 2
        stages = []
        while mu > 1.0:
            stages.append(replace(self, width=self.width * math.sqrt(mu)))
            mu /= NARROWING
        return [*stages, self]


def robust_kernel(name: RobustKernel, width: float | None) -> Kernel | None:
    """The kernel of a back end's ``robust`` and ``robust_width``; None for ``none``.

    Raises:
        UsageError: a width without a kernel.
    """
    if name == "none":
        if width is not None:
            raise UsageError("robust_width has no meaning without a kernel: set robust, or drop robust_width")
        return None
    return Kernel(name, WIDTHS[name] if width is None else width)
