"""Grades by other rules, from what is known already: points of tests, late hand-ins, attempts.

``rules.yaml`` has three keys, all optional::

    points: {Update: 30, Speed: 0}          # of a test; the others keep theirs
    late: {percent_per_day: 10, grace_h: 1, most_percent: 50}
    attempts: {free: 3, percent_each: 5, most_percent: 20}

and ``submitted.csv`` a row a student: ``student,late_h,attempts``. A day that has begun counts whole. Both
deductions are percents of the points earned, add up, and never take more than all of them. A student without
a row was in time.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.grading.results.gradebook import GradebookRow, safe_cell
from slamcmp.grading.results.outcome import GradeOutcome
from slamcmp.grading.results.student_view import clean
from slamcmp.registry import did_you_mean
from slamcmp.support.configuration.config_errors import ConfigErrors
from slamcmp.support.configuration.yaml_source import KeyPath, load_yaml

COLUMNS = ("student", "late_h", "attempts")


class LateFields(BaseModel):
    """What a late hand-in costs."""

    model_config = ConfigDict(extra="forbid")

    percent_per_day: float = Field(ge=0, le=100)
    grace_h: float = Field(0, ge=0)
    most_percent: float = Field(100, ge=0, le=100)


class AttemptFields(BaseModel):
    """What many attempts cost."""

    model_config = ConfigDict(extra="forbid")

    free: int = Field(ge=1)
    percent_each: float = Field(ge=0, le=100)
    most_percent: float = Field(100, ge=0, le=100)


class RulesFields(BaseModel):
    """The keys of ``rules.yaml``."""

    model_config = ConfigDict(extra="forbid")

    points: dict[str, float] = Field(default_factory=dict)
    late: LateFields | None = None
    attempts: AttemptFields | None = None


@dataclass(frozen=True)
class Submitted:
    """When a student handed in, and the how many-th time."""

    late_h: float = 0.0
    attempts: int = 1
    told: frozenset[str] = frozenset()
    """The columns of the table that say so."""


def load_rules(path: Path, tests: Sequence[str]) -> RulesFields:
    """Read and check rules for an assignment with these tests.

    Raises:
        MissingDataError: there is no such file.
        ConfigError: a key is unknown, a value not allowed, or no test has such a name; with its place.
    """
    source = load_yaml(path)
    errors = ConfigErrors(source)
    rules = RulesFields()
    try:
        rules = RulesFields.model_validate_json(json.dumps(source.data, default=str), strict=True)
    except ValidationError as error:
        known: dict[KeyPath, Any] = {
            (): RulesFields.model_fields,
            ("late",): LateFields.model_fields,
            ("attempts",): AttemptFields.model_fields,
        }
        errors.add_pydantic(error.errors(), (), known)
    for name, points in rules.points.items():
        if name not in tests:
            errors.add(("points", name), f"no test is called {name!r}{did_you_mean(name, tests)}", key=True)
        elif tests.count(name) > 1:
            errors.add(("points", name), f"{tests.count(name)} tests are called {name!r}", key=True)
        elif not (math.isfinite(points) and points >= 0):
            errors.add(("points", name), "points are a number from 0 on")
    errors.raise_if_any()
    return rules


def load_submitted(path: Path, students: Sequence[str]) -> dict[str, Submitted]:
    """Read when students handed in.

    Raises:
        MissingDataError: there is no such file.
        DataError: a row cannot be used; the message names its line, and what would be right.
    """
    known = {safe_cell(student): student for student in students} | {each: each for each in students}
    try:
        text = path.read_text(encoding="utf-8-sig")
        lines, rows = _rows(text)
    except OSError as error:
        raise MissingDataError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is no UTF-8 text") from error
    except csv.Error as error:
        raise DataError(f"{path}: is no CSV ({error})") from error
    header = [name.strip() for name in rows[0]] if rows else []
    if "student" not in header or set(header) - set(COLUMNS) or len(set(header)) < len(header):
        found = ", ".join(header) or "nothing"
        raise DataError(
            f"{path}:1: columns are {', '.join(COLUMNS)} (the last two as needed); found: {found}"
        )
    submitted: dict[str, Submitted] = {}
    for line, cells in zip(lines[1:], rows[1:], strict=True):
        where = f"{path}:{line}"
        if len(cells) != len(header):
            raise DataError(f"{where}: {len(cells)} cells where the first line has {len(header)}")
        row = dict(zip(header, cells, strict=True))
        student = known.get(row["student"].strip())
        if student is None:
            name = clean(row["student"].strip())
            raise DataError(f"{where}: nobody is called {name!r}{did_you_mean(name, students)}")
        if student in submitted:
            raise DataError(f"{where}: {clean(student)!r} stands above already")
        submitted[student] = Submitted(
            _number(row.get("late_h", ""), where, "late_h", 0.0, whole=False),
            int(_number(row.get("attempts", ""), where, "attempts", 1.0, whole=True)),
            frozenset(header) - {"student"},
        )
    if not submitted:
        raise DataError(f"{path}: holds no student")
    return submitted


def _rows(text: str) -> tuple[list[int], list[list[str]]]:
    """Rows of a CSV that are not blank, and the line in which each begins."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    lines, rows = [], []
    begins = 1
    for cells in reader:
        if any(cell.strip() for cell in cells):
            lines.append(begins)
            rows.append(cells)
        begins = reader.line_num + 1
    return lines, rows


