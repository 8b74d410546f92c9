"""The results folder of a class run, read again."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

from slamcmp.errors import DataError, MissingDataError
from slamcmp.grading.results.gradebook import GradebookRow, from_safe_cell
from slamcmp.grading.results.outcome import load_outcome


def read_class(folder: Path) -> list[GradebookRow]:
    """A row for every student of ``folders.csv``; who has no grade yet is pending.

    Raises:
        MissingDataError: it is no results folder of a class.
        DataError: a table or an outcome cannot be read, or outcomes are of two versions of the assignment.
    """
    if not (folder / "folders.csv").is_file():
        raise MissingDataError(f"{folder}: is no results folder of `slamcmp grade-all` (no folders.csv)")
    handed_in = _handed_in(folder / "gradebook.csv")
    rows = []
    for cells in _table(folder / "folders.csv", "student", "folder"):
        student, place = from_safe_cell(cells["student"]), folder / cells["folder"]
        if folder.resolve() not in place.resolve().parents:
            raise DataError(f"{folder / 'folders.csv'}: {cells['folder']!r} is no folder of these results")
        if not (place / "outcome.json").is_file():
            rows.append(GradebookRow(student, handed_in.get(student, ""), "pending", None))
            continue
        outcome = load_outcome(place / "outcome.json")
        rows.append(GradebookRow(outcome.student, handed_in.get(student, ""), _ended(place), outcome))
    if not rows:
        raise MissingDataError(f"{folder}: nobody stands in folders.csv")
    versions = {row.outcome.assignment_digest for row in rows if row.outcome is not None}
    if len(versions) > 1:
        raise DataError(
            f"{folder}: outcomes of {len(versions)} versions of the assignment; let `slamcmp grade-all` end"
        )
    return rows


def _table(path: Path, *columns: str) -> list[dict[str, str]]:
    """The rows of a CSV that a class run wrote, with these columns at least."""
    try:
        reader = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline=""), strict=True)
        rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read ({error}); run `slamcmp grade-all` again") from error
    if set(columns) - set(reader.fieldnames or ()) or any(
        None in row or None in row.values() for row in rows
    ):
        raise DataError(
            f"{path}: is no table with columns {', '.join(columns)}; run `slamcmp grade-all` again"
        )
    return rows


def _handed_in(gradebook: Path) -> dict[str, str]:
    """Of each student the name of what was handed in."""
    if not gradebook.is_file():
        return {}
    return {
        from_safe_cell(row["student"]): from_safe_cell(row["submission"])
        for row in _table(gradebook, "student", "submission")
    }


def _ended(place: Path) -> str:
    try:
        return str(json.loads((place / "done.json").read_text(encoding="utf-8"))["ended"])
    except (OSError, ValueError, KeyError, TypeError):
        # Written after the outcome: the run was stopped in between.
        return "pending"
