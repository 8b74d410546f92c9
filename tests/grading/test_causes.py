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
from slamcmp.support.configuration.yaml_source import load_yaml


def mistakes_in(file: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = load_yaml(Path(__file__).with_name(file)).data["mistakes"]
    return found


MISTAKES = mistakes_in("student_mistakes.yaml")
UNKNOWN = mistakes_in("student_slips.yaml")


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
    ],
)
def test_of_mistakes_that_nobody_foresaw_most_are_named_and_none_wrongly(
    chosen: list[dict[str, Any]],
) -> None:
    """Those with several faults in one place are left in: two thirds are asked for."""
    found: dict[str, list[str]] = defaultdict(list)
    for mistake in chosen:
        causes = {cause for test in graded(mistake).tests for cause in test.causes or ()}
        right = [any(words in cause for words in mistake["says"]) for cause in causes]
        kind = "none" if not causes else "right" if all(right) else "wrong"
        found[kind].append(f"{mistake['assignment']}: {mistake['new']!r} -> {sorted(causes)}")
    assert found["wrong"] == []
    assert len(found["right"]) >= 2 / 3 * len(chosen), found["none"]
