"""The class's grades as one CSV that a spreadsheet opens, and does not execute.

A spreadsheet takes a cell that begins with one of ``= + - @`` for a formula, whatever quotes stand around it
in the file, and a formula may send the sheet's content away. Students choose the names of their files, and
messages quote their code.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from slamcmp.grading.results.outcome import GradeOutcome
from slamcmp.grading.results.student_view import clean, rounded, total
from slamcmp.support.files.atomic import write_atomically

_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


@dataclass(frozen=True)
class GradebookRow:
    """One student: the outcome, and how the grading of it ended."""

    student: str
    submission: str
    """Of the class's folder: the file's name."""
    ended: str
    """``ok``, ``crashed`` or ``timed_out`` (of the grader, not the submission), ``pending``."""
    outcome: GradeOutcome | None
    deducted_percent: float | None = None
    """Of the points earned, for late hand-ins and attempts (rules.py); None: there are no such rules."""

    @property
    def final(self) -> float:
        """Points after the deduction."""
        earned = 0.0 if self.outcome is None else total(self.outcome.tests)
        return rounded(earned * (1.0 - (self.deducted_percent or 0.0) / 100.0))


def gradebook_csv(rows: Sequence[GradebookRow]) -> str:
    """A header and one row a student; test columns in the order in which the tests are first met."""
    tests = list(
        dict.fromkeys((test.number, test.name) for row in rows if row.outcome for test in row.outcome.tests)
    )
    buffer = io.StringIO()
    writer = csv.writer(buffer, quoting=csv.QUOTE_ALL, lineterminator="\r\n")
    header = ["student", "score", "max_score", "graded", "submission", "sandbox", "notes"]
    by_rules = any(row.deducted_percent is not None for row in rows)
    if by_rules:
        header += ["earned", "deducted_percent"]
    writer.writerow([safe_cell(text) for text in [*header, *(f"{number} {name}" for number, name in tests)]])
    for row in rows:
        outcome = row.outcome
        cells: list[str | float] = [row.student, "", "", row.ended, row.submission, "", ""]
        off: list[str | float] = ["", row.deducted_percent or 0.0] if by_rules else []
        if outcome is not None:
            graded = row.ended if outcome.complete or row.ended != "ok" else "incomplete"
            if missed := [test.number for test in outcome.tests if not test.judged]:
                graded += f"; look at test {', '.join(missed)}: the grader failed there"
            notes = " | ".join(outcome.notes)
            found = {(test.number, test.name): rounded(test.score) for test in outcome.tests}
            cells[1:] = [row.final, total(outcome.tests, of="max_score"), graded]
            cells += [row.submission, outcome.sandbox_level, notes]
            if by_rules:
                off[0] = total(outcome.tests)
            cells += [*off, *(found.get(test, "") for test in tests)]
        else:
            cells += [*off, *([""] * len(tests))]
        writer.writerow([cell if isinstance(cell, float) else safe_cell(cell) for cell in cells])
    return buffer.getvalue()


def write_gradebook(rows: Sequence[GradebookRow], path: Path) -> None:
    """Write :func:`gradebook_csv`, all of it or nothing.

    Raises:
        StorageError: the file cannot be written.
    """
    # With the mark by which a spreadsheet knows UTF-8.
    content = gradebook_csv(rows).encode("utf-8-sig")
    write_atomically(path, lambda file: file.write(content))


def write_folders(folders: Mapping[str, str], path: Path) -> None:
    """Which folder of the results is whose, by student: for the staff.

    Raises:
        StorageError: the file cannot be written.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, quoting=csv.QUOTE_ALL, lineterminator="\r\n")
    writer.writerows([("student", "folder"), *((safe_cell(name), place) for name, place in folders.items())])
    write_atomically(path, lambda file: file.write(buffer.getvalue().encode("utf-8-sig")))


def from_safe_cell(cell: str) -> str:
    """The text of a cell that :func:`safe_cell` wrote, but for blanks and control characters."""
    return cell[1:] if cell.startswith("'") and cell[1:].lstrip().startswith(_FORMULA) else cell


def safe_cell(text: str) -> str:
    """A text cell that no spreadsheet runs: an apostrophe goes before what would begin a formula.

    Line ends and tabs become blanks, because a cell is cut at them when it is pasted.
    """
    starts = text.startswith(_FORMULA) or text.lstrip().startswith(_FORMULA)
    flat = " ".join(clean(text).split())
    return f"'{flat}" if starts else flat
