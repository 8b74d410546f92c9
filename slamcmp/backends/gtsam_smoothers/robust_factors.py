"""Robust kernels as GTSAM has them, how ``gnc`` narrows one, and which observations a solution believes.

GTSAM weighs a factor where it is linearised. In the incremental solvers that is where the estimate stood when
one of its variables had last moved by more than ``relinearize_threshold``, in all others the estimate itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import gtsam
from gtsam import noiseModel
from scipy.special import chdtri

from slamcmp.backends.fit import BELIEVED
from slamcmp.backends.robust import Kernel

_POSE = ord("x")
Wrap = Callable[[Any], Any]


def robust_noise(kernel: Kernel | None) -> Wrap:
    """What makes a Gaussian noise model robust."""
    if kernel is None:
        return lambda model: model
    kinds = {
        "huber": noiseModel.mEstimator.Huber,
        "cauchy": noiseModel.mEstimator.Cauchy,
        "tukey": noiseModel.mEstimator.Tukey,
        "geman_mcclure": noiseModel.mEstimator.GemanMcClure,
        "gnc": noiseModel.mEstimator.GemanMcClure,
        "dcs": noiseModel.mEstimator.DCS,
    }
    # GTSAM's Phi is compared with the squared residual.
    width = kernel.width**2 if kernel.name == "dcs" else kernel.width
    estimator = kinds[kernel.name](width)
    return lambda model: noiseModel.Robust(estimator, model)


def is_observation(factor: Any) -> bool:
    """Whether the factor ties a landmark to a pose."""
    keys = factor.keys()
    return len(keys) == 2 and sum(key >> 56 == _POSE for key in keys) == 1


class Narrowing:
    """Observations, Gaussian in the graph that holds them, under one of ``gnc``'s kernels after another.

    Args:
        kernel: the last one.
    """

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def stages(self, graph: Any, values: Any) -> list[Any]:
        """The graph under each kernel; ``values`` hold every variable of it, near the solution."""
        largest = max((2.0 * factor.error(values) for factor in _observations(graph)), default=0.0)
        return [self.under(graph, kernel) for kernel in self._kernel.stages(math.sqrt(largest))]

    @staticmethod
    def under(graph: Any, kernel: Kernel) -> Any:
        """The graph with its observations under the kernel, in the same places."""
        wrap, result = robust_noise(kernel), gtsam.NonlinearFactorGraph()
        for factor in (graph.at(row) for row in range(graph.size())):
            robust = is_observation(factor)
            result.add(factor.cloneWithNewNoiseModel(wrap(factor.noiseModel())) if robust else factor)
        return result


def replace_observations(
    stages: list[Any], places: list[int], update: Callable[[Any, list[int]], list[int]]
) -> None:
    """Put the observations of each graph into those of the one before it.

    Args:
        stages: graphs of the same factors in the same order, under one kernel after another.
        places: of the first one's factors, which the solver holds already.
        update: adds a graph, removes the factors at these places, and tells the places of the new ones.
    """
    rows = [row for row in range(stages[0].size()) if is_observation(stages[0].at(row))]
    places = [places[row] for row in rows]
    for stage in stages[1:]:
        some = gtsam.NonlinearFactorGraph()
        for row in rows:
            some.add(stage.at(row))
        places = update(some, places)


class Believed(NamedTuple):
    """What a robust solution is judged by."""

    chi2: float
    """Of all that is no outlier."""
    rows: int
    """Components of the outliers' residuals."""
    outliers: int
    total: int


def believed(graph: Any, values: Any, kernel: Kernel) -> Believed:
    """Which observations the solution ``values`` of a graph with the kernel believes."""
    chi2, rows, outliers, total = 0.0, 0, 0, 0
    limits: dict[int, float] = {}
    for factor in (graph.at(row) for row in range(graph.size())):
        if factor is None:
            continue
        cost = factor.error(values)
        if is_observation(factor):
            d = _components(factor)
            if d not in limits:
                limits[d] = float(kernel.rho(math.sqrt(chdtri(d, 1.0 - BELIEVED)))) * (1.0 - 1e-9)
            total += 1
            if cost >= limits[d]:
                outliers, rows = outliers + 1, rows + d
                continue
        chi2 += 2.0 * cost
    return Believed(chi2, rows, outliers, total)


def _components(factor: Any) -> int:
    """Of the residual: a relative position's factor has rows of zeros below it (factors.py)."""
    rows = int(factor.dim())
    return {9: 2, 16: 3}.get(rows, rows)


def _observations(graph: Any) -> Iterable[Any]:
    return (graph.at(row) for row in range(graph.size()) if is_observation(graph.at(row)))
