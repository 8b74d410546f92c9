"""How many seeds a difference between two back ends needs, from the seeds that a pilot has run.

What is planned is the test that the report's paired comparison shows: Student's paired t on the logarithm of
the ratio, seed by seed (:func:`slamcmp.metrics.statistics.ratio_test`).

========  ==================================================================
symbol    meaning (Cohen 1988, ch. 2; Bar-Shalom, Li and Kirubarajan 2001, sec. 1.5)
========  ==================================================================
delta     logarithm of the ratio that shall be seen
s_d       standard deviation of the paired log ratios
s_a, s_b  standard deviations of the two back ends' logarithms over the seeds
n         seeds: ((z_alpha + z_power) s_d / delta)² + z_alpha² / 2 for pairs,
          (z_alpha + z_power)² (s_a² + s_b²) / delta² + z_alpha² / 4 a back
          end without pairs; the last terms stand for Student's t (Guenther 1981)
========  ==================================================================

The simulation draws seeds from the pilot with replacement, moves their mean log ratio to delta and counts
how often Student's (paired) or Welch's (unpaired) test sees it: it keeps the pilot's skewness and outliers,
but cannot know worse runs than the pilot had.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import chdtri, ndtri, stdtrit

from slamcmp.errors import DataError, UsageError
from slamcmp.metrics.statistics import FEWEST_RATIOS
from slamcmp.registry import did_you_mean
from slamcmp.results.grid import at_point, grid_points, labels
from slamcmp.results.store import Results
from slamcmp.types import FloatArray

FEWEST_PAIRS = 5
"""A pilot below that does not know its own spread to a factor of three."""
SIMULATIONS = 2000
MOST_SIMULATED = 2000
"""Above it the normal approximation stands alone: resampling is slow there, and the normal limit good."""
MOST_SPREAD = 1e4
"""Of the log ratios in units of what shall be seen: it would need 10^9 seeds."""
PILOT_SHARE = 0.8
"""Of the two-sided interval for the number of seeds that the pilot's own uncertainty leaves."""


@dataclass(frozen=True)
class SeedPlan:
    """What a pilot says about the seeds that one comparison needs."""

    point: dict[str, Any]
    """Swept values."""
    back_end: str
    compared_with: str
    pairs: int
    """Seeds of the pilot that both finished."""
    lost: int
    """Seeds of the pilot that one of them did not finish."""
    ratio: float
    """In the pilot: geometric mean of the back end over the other."""
    difference: float
    """That shall be seen, in the metric's unit, from the other's geometric mean."""
    goal: float
    """The same as a ratio, above 1."""
    correlation: float
    """Between the two back ends' logarithms over the seeds."""
    paired: int
    """Seeds needed, normal approximation; the report tells a test from five on."""
    paired_low: int
    paired_high: int
    """Between these with 80 % probability, because the pilot knows its spread only so well."""
    paired_simulated: int
    unpaired: int
    """Seeds needed for each back end if the two ran on different seeds."""
    unpaired_simulated: int


def plan_seeds(
    results: Results,
    metric: str,
    difference: float,
    *,
    relative: bool = False,
    power: float = 0.8,
    alpha: float = 0.05,
    seed: int = 0,
) -> list[SeedPlan]:
    """For each grid point and back end the seeds needed to tell it from the first one.

    Args:
        results: a pilot.
        metric: column of its trials table.
        difference: to be seen, in the metric's unit.
        relative: ``difference`` is a share of the first back end's geometric mean instead.
        power: probability of seeing it.
        alpha: probability of seeing one where there is none, two-sided.
        seed: of the simulation.

    Raises:
        UsageError: no such metric, values of it that are not above 0 and so have no ratio, or the
            difference is not above 0.
        DataError: no comparison has enough pairs.
    """
    if not 0.0 < difference < math.inf:
        raise UsageError(f"the difference to be seen is {difference:g}: a number above 0 is needed")
    trials = results.trials
    if metric not in trials.columns or not pd.api.types.is_float_dtype(trials[metric]):
        numeric = [str(name) for name in trials.columns if pd.api.types.is_float_dtype(trials[name])]
        raise UsageError(f"the pilot has no metric {metric!r}{did_you_mean(metric, numeric)}")
    plans: list[SeedPlan] = []
    most = 0
    for point in grid_points(trials):
        rows = at_point(trials, point)
        finished = rows[(rows["status"] == "ok") & rows[metric].notna()]
        table = finished.pivot(index="trial", columns="label", values=metric)
        known = [label for label in labels(results) if label in table.columns]
        for label in known[1:]:
            pairs = table[[known[0], label]].dropna()
            most = max(most, len(pairs))
            if len(pairs) < FEWEST_PAIRS:
                continue
            _require_positive(pairs, metric)
            first, other = (np.log(pairs[name].to_numpy(dtype=float)) for name in (known[0], label))
            usual = math.exp(float(first.mean()))
            share = difference if relative else difference / usual
            spread, shift = float((other - first).std(ddof=1)), math.log1p(share)
            if not spread <= MOST_SPREAD * shift:
                raise UsageError(
                    f"a difference of {difference:g} cannot be seen: the ratio of {label!r} to {known[0]!r} "
                    f"varies by a factor of {math.exp(spread):.3g} from seed to seed"
                )
            low, high = _pilot_range(spread, len(pairs), shift, power, alpha)
            plans.append(
                SeedPlan(
                    point,
                    label,
                    known[0],
                    len(pairs),
                    rows["trial"].nunique() - len(pairs),
                    math.exp(float((other - first).mean())),
                    share * usual,
                    1.0 + share,
                    _correlation(first, other),
                    max(FEWEST_RATIOS, paired_seeds(spread, shift, power, alpha)),
                    max(FEWEST_RATIOS, low),
                    max(FEWEST_RATIOS, high),
                    max(FEWEST_RATIOS, simulated_paired_seeds(other - first, shift, power, alpha, seed=seed)),
                    unpaired_seeds(float(first.std(ddof=1)), float(other.std(ddof=1)), shift, power, alpha),
                    simulated_unpaired_seeds(first, other, shift, power, alpha, seed=seed),
                )
            )
    if not plans:
        raise DataError(
            f"{results.folder}: no two back ends share {FEWEST_PAIRS} finished seeds with {metric!r} "
            f"(at most {most}); a pilot of 10 or more seeds and two back ends is needed"
        )
    return plans


