"""``slamcmp grade`` as a user meets it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.assignment.handout import SHIPPED

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
STARTER = str(SHIPPED / "kalman_filter" / "starter.py")


@pytest.fixture
def secret(tmp_path: Path) -> str:
    path = tmp_path / "secret.txt"
    path.write_text("a secret of the tests\n")
    return str(path)


def test_scores_files_and_exit_code(tmp_path: Path, secret: str) -> None:
    page = tmp_path / "grade.html"
    arguments = ["grade", "kalman_filter", STARTER, "--student", "ada", "--secret-file", secret]
    files = ["--out", str(tmp_path / "grade.json"), "--html", str(page)]
    result = CliRunner().invoke(app, [*arguments, *files, "--json", "--accept-weak-sandbox"])
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert (told["student"], told["score"], told["max_score"]) == ("ada", 0, 100)
    assert json.loads((tmp_path / "grade.json").read_text())["tests"] == told["tests"]
    assert "predict is not implemented yet" in page.read_text()
    # Of a test that is shown later the student's page says nothing.
    assert "Not implemented yet (run_filter)" in result.stdout
    assert "Not implemented yet (run_filter)" not in page.read_text()


def test_without_a_secret_nothing_is_graded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLAMCMP_GRADING_SECRET", raising=False)
    result = CliRunner().invoke(app, ["grade", "kalman_filter", STARTER])
    assert isinstance(result.exception, UsageError)
    assert "--secret-file" in str(result.exception)


def test_an_unknown_assignment_is_answered_with_the_known_ones(secret: str) -> None:
    result = CliRunner().invoke(app, ["grade", "kalman", STARTER, "--secret-file", secret])
    assert isinstance(result.exception, MissingDataError)
    assert result.exception.exit_code == 3
    assert "did you mean 'kalman_filter'" in str(result.exception)
