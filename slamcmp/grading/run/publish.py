"""The gate before an assignment is published: the reference, the starter and every known mistake graded.

The solution has to earn everything on every seed, the starter nothing, and each mutant has to lose marks
with the message that names it. Four submissions that do no work (idle.py) earn next to nothing.
"""

from __future__ import annotations

import contextlib
import random
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType

from slamcmp.grading.assignment.description import Assignment, find_assignment, load_assignment, load_source
from slamcmp.grading.assignment.idle import idle_submissions
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


def check_publishable(
    folder: Path | str,
    *,
    seeds: int = 3,
    mutants: int | None = None,
    sandboxed: bool = True,
    accept_weak_sandbox: bool = False,
) -> list[GateFinding]:
    """Grade what is known and report what differs from what it should earn; empty: ready to publish.

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

    findings = []
    for number, student in enumerate(students):
        *_, outcome = graded(assignment.solution_source, "solution", student)
        findings += [
            GateFinding(f"solution, seed {number}", f"loses marks in {test.name!r}: {test.message}")
            for test in outcome.tests
            if test.score < RIGHT * test.max_score
        ]
    starter = (assignment.folder / "starter.py").read_text(encoding="utf-8")
    *_, outcome = graded(starter, "starter", students[0])
    if outcome.score > 0:
        earned = [f"{test.name} ({test.score:g})" for test in outcome.tests if test.score > 0]
        findings.append(GateFinding("starter", f"earns marks in {', '.join(earned)}"))
    for name, source in idle_submissions(assignment).items():
        *_, outcome = graded(source, name, students[0])
        if outcome.score > IDLE_SHARE * outcome.max_score:
            earned = [f"{test.name} ({test.score:.3g})" for test in outcome.tests if test.score > 0]
            findings.append(GateFinding(f"submission {name!r}", f"earns marks in {', '.join(earned)}"))
    known = assignment.mutants
    if mutants is not None and mutants < len(known):
        known = tuple(random.Random(0).sample(known, mutants))
    for mutant in known:
        findings += _judge(mutant.name, mutant.message, graded(mutant.source, mutant.name, students[0]))
    return findings


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
                return []
            lost.append(f"{test.name}: {test.message.splitlines()[0]}")
    what = f"is not named; the messages are: {'; '.join(lost)}" if lost else "loses no marks"
    return [GateFinding(who, what)]
