"""Matches made wrong on purpose, and the truth to judge by: for experiments on outlier rejection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from slamcmp.frontend.vision.image_pair import precision_recall
from slamcmp.types import BoolArray, FloatArray, IntArray
from slamcmp.types.stream import JUDGED, PASSED, PASSED_RIGHT, RIGHT

CORRECT_PX = 3.0
"""Largest distance between a match and the truth: what is farther off is another corner."""


@runtime_checkable
class TrueMatches(Protocol):
    """Images that know where they show the same surface, as rendered ones do."""

    def true_pixels(self, k: int, j: int, pixels: FloatArray) -> FloatArray:
        """Where frame j shows what frame k shows at pixels (m, 2); NaN where it does not."""


@dataclass(frozen=True)
class MatchRecord:
    """The matches of one image, and which of them each test let through."""

    k: int
    """Frame of the image."""
    age: IntArray
    """How many frames before it each track was seen last, (m,)."""
    before: FloatArray
    """Pixels (m, 2) there."""
    now: FloatArray
    """Pixels (m, 2) in this image."""
    epipolar: BoolArray
    """Which passed the epipolar test, (m,)."""
    passed: BoolArray
    """Which passed all tests, (m,)."""


@dataclass(frozen=True)
class MatchScores:
    """Of all matches of a sequence whose truth is known."""

    matches: int
    correct: int
    precision: dict[str, float]
    """Share of the matches that are correct, after each stage: matched, epipolar, passed."""
    recall: dict[str, float]
    """Share of the correct matches that each stage kept."""
    passed: int = 0
    """Matches that passed all tests."""
    passed_correct: int = 0

    def counts(self) -> dict[str, int]:
        """What precision and recall are made of, to be added up over streams."""
        return {
            JUDGED: self.matches,
            RIGHT: self.correct,
            PASSED: self.passed,
            PASSED_RIGHT: self.passed_correct,
        }


def spoil_matches(chosen: IntArray, features: int, share: float, generator: np.random.Generator) -> IntArray:
    """Partners (m,) among ``features``, of which a share was exchanged for random other ones."""
    spoilt = chosen.copy()
    victims = generator.permutation(len(chosen))[: round(share * len(chosen))]
    if features > 1:
        # A step of 1 to features - 1 round the list never comes back to the right partner.
        spoilt[victims] = (chosen[victims] + generator.integers(1, features, victims.size)) % features
    return spoilt


def score_matches(records: Sequence[MatchRecord], truth: TrueMatches) -> MatchScores:
    """Precision and recall of each stage; matches whose true partner is hidden do not count."""
    correct: list[BoolArray] = []
    stages: dict[str, list[BoolArray]] = {"matched": [], "epipolar": [], "passed": []}
    for record in records:
        expected = np.full(record.now.shape, np.nan)
        for age in np.unique(record.age):
            those = record.age == age
            expected[those] = truth.true_pixels(record.k - int(age), record.k, record.before[those])
        error = np.linalg.norm(record.now - expected, axis=1)
        known = np.isfinite(error)
        correct.append(error[known] < CORRECT_PX)
        stages["matched"].append(np.ones(int(known.sum()), dtype=bool))
        stages["epipolar"].append(record.epipolar[known])
        stages["passed"].append(record.passed[known])
    right = np.concatenate(correct) if correct else np.zeros(0, dtype=bool)
    kept = {name: np.concatenate(masks) for name, masks in stages.items() if masks}
    return MatchScores(
        right.size,
        int(right.sum()),
        {name: precision_recall(mask, right)[0] for name, mask in kept.items()},
        {name: precision_recall(mask, right)[1] for name, mask in kept.items()},
        int(kept["passed"].sum()) if kept else 0,
        int((kept["passed"] & right).sum()) if kept else 0,
    )
