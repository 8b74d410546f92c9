"""Whether a least-squares solution can be right: one rule for every back end that tells its chi-square.

Chi-square over its degrees of freedom is about 1 where the covariances describe the noise. A ratio far above
is a wrong basin, or noise that they do not describe; either way its covariances mean nothing. With few
degrees of freedom chance alone goes far, and is granted what it reaches once in a million runs.
"""

from __future__ import annotations

import math

from scipy.special import chdtri

from slamcmp.errors import DivergedError

MAX_CHI2_PER_DOF = 3.0
"""What a back end allows unless told otherwise: outside chance for any dof over 24."""
BELIEVED = 0.9999
"""Probability of a right observation to lie as near to a robust solution as one that it believes."""
MOST_OUTLIERS = 0.5
"""Largest share of observations that one may disbelieve; from more no kernel can tell who is right."""
CHANCE = 1e-6
"""Probability with which a right solution may be refused, where it has few degrees of freedom."""


def largest_chi2_per_dof(dof: float, limit: float) -> float:
    """What is still allowed: the ``limit``, or with few degrees of freedom what chance reaches."""
    return max(limit, float(chdtri(dof, CHANCE)) / dof)


def require_fit(chi2: float, dof: float, limit: float, what: str, remedy: str) -> None:
    """Refuse a solution that fits its measurements too badly; without degrees of freedom every one fits.

    Args:
        chi2, dof: of the whole cost at the solution.
        limit: ``max_chi2_per_dof`` of the back end.
        what: the back end, and how it came there, for the message.
        remedy: against a wrong basin.

    Raises:
        DivergedError: chi-square is not finite, or too large.
    """
    if not math.isfinite(chi2):
        raise DivergedError(f"{what}: χ² is not finite")
    if dof <= 0 or chi2 / dof <= largest_chi2_per_dof(dof, limit):
        return
    bound = largest_chi2_per_dof(dof, limit)
    allowed = f"max_chi2_per_dof {limit:g}"
    if bound > limit:
        allowed += f" and what chance reaches with {dof:.0f} degrees of freedom, {bound:.3g}"
    raise DivergedError(
        f"{what}: χ²/dof is {chi2 / dof:.4g}, above {allowed}: a wrong basin ({remedy}), or noise that the "
        "covariances do not describe (outliers, wrong associations)"
    )


def require_majority(outliers: int, total: int, what: str) -> None:
    """Refuse a robust solution that disbelieves most of what was observed.

    Args:
        outliers: observations that are not within ``BELIEVED`` of it.
        total: all observations.
        what: the back end, for the message.

    Raises:
        DivergedError: they are most.
    """
    if outliers > MOST_OUTLIERS * total:
        raise DivergedError(
            f"{what}: {outliers} of {total} observations are outliers to the solution: a wrong basin, or "
            "more outliers than a kernel can bear"
        )
