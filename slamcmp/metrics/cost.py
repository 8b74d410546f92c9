"""What a run cost: how far it came, its time and its memory.

``update`` and ``estimate`` are timed apart: recovering a smoother's covariance can cost more than its update.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Run

_COST: dict[str, Any] = {"needs": frozenset(), "scope": "run", "lower_is_better": True}


@metrics.register("completion", unit="1", header="completion", **_COST | {"lower_is_better": False})
def completion(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Share of the log's frames that the run finished."""
    return run.completion


@metrics.register("update_s", unit="s", header="updates", **_COST)
def update_s(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Wall time of all updates together."""
    return float(run.update_s.sum())


@metrics.register("estimate_s", unit="s", header="estimates", **_COST)
def estimate_s(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Wall time of all causal estimates (pose and covariance) together."""
    return float(run.estimate_s.sum())


@metrics.register("final_solution_s", unit="s", header="final solution", **_COST)
def final_solution_s(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Wall time of the trajectory with hindsight, asked for once after the last frame."""
    return run.final_s if run.final is not None else math.nan


@metrics.register("update_median_ms", unit="ms", header="update, median", **_COST)
def update_median_ms(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Median wall time of one update."""
    return _quantile_ms(run.update_s, 0.5)


@metrics.register("update_p95_ms", unit="ms", header="update, 95 %", **_COST)
def update_p95_ms(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """95th percentile of the wall time of one update."""
    return _quantile_ms(run.update_s, 0.95)


@metrics.register("estimate_median_ms", unit="ms", header="estimate, median", **_COST)
def estimate_median_ms(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Median wall time of one causal estimate."""
    return _quantile_ms(run.estimate_s, 0.5)


@metrics.register("estimate_p95_ms", unit="ms", header="estimate, 95 %", **_COST)
def estimate_p95_ms(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """95th percentile of the wall time of one causal estimate."""
    return _quantile_ms(run.estimate_s, 0.95)


@metrics.register("peak_memory_mb", unit="MB", header="memory", **_COST)
def peak_memory_mb(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Growth of the process's peak resident memory over the run."""
    return run.peak_memory_mb


def _quantile_ms(seconds: FloatArray, share: float) -> float:
    return 1e3 * float(np.quantile(seconds, share)) if seconds.size else math.nan
