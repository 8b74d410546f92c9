"""What grading one submission found, as plain data: the one thing that every results format is made from."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from slamcmp.errors import DataError, MissingDataError
from slamcmp.support.files.atomic import write_atomically

TestStatus = Literal["passed", "partial", "failed", "error", "timed_out", "skipped"]
Visibility = Literal["visible", "hidden", "after_due_date", "after_published"]

FORMAT = 2


@dataclass(frozen=True)
class Series:
    """One curve of a plot; a band comes as two series, its lower and its upper border."""

    name: str
    y: tuple[float, ...]
    role: Literal["truth", "reference", "yours", "band"]
    x: tuple[float, ...] = ()
    """Of its own, as a path in the plane has it; empty: the plot's."""


@dataclass(frozen=True)
class Plot:
    """Curves, for the student to see where their answer left the others."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    series: tuple[Series, ...]
    caption: str
    equal_scales: bool = False
    """A metre is as long on one axis as on the other: both are of the same unit."""


@dataclass(frozen=True)
class TestOutcome:
    """What one test found."""

    __test__ = False  # pytest would take it for a test case by its name.

    number: str
    name: str
    kind: str
    status: TestStatus
    score: float
    max_score: float
    visibility: Visibility
    message: str
    """For the student, as soon as the test is visible to them."""
    staff_detail: str
    """Seeds, numbers and tracebacks; never for the student."""
    seconds: float
    plots: tuple[Plot, ...] = ()
    judged: bool = True
    """False: the grader itself failed at this test, and the staff has to look at it."""
    causes: tuple[str, ...] | None = None
    """The likely causes named, with which the message begins; None: nobody looked for them."""


@dataclass(frozen=True)
class GradeOutcome:
    """What all tests of an assignment found about one submission."""

    assignment: str
    assignment_digest: str
    student: str
    submission_digest: str
    complete: bool
    """False while tests are still to be run: the file is written again after each of them."""
    tests: tuple[TestOutcome, ...]
    sandbox_level: str
    proofs: Mapping[str, str]
    """What the sandbox was seen to prevent, by attempt."""
    seconds: float
    versions: Mapping[str, str]
    leaderboard: tuple[tuple[str, float, Literal["asc", "desc"]], ...] = ()
    """Name, value, and which end of the order is the better one to stand first; of visible tests only."""
    notes: tuple[str, ...] = field(default=())
    """For the student, about the submission as a whole."""

    @property
    def score(self) -> float:
        """Points of all tests."""
        return math.fsum(test.score for test in self.tests)

    @property
    def max_score(self) -> float:
        """Points that could be had in the tests so far."""
        return math.fsum(test.max_score for test in self.tests)


def save_outcome(outcome: GradeOutcome, path: Path) -> None:
    """Write the outcome as JSON, all of it or nothing.

    Raises:
        StorageError: the file cannot be written.
    """
    text = json.dumps({"format": FORMAT, **asdict(outcome)}, indent=1) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def load_outcome(path: Path) -> GradeOutcome:
    """Read what :func:`save_outcome` wrote.

    Raises:
        MissingDataError: there is no such file.
        DataError: it is no outcome.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MissingDataError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise DataError(f"{path}: is no JSON ({error})") from error
    try:
        if (found := content.pop("format")) != FORMAT:
            raise DataError(f"{path}: format {found}, written by another version of slamcmp; grade again")
        content["tests"] = tuple(test_of(test) for test in content["tests"])
        content["leaderboard"] = tuple(tuple(row) for row in content["leaderboard"])
        content["notes"] = tuple(content["notes"])
        return GradeOutcome(**content)
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: is no outcome of a grading ({error})") from error


def test_of(content: dict[str, Any]) -> TestOutcome:
    """A test from its fields as JSON gives them.

    Raises:
        KeyError, TypeError: these are no fields of a test.
    """
    plots = tuple(_plot(plot) for plot in content["plots"])
    causes = content.get("causes")
    return TestOutcome(
        **{**content, "plots": plots, "causes": None if causes is None else tuple(map(str, causes))}
    )


def _plot(content: dict[str, Any]) -> Plot:
    series = tuple(
        Series(**{**entry, "x": tuple(entry["x"]), "y": tuple(entry["y"])}) for entry in content["series"]
    )
    return Plot(**{**content, "x": tuple(content["x"]), "series": series})
