"""The commands around a class: exit codes, files, and what is printed."""

from __future__ import annotations

import csv
import json
import sys
import zipfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.grading.results.outcome import save_outcome
from tests.grading import toy_assignment
from tests.grading.outcomes import SECRETS, example
from tests.grading.toy_assignment import SOLUTION

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
RUNNER = CliRunner()


def test_a_class_is_graded_and_summarised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))
    monkeypatch.setenv("SLAMCMP_GRADING_SECRET", "0123456789abcdef")
    (tmp_path / "class").mkdir()
    (tmp_path / "class" / "ada.py").write_text(SOLUTION)
    (tmp_path / "class" / "bob.py").write_text(SOLUTION.replace("x / 2.0", "x / 3.0"))
    folder = toy_assignment.write(tmp_path)
    words = ["grade-all", str(folder), str(tmp_path / "class"), "--out", str(tmp_path / "out")]
    first = RUNNER.invoke(app, [*words, "--accept-weak-sandbox", "--jobs", "2"])
    assert first.exit_code == 0, first.output
    assert "2 of 2 graded (0 from earlier runs)" in first.output
    assert "median 83.3, mean 83.3" in first.output
    assert "2 Half: 1 submission, 50 % of its points" in first.output
    second = RUNNER.invoke(app, [*words, "--accept-weak-sandbox", "--json"])
    assert second.exit_code == 0, second.output
    summary = json.loads(second.output)
    assert summary["endings"] == {"ok": 2}
    assert summary["histogram"] == [0, 0, 0, 0, 0, 0, 1, 0, 0, 1]
    assert summary["left_out"] == []
    with (tmp_path / "out/folders.csv").open(encoding="utf-8-sig", newline="") as file:
        folders = {row["student"]: row["folder"] for row in csv.DictReader(file)}
    assert set(folders) == {"ada", "bob"}
    feedback = (tmp_path / "out" / folders["bob"] / "feedback.html").read_text()
    assert "0 of 10 calls of half are right" in feedback
    assert "SECRET-SQUARE" not in feedback


def test_a_short_secret_is_refused_before_anything_is_graded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMCMP_GRADING_SECRET", "short")
    folder = toy_assignment.write(tmp_path)
    found = RUNNER.invoke(app, ["grade-all", str(folder), str(tmp_path), "--out", str(tmp_path / "out")])
    assert "at least 16" in str(found.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("kind", "start"),
    [
        ("html", "<!DOCTYPE html>"),
        ("junit", "<?xml"),
        ("gradescope", '{\n "score": 29.3456'),
        ("prairielearn", "{"),
    ],
)
def test_a_grade_is_exported_for_its_student(tmp_path: Path, kind: str, start: str) -> None:
    save_outcome(example(), tmp_path / "outcome.json")
    words = ["grade-export", str(tmp_path / "outcome.json"), "--format", kind, "--out", str(tmp_path / "out")]
    assert RUNNER.invoke(app, words).exit_code == 0
    text = (tmp_path / "out").read_text()
    assert text.startswith(start)
    assert [secret for secret in SECRETS if secret in text] == []


def test_staff_export_what_is_hidden(tmp_path: Path) -> None:
    save_outcome(example(), tmp_path / "outcome.json")
    words = ["grade-export", str(tmp_path / "outcome.json"), "--format", "junit", "--for", "staff"]
    assert RUNNER.invoke(app, [*words, "--out", str(tmp_path / "out")]).exit_code == 0
    assert "HIDDEN-MESSAGE" in (tmp_path / "out").read_text()


def test_the_bundle_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMCMP_GRADING_SECRET", "0123456789abcdef")
    folder = toy_assignment.write(tmp_path)
    found = RUNNER.invoke(app, ["gradescope-bundle", str(folder), "-o", str(tmp_path / "a.zip")])
    assert found.exit_code == 0, found.output
    settings = json.loads(zipfile.ZipFile(tmp_path / "a.zip").read("settings.json"))
    assert settings == {"assignment": "toy", "time_limit_s": 540, "accept_weak_sandbox": False}
