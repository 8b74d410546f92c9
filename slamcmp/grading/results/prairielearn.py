"""PrairieLearn's ``results.json``: a score between 0 and 1, and at most 1 MB.

PrairieLearn shows a student every test in the file and has no visibilities, so tests that are not visible
are left out of the list. They count in the score, which is shown at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from slamcmp.grading.results.images import data_uri
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome
from slamcmp.grading.results.student_view import (
    STATUS_WORDS,
    TEXT_MAX,
    clean,
    opening,
    rounded,
    total,
    visible_tests,
)
from slamcmp.support.files.atomic import write_atomically

BYTES_MAX = 1_000_000
"""Of the file; a larger one is refused with the score in it."""
_TEXT_MIN = 100


def prairielearn_results(outcome: GradeOutcome, *, images: bool = True) -> dict[str, Any]:
    """The outcome as PrairieLearn reads it, within :data:`BYTES_MAX`: plots go first, then long messages."""
    possible = total(outcome.tests, of="max_score")
    fraction = total(outcome.tests) / possible if possible else 0.0
    shown = visible_tests(outcome)
    results: dict[str, Any] = {
        "gradable": True,
        "score": min(1.0, max(0.0, fraction)),
        "message": opening(outcome),
        "tests": [_test(test) for test in shown],
    }
    room = BYTES_MAX - len(encoded(results))
    if room < 0:
        _shorten(results)
        return results
    for test, entry in zip(shown, results["tests"], strict=True):
        for plot in test.plots if images else ():
            image = {"label": clean(plot.title), "url": data_uri(plot, "png")}
            room -= len(encoded({"images": [image]}))
            if room < 0:
                return results
            entry.setdefault("images", []).append(image)
    return results


def write_prairielearn_results(outcome: GradeOutcome, path: Path, *, images: bool = True) -> None:
    """Write ``results.json``, all of it or nothing.

    Raises:
        StorageError: the file cannot be written.
    """
    content = encoded(prairielearn_results(outcome, images=images))
    write_atomically(path, lambda file: file.write(content))


def encoded(results: dict[str, Any]) -> bytes:
    """As it is written."""
    return json.dumps(results, allow_nan=False).encode()


def _shorten(results: dict[str, Any]) -> None:
    """Cut the longest messages first; only then leave out tests, of which no page can show so many."""
    longest = TEXT_MAX
    while len(encoded(results)) > BYTES_MAX:
        longest //= 2
        for test in results["tests"]:
            test["output"] = test["output"][:longest]
        if longest < _TEXT_MIN:
            del results["tests"][len(results["tests"]) // 2 :]


def _test(test: TestOutcome) -> dict[str, Any]:
    return {
        "name": f"{test.number} {clean(test.name)}",
        "points": rounded(test.score),
        "max_points": rounded(test.max_score),
        "message": STATUS_WORDS[test.status],
        "output": clean(test.message),
    }
