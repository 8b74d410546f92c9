"""A class as one HTML page for the staff: no network, no script, no other file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from slamcmp.grading.results.class_statistics import (
    Cluster,
    NamedMistake,
    TestStatistics,
    causes_recorded,
    clusters,
    named_mistakes,
    test_statistics,
)
from slamcmp.grading.results.class_summary import BINS, ClassSummary, summarise
from slamcmp.grading.results.gradebook import GradebookRow
from slamcmp.grading.results.student_view import clean, points
from slamcmp.support.files.atomic import write_atomically

DISCRIMINATES = 0.2
"""Item-rest correlation below which a test tells little about the rest, by the usual rule of thumb."""
EASY, HARD = 0.95, 0.30


@dataclass(frozen=True)
class _Bar:
    label: str
    count: int
    height: float
    """Of the highest [%]."""


@dataclass(frozen=True)
class _Test:
    name: str
    points: str
    full: str
    mean: str
    share: float
    discrimination: str
    remark: str


def write_class_page(rows: Sequence[GradebookRow], path: Path) -> None:
    """Write :func:`class_page`.

    Raises:
        StorageError: the file cannot be written.
    """
    content = class_page(rows).encode()
    write_atomically(path, lambda file: file.write(content))


def class_page(rows: Sequence[GradebookRow]) -> str:
    """The page as text: distribution, every test, named mistakes, and who answers alike."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slamcmp.grading.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    summary = summarise(rows)
    outcomes = [row.outcome for row in rows if row.outcome is not None]
    mistakes: tuple[NamedMistake, ...] = named_mistakes(rows)
    alike: tuple[Cluster, ...] = clusters(rows)
    return environment.get_template("class.html.j2").render(
        assignment=clean(outcomes[0].assignment) if outcomes else "A class",
        summary=summary,
        figures=_figures(summary),
        bars=_bars(summary),
        tests=[_told(test) for test in test_statistics(rows)],
        mistakes=mistakes,
        recorded=causes_recorded(rows),
        alike=alike,
        deducted=sum(bool(row.deducted_percent) for row in rows),
        by_rules=any(row.deducted_percent is not None for row in rows),
        unfinished=sorted(clean(row.student) for row in rows if row.ended != "ok"),
    )


def _figures(summary: ClassSummary) -> list[tuple[str, str]]:
    """What stands in large figures on top."""
    told = [("graded", f"{summary.graded} of {summary.submissions}")]
    if summary.quartiles is not None and summary.mean is not None:
        low, lower, middle, upper, high = summary.quartiles
        told += [
            ("median", f"{middle:.0f} %"),
            ("mean", f"{summary.mean:.0f} %"),
            ("middle half", f"{lower:.0f} to {upper:.0f} %"),
            ("range", f"{low:.0f} to {high:.0f} %"),
        ]
    return told


def _bars(summary: ClassSummary) -> list[_Bar]:
    most = max(summary.histogram, default=0)
    width = 100 // BINS
    return [
        _Bar(f"{index * width}–{(index + 1) * width}", count, 100.0 * count / most if most else 0.0)
        for index, count in enumerate(summary.histogram)
    ]


def _told(test: TestStatistics) -> _Test:
    remarks = []
    if test.mean_share >= EASY:
        remarks.append("nearly everybody can")
    if test.mean_share <= HARD:
        remarks.append("hard")
    if test.discrimination is not None and test.discrimination < 0:
        remarks.append("those who are good at the rest lose here: look at the test")
    elif test.discrimination is not None and test.discrimination < DISCRIMINATES:
        remarks.append("tells little about the rest")
    return _Test(
        name=test.name,
        points=points(test.points),
        full=f"{test.full} of {test.submissions}",
        mean=f"{100 * test.mean_share:.0f} %",
        share=100 * test.mean_share,
        discrimination="–" if test.discrimination is None else f"{test.discrimination:.2f}",
        remark="; ".join(remarks),
    )
