"""Which cause is named of single mistakes as students make them: the right one or none, never another."""

from __future__ import annotations

import functools
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slamcmp.grading.assignment.description import find_assignment, load_assignment, load_source
from slamcmp.grading.results.outcome import GradeOutcome
from slamcmp.grading.run.grader import Grading
from slamcmp.grading.run.publish import InProcess
from tests.grading.named_causes import LISTS, PAGE, mistakes_in, page_with, rows, table, verdict

MISTAKES = mistakes_in("student_mistakes.yaml")
UNKNOWN = mistakes_in(LISTS["first"])
FRESH = mistakes_in(LISTS["second"])


@functools.cache
def grading_of(name: str) -> Grading:
    """One for all mistakes: what the reference and the mutants answer is asked for once.

    Of many runs a few are enough: a cause is looked for in the first.
    """
    assignment = load_assignment(find_assignment(name))
    tests = tuple(
        replace(test, parameters={**test.parameters, "runs": 5}) if "runs" in test.parameters else test
        for test in assignment.tests
    )
    return Grading(replace(assignment, tests=tests), "ada", b"a secret of the tests")


def graded(mistake: dict[str, Any]) -> GradeOutcome:
    """What a submission with this mistake earns, and what is said of it."""
    grading = grading_of(mistake["assignment"])
    source = grading.assignment.solution_source
    assert source.count(mistake["old"]) == 1, mistake
    module = load_source(
        "slamcmp_student", source.replace(mistake["old"], mistake["new"]), Path("student.py")
    )
    *_, outcome = grading.outcomes(InProcess(module))
    assert outcome.score < outcome.max_score, mistake
    return outcome


def named(mistake: dict[str, Any]) -> set[str]:
    """Names of the mutants whose message is told anywhere in the tests of a submission with this mistake."""
    said = "\n".join(test.message for test in graded(mistake).tests)
    mutants = grading_of(mistake["assignment"]).assignment.mutants
    # The template's own words, up to the first number that is filled in.
    return {mutant.name for mutant in mutants if mutant.message.split("{", 1)[0] in said}


OTHER_WORDS = ['state["pose_of"] = state["pose_of"] - 0', "new = last + motion"]
"""Mistakes of which the right cause is named in other words than were fixed."""
SMALL = [each for each in MISTAKES if each["assignment"] == "kalman_filter"][:8]
HALVES = {half: [each for each in MISTAKES if each["half"] == half] for half in ("built", "kept")}


@pytest.mark.parametrize(
    "chosen",
    [
        pytest.param(SMALL, id="kalman_filter"),
        *(pytest.param(each, id=half, marks=pytest.mark.slow) for half, each in HALVES.items()),
    ],
)
def test_most_single_mistakes_are_named_and_none_wrongly(chosen: list[dict[str, Any]]) -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for mistake in chosen:
        causes = named(mistake)
        kind = "right" if causes and causes <= set(mistake["right"]) else "none" if not causes else "wrong"
        found[kind].append(f"{mistake['assignment']}: {mistake['new']!r} -> {sorted(causes)}")
    assert found["wrong"] == []
    assert len(found["right"]) >= 0.75 * len(chosen), found["none"]


@pytest.mark.parametrize(
    "chosen",
    [
        pytest.param(
            [each for each in UNKNOWN if each["assignment"] == "kalman_filter"][::3], id="kalman_filter"
        ),
        *(
            pytest.param([each for each in UNKNOWN if each["half"] == half], id=half, marks=pytest.mark.slow)
            for half in ("built", "kept")
        ),
        pytest.param(FRESH, id="second", marks=pytest.mark.slow),
    ],
)
def test_of_mistakes_that_nobody_foresaw_most_are_named_and_none_wrongly(
    chosen: list[dict[str, Any]],
) -> None:
    """Those with several faults in one place are left in: two thirds are asked for."""
    found: dict[str, list[str]] = defaultdict(list)
    for mistake in chosen:
        causes = sorted({cause for test in graded(mistake).tests for cause in test.causes or ()})
        kind = verdict(mistake, causes)
        found[kind].append(f"{mistake['assignment']}: {mistake['new']!r} -> {causes}")
    assert [each for each in found["wrong"] if not any(repr(words) in each for words in OTHER_WORDS)] == []
    assert len(found["right"]) >= 2 / 3 * len(chosen), found["not named"]


@pytest.mark.parametrize("number", [number for number, each in enumerate(FRESH) if "A.T" in each["new"]][-1:])
def test_the_committed_result_is_what_is_said(number: int) -> None:
    causes = sorted({cause for test in graded(FRESH[number]).tests for cause in test.causes or ()})
    (row,) = [row for row in rows() if (row["list"], row["number"]) == ("second", str(number))]
    assert (row["said"], row["verdict"]) == (" / ".join(causes), verdict(FRESH[number], causes))


def test_the_committed_result_is_of_these_lists_and_stands_in_the_docs() -> None:
    result = rows()
    mistakes = [("first", each) for each in UNKNOWN] + [("second", each) for each in FRESH]
    for row, (name, mistake) in zip(result, mistakes, strict=True):
        assert (row["list"], row["assignment"], row["new"]) == (name, mistake["assignment"], mistake["new"])
        assert row["verdict"] == verdict(mistake, _causes(row))
    assert page_with(table(result), PAGE.read_text()) == PAGE.read_text()
    # Read by hand and told on the page: both say what was done.
    assert [row["new"] for row in result if row["verdict"] == "wrong"] == OTHER_WORDS
    right = [row for row in result if row["verdict"] == "right"]
    assert len(right) >= 0.75 * len(result)


def _causes(row: dict[str, str]) -> list[str]:
    return row["said"].split(" / ") if row["said"] else []
