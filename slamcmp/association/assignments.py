"""Every way in which a frame's detections may belong to landmarks, with its weight.

An assignment gives each detection one landmark or, as something never seen before, none. Its weight is the
logarithm of the joint density of its innovations, and for each new landmark that of a density which it is
told. Under one pose the innovations of a frame are correlated: what agrees pair by pair need not agree
together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamcmp.association.compatibility import NOBODY, Innovations, JointDistance
from slamcmp.types import FloatArray

MOST_FOUND = 300
"""Assignments of one frame that are looked at, likelier pairs first."""


@dataclass(frozen=True)
class Choice:
    """What may be chosen for a detection.

    A new landmark fits whatever is detected. Were it weighed beside each likely pair, what is kept would be
    many ways to start the same landmarks twice, and not the few that differ in where the robot is.
    """

    probability: float
    """Of the gate that a pair has to pass."""
    log_new: float
    """Logarithm of the density of landmarks never seen, per unit of measurement space."""
    log_odds: float
    """A pair is left out where another of its detection is likelier by more than this."""
    log_odds_new: float
    """A new landmark is left out where a pair is likelier by more than this."""


def assignments(innovations: Innovations, choice: Choice) -> list[tuple[float, tuple[int, ...]]]:
    """Weights and assignments: of each detection the landmark's row, or NOBODY for a new one."""
    unit = 0.5 * innovations.dim * math.log(2.0 * math.pi)
    densities = -0.5 * (innovations.squared_distances + innovations.log_determinants) - unit
    passed = innovations.compatible(choice.probability)
    rows = [_choices(densities[i], passed[i], choice) for i in range(len(densities))]
    joint = JointDistance(innovations)
    found: list[tuple[float, tuple[int, ...]]] = []

    def descend(given: tuple[int, ...]) -> None:
        if len(given) == len(rows):
            pairs = len(joint.pairs)
            weight = -0.5 * (joint.distances[-1] + joint.log_determinants[-1]) - pairs * unit
            found.append((weight + (len(rows) - pairs) * choice.log_new, given))
            return
        row = len(given)
        free = [column for column in rows[row] if column == NOBODY or column not in given]
        for column in free or [NOBODY]:
            if len(found) >= MOST_FOUND:
                return
            if column == NOBODY:
                descend((*given, NOBODY))
            else:
                joint.push((row, column))
                descend((*given, column))
                joint.pop()

    descend(())
    return found


def _choices(density: FloatArray, passed: np.ndarray, choice: Choice) -> list[int]:
    columns = np.flatnonzero(passed)
    columns = columns[np.argsort(-density[columns], kind="stable")]
    best = max(choice.log_new, float(density[columns[0]])) if columns.size else choice.log_new
    kept = [int(column) for column in columns if density[column] > best - choice.log_odds]
    if choice.log_new > best - choice.log_odds_new or not kept:
        kept.append(NOBODY)
    return kept
