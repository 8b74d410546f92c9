"""The gate before an assignment is published: the reference, the starter and every known mistake graded.

The solution has to pass the public tests and to earn everything on every seed, the starter nothing, and each
mutant has to lose marks with the message that names it. Four submissions that do no work (idle.py) earn next
to nothing.
"""

from __future__ import annotations

import contextlib
import random
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from slamcmp.errors import MissingDataError
from slamcmp.grading.assignment.description import Assignment, find_assignment, load_assignment, load_source
from slamcmp.grading.assignment.handout import read_handout
from slamcmp.grading.assignment.idle import idle_submissions
from slamcmp.grading.assignment.public_tests import PUBLIC, run_public_tests
from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.results.outcome import GradeOutcome
from slamcmp.grading.run.grader import Grading, Sandboxed
from slamcmp.grading.run.implementations import TrustedImplementation
from slamcmp.grading.run.judge import RIGHT, Runner, Sides

IDLE_SHARE = 0.02
"""Most that a submission without work may earn, of all points."""


@dataclass(frozen=True)
class GateFinding:
    """What is not as it has to be."""

    who: str
    what: str


class InProcess:
    """The course's own code graded without a sandbox; never for a submission."""

    apart = False
    level = "none"
    output = ""
    digest = ""
    proofs: Mapping[str, str] = MappingProxyType({})
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    @contextlib.contextmanager
    def open(self) -> Iterator[Sides]:
        """In this process, with no reference beside it."""
        with warnings.catch_warnings(action="ignore"):
            yield TrustedImplementation(self._module), None


@dataclass(frozen=True)
class GateStep:
    """One submission of the gate, graded."""

    who: str
    wanted: str
    """What it should earn."""
    earned: float | None
    """Of all points; None where nothing is graded, or only until a mistake was named."""
    seconds: float
    findings: tuple[GateFinding, ...]


def check_publishable(folder: Path | str, **options: Any) -> list[GateFinding]:
    """What differs from what it should earn, by :func:`gate` with its options; empty: ready to publish."""
    return [finding for step in gate(folder, **options) for finding in step.findings]


def gate(
    folder: Path | str,
    *,
    seeds: int = 3,
    mutants: int | None = None,
    sandboxed: bool = True,
    accept_weak_sandbox: bool = False,
) -> Iterator[GateStep]:
    """Grade what is known, one submission after another.

    Args:
        folder: the assignment.
        seeds: students (that is, seeds) for the reference; starter and mutants get the first.
        mutants: how many of the known mistakes, drawn with a fixed seed; None: all.
        sandboxed: in the sandbox, as submissions are; else in this process, faster.
        accept_weak_sandbox: as for grading.

    Raises:
        UsageError, MissingDataError: the assignment cannot be read.
    """
    assignment = load_assignment(find_assignment(folder))
    starter = assignment.folder / "starter.py"
    if not starter.is_file():
        raise MissingDataError(f"{starter}: no such file; an assignment needs it")
    students = [
        Grading(assignment, f"student {number}", b"secret of the publish gate") for number in range(seeds)
    ]

    def graded(source: str, name: str, grading: Grading) -> Iterator[GradeOutcome]:
        runner: Runner
        if sandboxed:
            submission = _submission(assignment, source)
            runner = Sandboxed(assignment, submission, accept_weak_sandbox)
        else:
            runner = InProcess(
                load_source(f"slamcmp_gate_{assignment.name}", source, assignment.folder / name)
            )
        return grading.outcomes(runner)

    def step(who: str, source: str, student: Grading, most: float | None) -> GateStep:
        """Grade one that should earn everything (None), or at most a share."""
        started = time.monotonic()
        *_, outcome = graded(source, who, student)
        findings = (
            tuple(
                GateFinding(who, f"loses marks in {test.name!r}: {test.message}")
                for test in outcome.tests
                if test.score < RIGHT * test.max_score
            )
            if most is None
            else tuple(_too_much(who, outcome, most))
        )
        wanted = "all" if most is None else f"at most {100 * most:g} %" if most else "nothing"
        return GateStep(who, wanted, outcome.score, time.monotonic() - started, findings)

    yield _public_tests(assignment, starter)
    for number, student in enumerate(students):
        yield step(f"solution, seed {number}", assignment.solution_source, student, None)
    yield step("starter", starter.read_text(encoding="utf-8"), students[0], 0.0)
    # Of these only the points count, and every answer is wrong.
    unexplained = Grading(assignment, "student 0", b"secret of the publish gate", causes=False)
    for name, source in idle_submissions(assignment).items():
        yield step(f"submission {name!r}", source, unexplained, IDLE_SHARE)
    known = assignment.mutants
    if mutants is not None and mutants < len(known):
        known = tuple(random.Random(0).sample(known, mutants))
    for mutant in known:
        started = time.monotonic()
        found = tuple(_judge(mutant.name, mutant.message, graded(mutant.source, mutant.name, students[0])))
        yield GateStep(f"mutant {mutant.name!r}", "named", None, time.monotonic() - started, found)


def _too_much(who: str, outcome: GradeOutcome, most: float) -> Iterator[GateFinding]:
    if outcome.score > most * outcome.max_score:
        earned = [f"{test.name} ({test.score:.3g})" for test in outcome.tests if test.score > 0]
        yield GateFinding(who, f"earns marks in {', '.join(earned)}")


def _public_tests(assignment: Assignment, starter: Path) -> GateStep:
    """Public tests are passed by the solution, and not by the starter; the handout fits the assignment."""
    who, started = "public tests", time.monotonic()
    findings = []
    handout = read_handout(assignment.folder)
    if handout.entry != assignment.fields.entry:
        what = f"import from {handout.entry}; {assignment.fields.entry} is handed in"
        findings.append(GateFinding(who, what))
    else:
        with tempfile.TemporaryDirectory() as folder:
            entry = Path(folder) / handout.entry
            shutil.copyfile(assignment.folder / PUBLIC, Path(folder) / PUBLIC)
            entry.write_text(assignment.solution_source, encoding="utf-8")
            for test in run_public_tests(entry):
                if not test.passed:
                    findings.append(GateFinding(who, f"the solution fails {test.check!r}: {test.message}"))
            shutil.copyfile(starter, entry)
            if all(test.passed for test in run_public_tests(entry)):
                findings.append(GateFinding(who, "the starter passes them all"))
    return GateStep(who, "passed", None, time.monotonic() - started, tuple(findings))


def _submission(assignment: Assignment, source: str) -> Submission:
    entry = assignment.fields.entry
    return Submission(entry, "file", {entry: source.encode()}, entry)


def _judge(name: str, message: str, outcomes: Iterator[GradeOutcome]) -> Sequence[GateFinding]:
    who = f"mutant {name!r}"
    # The template's own words, up to the first number that is filled in.
    words = message.split("{", 1)[0]
    lost = []
    for outcome in outcomes:
        test = outcome.tests[-1]
        if test.score < RIGHT * test.max_score:
            if words in test.message:
                said = next(line for line in test.message.splitlines() if words.split("\n")[0] in line)
                if "{yours" in message and "nan" in said.split():
                    return [GateFinding(who, f"its message has nothing to fill in: {said}")]
                return []
            lost.append(f"{test.name}: {test.message.splitlines()[0]}")
    what = f"is not named; the messages are: {'; '.join(lost)}" if lost else "loses no marks"
    return [GateFinding(who, what)]
