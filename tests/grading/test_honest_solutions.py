"""Right solutions that are written otherwise than the reference get full marks, on every seed."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from slamcmp.grading.assignment.description import find_assignment, load_assignment, load_source
from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.run.grader import Grading, Sandboxed
from slamcmp.grading.run.publish import InProcess

FILES = sorted(Path(__file__).with_name("honest_solutions").glob("*/*.py"))
SECRET = b"a secret of the tests"


def written(path: Path) -> str:
    """The reference with the parts that the file writes in its own way."""
    return load_assignment(find_assignment(path.parent.name)).solution_source + path.read_text()


def lost(path: Path, student: str, *, without: tuple[str, ...] = ()) -> dict[str, str]:
    """Messages of the tests in which points are lost, by name; some kinds of test may be left out."""
    assignment = load_assignment(find_assignment(path.parent.name))
    tests = tuple(test for test in assignment.tests if test.fields.kind not in without)
    assignment = replace(assignment, tests=tests)
    runner = InProcess(load_source("slamcmp_honest", written(path), path))
    *_, outcome = Grading(assignment, student, SECRET).outcomes(runner)
    return {
        test.name: f"{test.score} of {test.max_score}: {test.message}"
        for test in outcome.tests
        if test.score < test.max_score
    }


def test_there_are_twenty_and_more() -> None:
    assert len(FILES) >= 20


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_full_marks(path: Path) -> None:
    # Another seed for each. Right to rounding in steps and drives is as accurate as the reference.
    assert lost(path, path.stem, without=("accuracy", "consistency", "speed")) == {}


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_full_marks_on_every_seed(path: Path) -> None:
    assert {seed: lost(path, f"student {seed}") for seed in range(20)} == {seed: {} for seed in range(20)}


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_full_marks_in_the_sandbox_where_speed_counts(path: Path) -> None:
    assignment = load_assignment(find_assignment(path.parent.name))
    entry = assignment.fields.entry
    submission = Submission(entry, "file", {entry: written(path).encode()}, entry)
    *_, outcome = Grading(assignment, "ada", SECRET).outcomes(Sandboxed(assignment, submission, True))
    assert [test.message for test in outcome.tests if test.score < test.max_score] == []
