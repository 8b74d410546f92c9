"""``slamcmp check FILE.py``: an assignment's public tests on a student's own machine."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.assignment.description import find_assignment, load_assignment
from slamcmp.grading.assignment.handout import SHIPPED
from slamcmp.grading.assignment.public_tests import run_public_tests

NAMES = sorted(path.parent.name for path in SHIPPED.glob("*/assignment.yaml"))


def handed_out(folder: Path, name: str, source: str) -> Path:
    """A student's folder with their file and the public tests."""
    assignment = load_assignment(find_assignment(name))
    shutil.copy(assignment.folder / "public_tests.py", folder)
    entry = folder / assignment.fields.entry
    entry.write_text(source)
    return entry


@pytest.mark.parametrize("name", NAMES)
def test_the_starter_is_not_implemented(name: str, tmp_path: Path) -> None:
    """That the solution passes them all is the gate's to say (test_assignments.py)."""
    assignment = load_assignment(find_assignment(name))
    starter = (assignment.folder / "starter.py").read_text()
    imported, *findings = run_public_tests(handed_out(tmp_path, name, starter))
    assert imported.passed
    assert len(findings) >= 3
    assert {finding.message for finding in findings} == {"not implemented yet"}


def test_a_mistake_is_told_with_its_place_and_numbers(tmp_path: Path) -> None:
    solution = load_assignment(find_assignment("kalman_filter")).solution_source
    wrong = solution.replace("gain @ innovation", "2 * gain @ innovation")
    findings = run_public_tests(handed_out(tmp_path, "kalman_filter", wrong))
    failed = {finding.check: finding.message for finding in findings if not finding.passed}
    assert list(failed) == ["correct", "run_filter"]
    lines = (tmp_path / "public_tests.py").read_text().splitlines()
    number = next(index for index, line in enumerate(lines, start=1) if "[1.5]" in line)
    assert f"(public_tests.py, line {number})" in failed["correct"]
    assert "3." in failed["correct"]
    assert "kalman_filter" not in sys.modules


def test_what_cannot_be_run_says_why(tmp_path: Path) -> None:
    entry = handed_out(tmp_path, "kalman_filter", "def predict(:\n")
    (finding,) = run_public_tests(entry)
    assert not finding.passed
    assert "SyntaxError" in finding.message
    entry.write_text("def predict(): pass\n")
    (finding,) = run_public_tests(entry)
    assert "cannot import name 'correct'" in finding.message
    other = entry.rename(tmp_path / "my_filter.py")
    with pytest.raises(UsageError, match=r"the tests beside it are of kalman_filter\.py"):
        run_public_tests(other)
    other.rename(entry)
    (tmp_path / "public_tests.py").unlink()
    with pytest.raises(MissingDataError, match=r"no public_tests\.py beside it"):
        run_public_tests(entry)
    with pytest.raises(MissingDataError, match="no such file"):
        run_public_tests(tmp_path / "nothing.py")


def test_as_a_student_calls_it(tmp_path: Path) -> None:
    entry = handed_out(tmp_path, "ekf", (find_assignment("ekf") / "starter.py").read_text())
    command = [sys.executable, "-m", "slamcmp", "check", str(entry), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout)[1] == {
        "check": "motion",
        "passed": False,
        "message": "not implemented yet",
    }
