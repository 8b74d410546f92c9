"""A class test by test: how hard each was, what it told apart, which mistakes were named, who answers alike.

Difficulty is the mean share of the points earned. Discrimination is the item-rest correlation, of a test's
share with the points of all other tests: near 0, a test says nothing about who can do the rest; below 0, look
at the test. Both are over submissions that were graded to the end, and without tests at which the grader
itself failed.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamcmp.grading.results.class_summary import pattern
from slamcmp.grading.results.gradebook import GradebookRow
from slamcmp.grading.results.outcome import TestOutcome
from slamcmp.grading.results.student_view import clean

MISTAKES_SHOWN = 12
CLUSTERS_SHOWN = 20
LOST_TESTS_MIN = 3
"""Of a cluster: who loses points in fewer tests shares them with too many."""
SHARES_APART = 0.1
"""Shares of a test's points that one program may earn with the data of two students."""
RIGHT = 1 - 1e-9


@dataclass(frozen=True)
class TestStatistics:
    """One test over all submissions that were graded to the end."""

    __test__ = False

    name: str
    points: float
    submissions: int
    full: int
    """With all points."""
    mean_share: float
    discrimination: float | None
    """None: fewer than five submissions, or all the same."""


@dataclass(frozen=True)
class NamedMistake:
    """A cause that was named, numbers replaced by #."""

    message: str
    students: int
    tests: tuple[str, ...]
    """In which it was named."""


@dataclass(frozen=True)
class Cluster:
    """Submissions that fail alike."""

    students: tuple[str, ...]
    tests: tuple[str, ...]
    """In which all of them lose the same share, with the same cause where one was named."""
    score: float
    """Of the first, of all points [%]."""


def test_statistics(rows: Sequence[GradebookRow]) -> tuple[TestStatistics, ...]:
    """Every test of the assignment in its order."""
    outcomes = [row.outcome for row in rows if row.outcome is not None and row.outcome.complete]
    shares: dict[str, list[tuple[float, float]]] = defaultdict(list)
    points: dict[str, float] = {}
    for outcome in outcomes:
        whole = outcome.score
        for test in outcome.tests:
            if not test.judged:
                continue
            name = _name(test)
            points[name] = test.max_score
            shares[name].append((_share(test), whole - test.score))
    return tuple(
        TestStatistics(
            name,
            points[name],
            len(pairs),
            sum(share >= RIGHT for share, _ in pairs),
            float(np.mean([share for share, _ in pairs])),
            _correlation(pairs),
        )
        for name, pairs in shares.items()
    )


test_statistics.__test__ = False  # type: ignore[attr-defined]  # pytest would take it for a test.


def named_mistakes(rows: Sequence[GradebookRow]) -> tuple[NamedMistake, ...]:
    """The causes that were named to most students, each counted once a student."""
    students: Counter[str] = Counter()
    places: dict[str, dict[str, int]] = defaultdict(dict)
    for row in rows:
        told: set[str] = set()
        for place, test in enumerate(row.outcome.tests if row.outcome is not None else ()):
            for cause in test.causes or ():
                message = pattern(cause)
                told.add(message)
                places[message][_name(test)] = place
        students.update(told)
    most = sorted(students.items(), key=lambda item: (-item[1], item[0]))[:MISTAKES_SHOWN]
    return tuple(
        NamedMistake(message, count, tuple(sorted(places[message], key=places[message].__getitem__)))
        for message, count in most
    )


def causes_recorded(rows: Sequence[GradebookRow]) -> bool:
    """Whether anybody looked for causes; False for results of versions that kept only the messages."""
    tests = [test for row in rows if row.outcome is not None for test in row.outcome.tests]
    return any(test.causes is not None for test in tests) or all(_share(test) >= RIGHT for test in tests)


def clusters(rows: Sequence[GradebookRow]) -> tuple[Cluster, ...]:
    """Groups of submissions that lose about the same share in the same tests, with the same causes.

    Hidden data differ between students, and what one mistake costs with them: shares that are no farther
    apart than ``SHARES_APART`` count as the same. Who loses points in fewer than three tests, or earns
    nothing anywhere, is in no group, and nor is who was not graded to the end or where the grader itself
    failed.
    """
    groups: dict[tuple[tuple[str, tuple[str, ...]], ...], list[list[_Member]]] = defaultdict(list)
    for row in rows:
        outcome = row.outcome
        if outcome is None or not outcome.complete or outcome.score <= 0:
            continue
        if not all(test.judged for test in outcome.tests):
            continue
        lost = [test for test in outcome.tests if _share(test) < RIGHT]
        if len(lost) < LOST_TESTS_MIN:
            continue
        behaviour = tuple(
            (_name(test), tuple(pattern(cause) for cause in test.causes or ())) for test in lost
        )
        member = _Member(
            row.student, 100.0 * outcome.score / outcome.max_score, [_share(test) for test in lost]
        )
        for members in groups[behaviour]:
            if np.abs(np.subtract(members[0].shares, member.shares)).max() <= SHARES_APART:
                members.append(member)
                break
        else:
            groups[behaviour].append([member])
    found = [
        Cluster(
            tuple(clean(each.student) for each in members),
            tuple(name for name, _ in behaviour),
            members[0].percent,
        )
        for behaviour, apart in groups.items()
        for members in apart
        if len(members) > 1
    ]
    return tuple(sorted(found, key=lambda each: (-len(each.tests), each.students)))[:CLUSTERS_SHOWN]


@dataclass(frozen=True)
class _Member:
    student: str
    percent: float
    shares: list[float]
    """Of the points of the tests in which some are lost."""


def _name(test: TestOutcome) -> str:
    return clean(f"{test.number} {test.name}")


def _share(test: TestOutcome) -> float:
    return test.score / test.max_score if test.max_score > 0 else float(test.status == "passed")


def _correlation(pairs: Sequence[tuple[float, float]]) -> float | None:
    if len(pairs) < 5:
        return None
    own, rest = np.array(pairs).T
    # What differs by rounding alone does not differ.
    if own.std() < 1e-9 or rest.std() < 1e-9 * max(1.0, float(np.abs(rest).max())):
        return None
    value = float(np.corrcoef(own, rest)[0, 1])
    return value if math.isfinite(value) else None
