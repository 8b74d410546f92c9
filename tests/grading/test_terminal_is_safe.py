"""Nothing that a submission says or is called reaches a terminal, a log or a table as a control character."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from slamcmp import cli
from slamcmp.cli import app
from slamcmp.grading.hand_in.hand_in import SubmissionError
from slamcmp.grading.sandbox.errors import StudentError
from tests.grading import toy_assignment

EVIL = "\x1b[2J\x1b]0;title\x07\u202e\x9b31m"
SOURCE = f"""
EVIL = {EVIL!r}
print(EVIL)
def double(x):
    print(EVIL)
    raise type('Error' + EVIL, (Exception,), {{}})(EVIL)
def half(x): return EVIL
def square(x): return {{EVIL: x}}
"""


def controls(text: str) -> set[str]:
    return {letter for letter in text if not (letter.isprintable() or letter in "\n\r\t\ufeff")}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))
    monkeypatch.setenv("SLAMCMP_GRADING_SECRET", "0123456789abcdef")
    folder = toy_assignment.write(tmp_path)

    def invoke(command: str, *words: str) -> Result:
        return CliRunner().invoke(app, [command, str(folder), *words, "--accept-weak-sandbox"])

    return invoke


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
def test_a_class_with_escape_sequences_everywhere(tmp_path: Path, run) -> None:  # type: ignore[no-untyped-def]
    lot = tmp_path / "class"
    (lot / f"folder{EVIL}").mkdir(parents=True)
    (lot / f"folder{EVIL}" / f"{EVIL}.py").write_text("")
    (lot / f"eve{EVIL}.py").write_text(SOURCE)
    (lot / f".hidden{EVIL}").write_text("")
    (lot / f"link{EVIL}").symlink_to("/nonexistent")
    (lot / f"text{EVIL}.txt").write_text(EVIL)
    found = run("grade-all", str(lot), "--out", str(tmp_path / "out"))
    assert "4 of 4 graded" in found.output, found.output
    assert "hidden, not graded: .hidden\\x1b[2J" in found.output
    assert controls(found.output) == set()
    written = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert {path.suffix for path in written} >= {".csv", ".html", ".json", ".log"}
    for path in written:
        assert controls(path.read_text(encoding="utf-8")) == set(), path
        assert path.name.isascii()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
def test_one_submission_with_escape_sequences(tmp_path: Path, run) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / f"eve{EVIL}.py"
    path.write_text(SOURCE)
    found = run("grade", str(path), "--student", f"eve{EVIL}")
    assert found.exit_code == 0
    assert "0.00 of 30 points" in found.output
    assert controls(found.output) == set()


def test_errors_of_the_command_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["slamcmp", "grade", "ekf", f"no{EVIL}.py"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "there is no such file or folder to grade" in said
    assert controls(said) == set()


def test_errors_that_quote_a_submission() -> None:
    for error in (SubmissionError(f"{EVIL}: is empty"), StudentError("ValueError", f"{EVIL}\nsecond line")):
        assert controls(str(error)) == set()
