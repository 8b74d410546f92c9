"""One grade as one HTML file that needs no network, no server and no other file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jinja2

from slamcmp.grading.results.images import curves_of, data_uri
from slamcmp.grading.results.junit import Audience
from slamcmp.grading.results.outcome import GradeOutcome, Plot, TestOutcome
from slamcmp.grading.results.student_view import STATUS_WORDS, clean, opening, points, total, visible_tests
from slamcmp.grading.sandbox.walls.proofs import MEANING
from slamcmp.support.files.atomic import write_atomically


@dataclass(frozen=True)
class _Figure:
    title: str
    source: str
    caption: str
    where: str


@dataclass(frozen=True)
class _Row:
    number: str
    name: str
    kind: str
    status: str
    words: str
    score: str
    max_score: str
    share: float
    visibility: str
    message: str
    staff_detail: str
    seconds: str
    figures: tuple[_Figure, ...]


def write_grade_page(outcome: GradeOutcome, path: Path, *, audience: Audience) -> None:
    """Write :func:`grade_page`.

    Raises:
        StorageError: the file cannot be written.
    """
    content = grade_page(outcome, audience=audience).encode()
    write_atomically(path, lambda file: file.write(content))


def grade_page(outcome: GradeOutcome, *, audience: Audience) -> str:
    """The page as text; a student's holds the visible tests alone, and the total only if all are visible."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slamcmp.grading.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    shown = visible_tests(outcome)
    staff = audience == "staff"
    tests = outcome.tests if staff else shown
    return environment.get_template("grade.html.j2").render(
        assignment=clean(outcome.assignment),
        student=clean(outcome.student),
        staff=staff,
        opening=opening(outcome).splitlines(),
        complete=outcome.complete,
        score=points(total(outcome.tests)) if staff or len(shown) == len(outcome.tests) else "",
        max_score=points(total(outcome.tests, of="max_score")),
        tests=[_row(test) for test in tests],
        sandbox_level=outcome.sandbox_level,
        proofs=[
            (MEANING.get(name, clean(name)), clean(proof)) for name, proof in sorted(outcome.proofs.items())
        ],
        facts=[
            ("Assignment digest", outcome.assignment_digest),
            ("Submission digest", outcome.submission_digest),
            ("Time of grading [s]", f"{outcome.seconds:.1f}"),
            *sorted((clean(name), clean(version)) for name, version in outcome.versions.items()),
        ],
    )


def _row(test: TestOutcome) -> _Row:
    share = test.score / test.max_score if test.max_score > 0 else float(test.status == "passed")
    return _Row(
        number=clean(test.number),
        name=clean(test.name),
        kind=clean(test.kind),
        status=test.status,
        words=STATUS_WORDS[test.status],
        score=points(test.score),
        max_score=points(test.max_score),
        share=100.0 * min(1.0, max(0.0, share)),
        visibility=test.visibility.replace("_", " "),
        message=clean(test.message),
        staff_detail=clean(test.staff_detail),
        seconds=f"{test.seconds:.2f}",
        figures=tuple(_figure(plot) for plot in test.plots),
    )


def _figure(plot: Plot) -> _Figure:
    # Loading matplotlib takes longer than a page without figures.
    from slamcmp.report.figures.grades import outside_text

    where = outside_text(clean(plot.x_label), plot.x, curves_of(plot))
    return _Figure(clean(plot.title), data_uri(plot, "svg"), clean(plot.caption), where)
