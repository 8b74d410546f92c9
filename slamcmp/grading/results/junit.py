"""JUnit XML, which every continuous-integration service reads: for staff, or for a student's own pipeline."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Literal

from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, TestStatus
from slamcmp.grading.results.student_view import STATUS_WORDS, clean, opening, points, visible_tests
from slamcmp.support.files.atomic import write_atomically

Audience = Literal["student", "staff"]

_ELEMENT: dict[TestStatus, str] = {
    "partial": "failure",
    "failed": "failure",
    "error": "error",
    "timed_out": "error",
    "skipped": "skipped",
}


def junit_xml(outcome: GradeOutcome, *, audience: Audience) -> bytes:
    """The outcome as one test suite; a student gets the visible tests, staff all of them with details."""
    tests = outcome.tests if audience == "staff" else visible_tests(outcome)
    elements = [_ELEMENT.get(test.status, "") for test in tests]
    suite = ElementTree.Element(
        "testsuite",
        name=clean(outcome.assignment),
        tests=str(len(tests)),
        failures=str(elements.count("failure")),
        errors=str(elements.count("error")),
        skipped=str(elements.count("skipped")),
        time=_seconds(math.fsum(test.seconds for test in tests)),
    )
    for test, element in zip(tests, elements, strict=True):
        _case(suite, test, element, outcome.assignment, audience)
    ElementTree.SubElement(suite, "system-out").text = clean(opening(outcome))
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def write_junit_xml(outcome: GradeOutcome, path: Path, *, audience: Audience) -> None:
    """Write :func:`junit_xml`.

    Raises:
        StorageError: the file cannot be written.
    """
    content = junit_xml(outcome, audience=audience)
    write_atomically(path, lambda file: file.write(content))


def _case(
    suite: ElementTree.Element, test: TestOutcome, element: str, assignment: str, audience: Audience
) -> None:
    case = ElementTree.SubElement(
        suite,
        "testcase",
        classname=clean(f"{assignment}.{test.kind}"),
        name=clean(f"{test.number} {test.name}"),
        time=_seconds(test.seconds),
    )
    summary = f"{STATUS_WORDS[test.status]}: {points(test.score)} of {points(test.max_score)} points"
    if element:
        fault = ElementTree.SubElement(case, element, message=summary, type=test.status)
        fault.text = clean(test.message)
    else:
        ElementTree.SubElement(case, "system-out").text = f"{summary}\n{clean(test.message)}".rstrip()
    if audience == "staff" and test.staff_detail:
        ElementTree.SubElement(case, "system-err").text = clean(test.staff_detail)


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "0"
