"""A class in a few numbers: how the scores are spread, and what went wrong most often."""

from __future__ import annotations

import re
import statistics
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from slamcmp.grading.results.gradebook import GradebookRow
from slamcmp.grading.results.student_view import clean, total

BINS = 10
FAILURES_SHOWN = 10


@dataclass(frozen=True)
class Failure:
    """One test that submissions lose points in."""

    test: str
    submissions: int
    lost: float
    """Points lost in it by the whole class, as a share of those that could be had in it."""
    message: str
    """The most frequent first line of the message, numbers replaced by #."""
    message_count: int


@dataclass(frozen=True)
class ClassSummary:
    """Scores in percent of the points of the assignment."""

    submissions: int
    graded: int
    endings: dict[str, int]
    """Submissions by how their grading ended."""
    mean: float | None
    quartiles: tuple[float, float, float, float, float] | None
    """Minimum, lower quartile, median, upper quartile, maximum."""
    histogram: tuple[int, ...]
    """Submissions in each tenth of the scale, the last with its upper end."""
    failures: tuple[Failure, ...]
    """The most frequent first."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def summarise(rows: Sequence[GradebookRow]) -> ClassSummary:
    """The summary of a gradebook; a submission that is pending counts in ``submissions`` only.

    The points of the assignment are the most that could be had in any of the outcomes: one that was cut
    short knows fewer tests.
    """
    outcomes = [row.outcome for row in rows if row.outcome is not None]
    possible = max((total(outcome.tests, of="max_score") for outcome in outcomes), default=0.0)
    graded = [row for row in rows if row.outcome is not None]
    scores = [100.0 * row.final / possible for row in graded] if possible else []
    histogram = [0] * BINS
    for score in scores:
        histogram[min(BINS - 1, max(0, int(score * BINS / 100.0)))] += 1
    return ClassSummary(
        submissions=len(rows),
        graded=len(outcomes),
        endings=dict(Counter(row.ended for row in rows)),
        mean=statistics.fmean(scores) if scores else None,
        quartiles=_quartiles(scores),
        histogram=tuple(histogram),
        failures=_failures(rows),
    )


def _quartiles(scores: list[float]) -> tuple[float, float, float, float, float] | None:
    if not scores:
        return None
    ends = min(scores), max(scores)
    middle = statistics.quantiles(scores, n=4, method="inclusive") if len(scores) > 1 else scores * 3
    return ends[0], middle[0], middle[1], middle[2], ends[1]


def _failures(rows: Sequence[GradebookRow]) -> tuple[Failure, ...]:
    counts: Counter[str] = Counter()
    earned: dict[str, float] = defaultdict(float)
    possible: dict[str, float] = defaultdict(float)
    messages: dict[str, Counter[str]] = {}
    for row in rows:
        for test in row.outcome.tests if row.outcome is not None else ():
            name = clean(f"{test.number} {test.name}")
            earned[name] += test.score
            possible[name] += test.max_score
            if test.score < test.max_score or (test.max_score == 0 and test.status != "passed"):
                counts[name] += 1
                messages.setdefault(name, Counter())[pattern(test.message)] += 1
    failures = []
    for name, count in counts.most_common(FAILURES_SHOWN):
        message, times = messages[name].most_common(1)[0]
        lost = 1.0 - earned[name] / possible[name] if possible[name] else 0.0
        failures.append(Failure(name, count, lost, message, times))
    return tuple(failures)


def pattern(message: str) -> str:
    """Messages that differ in their numbers only are one failure."""
    first = clean(message).strip().split("\n", 1)[0][:160]
    return re.sub(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", "#", first)
