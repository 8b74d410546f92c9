"""Gradescope's ``results.json``.

Gradescope hides the total as long as one test is not visible to the student, so a test's visibility decides
about more than its own text. Nothing that only the staff may see is written, whatever the visibility says:
staff read it on the autograder's standard output, which Gradescope shows to them alone.
"""

from __future__ import annotations

import html
import json
import math
from pathlib import Path
from typing import Any

from slamcmp.grading.results.images import data_uri
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, TestStatus
from slamcmp.grading.results.student_view import (
    STATUS_WORDS,
    clean,
    opening,
    rounded,
    total,
    without_staff_detail,
)
from slamcmp.support.files.atomic import write_atomically

_STATUS: dict[TestStatus, str] = {"passed": "passed"}
"""Gradescope knows passed and failed only; partial credit counts as failed there."""


def gradescope_results(outcome: GradeOutcome, *, images: bool = True) -> dict[str, Any]:
    """The outcome as Gradescope reads it; ``images`` puts plots beside the numbers."""
    tests = [without_staff_detail(test) for test in outcome.tests]
    return {
        "score": total(tests),
        "execution_time": round(outcome.seconds, 1) if math.isfinite(outcome.seconds) else 0,
        "output": opening(outcome),
        "output_format": "text",
        "test_name_format": "text",
        "visibility": "visible",
        "stdout_visibility": "hidden",
        "tests": [_test(test, images=images) for test in tests],
        "leaderboard": [
            {"name": clean(name), "value": value, "order": order}
            for name, value, order in outcome.leaderboard
            if math.isfinite(value)
        ],
        "extra_data": {
            "assignment": outcome.assignment,
            "assignment_digest": outcome.assignment_digest,
            "submission_digest": outcome.submission_digest,
            "complete": outcome.complete,
            "sandbox_level": outcome.sandbox_level,
            "versions": dict(outcome.versions),
        },
    }


def write_gradescope_results(outcome: GradeOutcome, path: Path, *, images: bool = True) -> None:
    """Write ``results.json``, all of it or nothing.

    Raises:
        StorageError: the file cannot be written.
    """
    text = json.dumps(gradescope_results(outcome, images=images), indent=1, allow_nan=False)
    write_atomically(path, lambda file: file.write(text.encode()))


def _test(test: TestOutcome, *, images: bool) -> dict[str, Any]:
    text = clean(test.message)
    result: dict[str, Any] = {
        "score": rounded(test.score),
        "max_score": rounded(test.max_score),
        "status": _STATUS.get(test.status, "failed"),
        "name": clean(test.name),
        "number": test.number,
        "output": text,
        "output_format": "text",
        "tags": [test.kind] if test.kind else [],
        "visibility": test.visibility,
    }
    if test.visibility != "hidden" and test.status not in ("passed", "failed"):
        result["output"] = f"{STATUS_WORDS[test.status]}\n{text}".strip()
    if images and test.plots:
        result["output_format"] = "html"
        result["output"] = f"<pre>{html.escape(result['output'])}</pre>" + "".join(
            f'<p>{html.escape(clean(plot.caption))}</p><img alt="{html.escape(clean(plot.title))}" '
            f'src="{data_uri(plot, "png")}">'
            for plot in test.plots
        )
    return result
