"""Marks are for work: what does nothing, answers nonsense or hides from a test earns nothing for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamcmp.grading.assignment.description import Assignment, find_assignment, load_assignment, load_source
from slamcmp.grading.assignment.idle import idle_submissions
from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.results.outcome import GradeOutcome
from slamcmp.grading.run.grader import Grading
from slamcmp.grading.run.publish import InProcess
from slamcmp.grading.run.source_reader import read_source
from slamcmp.grading.run.watched import Watched
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.grading.sandbox.inside.definitions import definitions


def graded(assignment: Assignment, source: str, *tests: str) -> GradeOutcome:
    """Without a sandbox and without causes."""
    wanted = tuple(test for test in assignment.tests if not tests or test.fields.name in tests)
    short = replace(assignment, tests=wanted)
    runner = InProcess(load_source("slamcmp_student", source, Path("student.py")))
    *_, outcome = Grading(short, "ada", b"a secret of the tests", causes=False).outcomes(runner)
    return outcome


# Of the others the gate says it (test_assignments.py).
@pytest.mark.parametrize("name", ["kalman_filter"])
def test_who_does_nothing_earns_next_to_nothing(name: str) -> None:
    assignment = load_assignment(find_assignment(name))
    scores = {who: graded(assignment, source).score for who, source in idle_submissions(assignment).items()}
    assert set(scores) == {"echo", "nan", "zeros", "nothing"}
    # Without a sandbox nothing is timed and the points for speed are given to everyone.
    speed = sum(test.fields.points for test in assignment.tests if test.fields.kind == "speed")
    assert max(scores.values()) <= 2 + speed, scores


class Function:
    """One function in place of a submission."""

    def __init__(self, answer: object) -> None:
        self._answer = answer

    def call(self, name: str, *arguments: object) -> object:
        return self._answer(*arguments) if callable(self._answer) else self._answer


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (np.zeros((60000, 1)), r"f has shape \(60000, 1\); \(2,\) is needed"),
        (np.zeros(200_000), r"f has shape \(200000,\)"),
        (np.zeros((2, 1)), r"f has shape \(2, 1\)"),
        (3.0, r"f has shape \(\)"),
        (None, "f is None; is a return statement missing"),
        ("two", "f is str; an array of shape"),
        ((np.zeros(2), np.zeros(2)), "f has shape"),
    ],
)
def test_answers_are_looked_at_before_any_arithmetic(answer: object, told: str) -> None:
    watched = Watched(Function(answer), Function(np.ones(2)))  # type: ignore[arg-type]
    with pytest.raises(StudentError, match=told):
        watched.call("f", 1.0)


def test_what_gives_back_its_arguments_is_noticed_and_what_has_to_is_not() -> None:
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    grown = np.zeros((3, 3))
    grown[:2, :2] = P
    for answer in (P, np.zeros((2, 2))):
        watched = Watched(Function(answer), Function(2 * P))  # type: ignore[arg-type]
        watched.call("f", P)
        assert watched.idle == {"f"}
    watched = Watched(Function(grown), Function(grown + 1))  # type: ignore[arg-type]
    watched.call("f", P)
    assert watched.idle == {"f"}
    for answer, right in ((P, P), (1.5 * P, 2 * P)):
        watched = Watched(Function(answer), Function(right))  # type: ignore[arg-type]
        watched.call("f", P)
        assert watched.idle == set()
    watched = Watched(Function(P * np.nan), Function(P))  # type: ignore[arg-type]
    watched.call("f", P)
    assert watched.not_finite == {"f"}


def test_a_function_that_raises_not_implemented_in_some_calls_is_written() -> None:
    source = b"""
def a(x):
    "Only the starter's text."
    raise NotImplementedError("to do")
def b(x):
    if x: raise NotImplementedError
    return x
def c(*x): raise NotImplementedError
"""
    submission = Submission("s.py", "file", {"s.py": source}, "s.py")
    assert read_source(submission, ["a", "b", "c", "d"]).unwritten == ("a", "c", "d")
    for hostile in (b"(" * 150_000, b"-" * 150_000 + b"1", b"not python ("):
        assert read_source(Submission("s.py", "file", {"s.py": hostile}, "s.py"), ["a"]).unwritten == ()


def test_a_written_function_that_refuses_in_the_company_of_others_earns_nothing() -> None:
    assignment = load_assignment(find_assignment("ekf"))
    hiding = assignment.solution_source + (
        "\n_called = []\n_propagate, _update = propagate, update\n"
        "def propagate(*a):\n    _called.append(1)\n    return _propagate(*a)\n"
        "def update(mean, covariance, y, H, noise):\n"
        "    if _called: raise NotImplementedError\n    return mean, 0.9 * covariance\n"
    )
    assert graded(assignment, hiding, "All parts together").score == 0


def test_a_notebooks_values_that_definitions_use_are_run_and_exploration_is_not() -> None:
    import ast

    tree = ast.parse(
        "import numpy as np\nn = 3\nI3 = np.eye(n)\nscale = np.sqrt(2)\nhalf = scale / 2\nplot(I3)\n"
        "unused = load('huge')\ndef f(x):\n    return I3 @ x * half\n"
    )
    run, left_out = definitions(tree.body)
    assert [statement.lineno for statement in run] == [1, 2, 3, 4, 5, 8]
    assert [statement.lineno for statement in left_out] == [6, 7]