def deduction(rules: RulesFields, submitted: Submitted) -> float:
    """Percent of the points earned that are taken off, 0 to 100."""
    off = 0.0
    if rules.late is not None:
        over_h = submitted.late_h - rules.late.grace_h
        # What was written as 25.1 h with 1.1 h of grace is one day, whatever floats make of the difference.
        days = max(0, math.ceil(over_h / 24.0 - 1e-9))
        off += min(rules.late.most_percent, days * rules.late.percent_per_day)
    if rules.attempts is not None:
        more = max(0, submitted.attempts - rules.attempts.free)
        off += min(rules.attempts.most_percent, more * rules.attempts.percent_each)
    return min(100.0, off)


def reweighted(outcome: GradeOutcome, points: Mapping[str, float]) -> GradeOutcome:
    """The same shares of other points.

    Raises:
        UsageError: a test that was worth nothing is to be worth something, and nobody knows what was earned.
    """
    tests = []
    for test in outcome.tests:
        new = points.get(test.name, test.max_score)
        if test.max_score == 0 and new > 0:
            raise UsageError(
                f"test {test.name!r} was graded with 0 points, so what was earned is not known: grade again"
            )
        share = test.score / test.max_score if test.max_score > 0 else 0.0
        tests.append(replace(test, score=share * new, max_score=new))
    return replace(outcome, tests=tuple(tests))


def regraded(
    rows: Sequence[GradebookRow], rules: RulesFields, submitted: Mapping[str, Submitted]
) -> list[GradebookRow]:
    """The same rows by the rules, with what was taken off.

    Raises:
        UsageError: the rules and the table do not fit together, or leave nothing to earn.
    """
    told = frozenset().union(*(each.told for each in submitted.values()))
    by_column = {"late_h": ("late", rules.late), "attempts": ("attempts", rules.attempts)}
    for column, (key, rule) in by_column.items():
        if column in told and rule is None:
            raise UsageError(f"the table tells {column}, and no rule uses it: give rules with {key}")
        if rule is not None and column not in told:
            raise UsageError(f"the rules have {key}, and no table tells {column}: give one with this column")
    new = []
    for row in rows:
        outcome = None if row.outcome is None else reweighted(row.outcome, rules.points)
        if outcome is not None and outcome.complete and outcome.max_score == 0:
            raise UsageError("by these rules no test is worth anything")
        off = None if not told else deduction(rules, submitted.get(row.student, Submitted()))
        new.append(replace(row, outcome=outcome, deducted_percent=off))
    return new


def _number(text: str, where: str, column: str, least: float, *, whole: bool) -> float:
    if not text.strip():
        return least
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value < least or (whole and value != int(value)):
        wanted = f"a whole number from {least:g} on" if whole else f"hours, a number from {least:g} on"
        raise DataError(f"{where}: {column} {text.strip()!r}: {wanted} is needed")
    return value
