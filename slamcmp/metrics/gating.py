"""What a back end that gates its own copy of the stream kept, against what was spoilt on purpose.

The masks come from the run, the outliers from the truth: the gate itself never sees them. All observations of
the stream count, first sightings too, which no gate can test. Rows are NaN where the back end took all it was
given (its front end gated for it, or nobody), or where the truth does not mark outliers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Run

_GATE: dict[str, Any] = {
    "unit": "1",
    "needs": frozenset({"truth"}),
    "scope": "run",
    "lower_is_better": False,
}


@metrics.register("gate_recall", header="own gate: recall", **_GATE)
def gate_recall(run: Run, truth: GroundTruth) -> float:
    """Share of the correct observations that the back end's own gate kept; expected its probability."""
    counts = gate_counts(run, truth)
    return _share(counts["gate_correct"] - counts["gate_false_rejections"], counts["gate_correct"])


@metrics.register("gate_precision", header="own gate: precision", **_GATE)
def gate_precision(run: Run, truth: GroundTruth) -> float:
    """Share of correct observations among those that the back end's own gate kept."""
    counts = gate_counts(run, truth)
    kept = counts["gate_correct"] - counts["gate_false_rejections"]
    return _share(kept, kept + counts["gate_missed"])


def gate_counts(run: Run, truth: GroundTruth | None) -> dict[str, FloatArray]:
    """Series over the finished frames, each (K,); NaN where masks or outliers are not known.

    ``gate_correct``: observations that were not spoilt; ``gate_false_rejections``: those of them that the
    gate rejected; ``gate_missed``: spoilt observations that it kept.
    """
    names = ("gate_correct", "gate_false_rejections", "gate_missed")
    frames = run.online.t.size
    if run.kept_observations is None or truth is None or truth.outliers is None:
        return {name: np.full(frames, math.nan) for name in names}
    pairs = list(zip(run.kept_observations, truth.outliers, strict=False))
    counted = np.array(
        [((~bad).sum(), (~bad & ~kept).sum(), (bad & kept).sum()) for kept, bad in pairs], dtype=np.float64
    )
    return dict(zip(names, counted.reshape(frames, 3).T, strict=True))


def _share(part: FloatArray, whole: FloatArray) -> float:
    total = float(whole.sum())
    return float(part.sum()) / total if total > 0 else math.nan