def paired_seeds(spread: float, difference: float, power: float = 0.8, alpha: float = 0.05) -> int:
    """Seeds for a paired comparison; ``spread`` is the standard deviation of the differences."""
    z_alpha, z_power = float(ndtri(1.0 - alpha / 2.0)), float(ndtri(power))
    return _at_least_two(((z_alpha + z_power) * spread / difference) ** 2 + z_alpha**2 / 2.0)


def unpaired_seeds(
    spread_a: float, spread_b: float, difference: float, power: float = 0.8, alpha: float = 0.05
) -> int:
    """Seeds for each of two back ends that do not share them."""
    z_alpha, z_power = float(ndtri(1.0 - alpha / 2.0)), float(ndtri(power))
    variance = spread_a**2 + spread_b**2
    return _at_least_two((z_alpha + z_power) ** 2 * variance / difference**2 + z_alpha**2 / 4.0)


def simulated_paired_seeds(
    differences: ArrayLike, difference: float, power: float = 0.8, alpha: float = 0.05, *, seed: int = 0
) -> int:
    """Fewest seeds at which the paired t test sees ``difference`` often enough on resampled pairs."""
    given = np.asarray(differences, dtype=float)
    centred = given - given.mean() + difference

    def seen(count: int) -> float:
        rng = np.random.default_rng([seed, count])
        drawn = centred[rng.integers(given.size, size=(SIMULATIONS, count))]
        return _share_seen(drawn.mean(axis=1), drawn.var(axis=1, ddof=1) / count, count - 1.0, alpha)

    return _fewest(seen, power, paired_seeds(float(given.std(ddof=1)), difference, power, alpha))


def simulated_unpaired_seeds(
    first: ArrayLike,
    other: ArrayLike,
    difference: float,
    power: float = 0.8,
    alpha: float = 0.05,
    *,
    seed: int = 0,
) -> int:
    """Fewest seeds a back end at which Welch's t test sees ``difference`` often enough without pairs."""
    a, b = (np.asarray(values, dtype=float) for values in (first, other))
    a, b = a - a.mean(), b - b.mean() + difference

    def seen(count: int) -> float:
        rng = np.random.default_rng([seed, count])
        x, y = (each[rng.integers(each.size, size=(SIMULATIONS, count))] for each in (a, b))
        var_x, var_y = x.var(axis=1, ddof=1) / count, y.var(axis=1, ddof=1) / count
        with np.errstate(divide="ignore", invalid="ignore"):
            dof = (var_x + var_y) ** 2 * (count - 1.0) / (var_x**2 + var_y**2)
        dof = np.where(np.isfinite(dof), dof, count - 1.0)
        return _share_seen(y.mean(axis=1) - x.mean(axis=1), var_x + var_y, dof, alpha)

    start = unpaired_seeds(float(a.std(ddof=1)), float(b.std(ddof=1)), difference, power, alpha)
    return _fewest(seen, power, start)


def _share_seen(means: FloatArray, variances: FloatArray, dof: Any, alpha: float) -> float:
    return float(np.mean(np.abs(means) > stdtrit(dof, 1.0 - alpha / 2.0) * np.sqrt(variances)))


def _fewest(seen: Callable[[int], float], power: float, start: int) -> int:
    """The smallest count with enough power, by bisection from the approximation."""
    if start > MOST_SIMULATED:
        return start
    high = max(2, start)
    while seen(high) < power:
        high = high + max(1, high // 2)
    low = 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if seen(middle) >= power else (middle, high)
    return high


def _pilot_range(spread: float, pairs: int, difference: float, power: float, alpha: float) -> tuple[int, int]:
    """Seeds for the lowest and highest spread that the pilot leaves possible (normal differences)."""
    tail, dof = (1.0 - PILOT_SHARE) / 2.0, pairs - 1
    lowest, highest = (spread * math.sqrt(dof / float(chdtri(dof, p))) for p in (tail, 1.0 - tail))
    return paired_seeds(lowest, difference, power, alpha), paired_seeds(highest, difference, power, alpha)


def _require_positive(pairs: pd.DataFrame, metric: str) -> None:
    without = int((pairs <= 0.0).any(axis=1).sum())
    if without:
        raise UsageError(
            f"{metric!r} is not above 0 in {without} of {len(pairs)} seeds: back ends are compared by ratios"
        )


def _correlation(first: FloatArray, other: FloatArray) -> float:
    if not first.std() or not other.std():
        return math.nan
    return float(np.corrcoef(first, other)[0, 1])


def _at_least_two(seeds: float) -> int:
    return max(2, math.ceil(seeds - 1e-9))
