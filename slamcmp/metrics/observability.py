"""Whether an estimator keeps unobservable what its sensors cannot see, and how far its Jacobians drift.

Nothing a robot measures tells where in the world its map lies: three directions of planar SLAM (six in space)
cost nothing (Chen, Jiang and Hu 1990; Huang, Mourikis and Roumeliotis 2010, eq. 22). An estimator that takes
the Jacobians of its measurements at points that do not fit each other believes otherwise. What it believes is
the information about the current pose that its own linear system would hold had it known nothing at the
start: zero for a correct estimator. The standard planar EKF's has rank one: it would know its heading.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slamcmp.metrics.matching import rotation_part, translation_part
from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Run

RELATIVE_TOLERANCE = 1e-7
"""Singular values of the root below this share of the Jacobians' size count as zero. Rounding leaves 1e-15,
sigma points 1e-9; information that moves an estimate begins at 1e-4."""

NULLITY, TURN, SHIFT = "nullity", "spurious_turn_per_rad2", "spurious_shift_per_m2"
DRIFTS = ("drift_position_m", "drift_heading_deg", "drift_landmarks_m")
"""Per-frame series of a run: nullity and information, and the drift of the linearisation points."""

_RECORDED: dict[str, Any] = {"needs": frozenset({"diagnostics"}), "scope": "run"}


def nullity(root: FloatArray, scale: FloatArray, relative_tolerance: float = RELATIVE_TOLERANCE) -> int:
    """How many directions of the pose cost nothing.

    Args:
        root: square root (p, p) of the information on the pose without a start.
        scale: (p,), root-sum-square of the whitened Jacobians by the pose; 0 where there are none.
        relative_tolerance: of the root in units of the scale.
    """
    values = np.linalg.svd(root / np.where(scale > 0.0, scale, 1.0), compute_uv=False)
    return int(np.count_nonzero(values < relative_tolerance))


def unanchored_information(root: FloatArray) -> tuple[float, float]:
    """What a root (p, p) in the body tangent says about the pose: about turns [1/rad²] and shifts [1/m²].

    The sum over the axes of rotation and over those of translation, each about the robot; the map is free to
    follow.
    """
    p = root.shape[1]
    squares = (root**2).sum(axis=0)
    return float(squares[rotation_part(p)].sum()), float(squares[translation_part(p)].sum())


@metrics.register("nullity", unit="1", header="nullity", lower_is_better=None, **_RECORDED)
def last_nullity(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Directions unobservable to the back end at its last frame; 3 in the plane and 6 in space are right."""
    return last_value(run, NULLITY)


@metrics.register(TURN, unit="1/rad²", header="spurious information, turn", lower_is_better=True, **_RECORDED)
def spurious_turn(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Information on the heading that the back end would hold without a start, at the end; 0 is right."""
    return last_value(run, TURN)


@metrics.register(SHIFT, unit="1/m²", header="spurious information, shift", lower_is_better=True, **_RECORDED)
def spurious_shift(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Information on the position that the back end would hold without a start, at the end; 0 is right."""
    return last_value(run, SHIFT)


@metrics.register("linearisation_drift", unit="m", header="Jacobian drift", lower_is_better=None, **_RECORDED)
def linearisation_drift(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Median distance of observed landmarks' estimates from the points of their Jacobians."""
    values = run.diagnostics.get("drift_landmarks_m", np.empty(0))
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else math.nan


def last_value(run: Run, series: str) -> float:
    """The last value that a run's series has; NaN without any."""
    values = run.diagnostics.get(series, np.empty(0))
    values = values[np.isfinite(values)]
    return float(values[-1]) if values.size else math.nan
