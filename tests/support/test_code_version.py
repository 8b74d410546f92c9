"""Versions of code follow its text and that of what it imports."""

from __future__ import annotations

from pathlib import Path

from slamcmp.support.code_version import code_version


def test_version_follows_the_neighbours_that_are_imported(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import helper\n")
    (tmp_path / "helper.py").write_text("GATE = 9\n")
    (tmp_path / "other.py").write_text("x = 1\n")
    first = code_version([tmp_path / "mine.py"])
    (tmp_path / "other.py").write_text("x = 22\n")
    assert code_version([tmp_path / "mine.py"]) == first
    (tmp_path / "helper.py").write_text("GATE = 16\n")
    assert code_version([tmp_path / "mine.py"]) != first
