"""Who handed in what: distinct entries are distinct students, and what is hidden is told."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.hand_in.class_folder import find_submissions


def students(folder: Path, *names: str) -> list[str]:
    for name in names:
        (folder / name).write_text("")
    found = find_submissions(folder).submitted
    assert len({entry.folder for entry in found}) == len({entry.student for entry in found}) == len(names)
    return [entry.student for entry in found]


def test_students_are_told_apart_and_their_folders_are_harmless(tmp_path: Path) -> None:
    for name in ("ada.py", "ada.zip", "bob.ipynb", "..odd.py", "a b.py", "a?b.py", ".hidden.py", "Thumbs.db"):
        (tmp_path / name).write_text("")
    (tmp_path / "eve.py").mkdir()
    (tmp_path / os.fsdecode(b"\xff.py")).write_text("")
    found = find_submissions(tmp_path).submitted
    assert {entry.student for entry in found} == {"ada.py", "ada.zip", "bob", "a b", "a?b", "eve.py", "\\xff"}
    folders = [entry.folder for entry in found]
    assert len(set(folders)) == len(folders)
    assert all(set(folder) <= set("abcdefghijklmnopqrstuvwxyz0123456789._-") for folder in folders)


def test_a_folder_without_submissions_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="holds no submissions"):
        find_submissions(tmp_path)
    with pytest.raises(MissingDataError, match="cannot be read"):
        find_submissions(tmp_path / "absent")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["ada.py", "ada.py.py", "ada.zip"], ["ada.py", "ada.py.py", "ada.zip"]),
        (["ada.py", "ada.py.py"], ["ada", "ada.py"]),
        (["a.py", "a.py.py", "a.py.py.py", "a.zip"], ["a.py", "a.py.py", "a.py.py.py", "a.zip"]),
        (["Bob.zip", "bob.py"], ["Bob.zip", "bob.py"]),
        (["zo\u00eb.py", "zoe\u0308.zip"], ["zo\u00eb.py", "zoe\u0308.zip"]),
        (["\x1b[2Jeve.py", "\\x1b[2Jeve.zip"], ["\\x1b[2Jeve.py", "\\x1b[2Jeve.zip"]),
    ],
)
def test_distinct_entries_are_distinct_students(
    tmp_path: Path, names: list[str], expected: list[str]
) -> None:
    assert sorted(students(tmp_path, *names)) == sorted(expected)


@pytest.mark.parametrize(
    "names",
    [
        ["Ada.py", "ada.py"],
        ["zo\u00eb.py", "zoe\u0308.py"],
        ["stra\u00dfe.py", "STRASSE.py"],
        ["ﬁ.zip", "fi.zip", "bob.py"],
        ["\x07.py", "\\x07.py"],
    ],
)
def test_entries_that_may_be_one_students_are_refused(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        (tmp_path / name).write_text("")
    with pytest.raises(UsageError, match="differ only in case or in how their letters are encoded") as caught:
        find_submissions(tmp_path)
    assert "bob" not in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_name_that_spells_anothers_folder_gets_its_own(tmp_path: Path) -> None:
    (tmp_path / "a?b.py").write_text("")
    (first,) = find_submissions(tmp_path).submitted
    assert len(students(tmp_path, f"{first.folder}.py", "a?b.py")) == 2


def test_folders_cannot_be_told_without_the_token(tmp_path: Path) -> None:
    (tmp_path / "ada.py").write_text("")
    folders = {find_submissions(tmp_path, token).submitted[0].folder for token in (b"", b"a", b"b", b"a")}
    assert len(folders) == 3
    assert all(folder.startswith("ada-") and len(folder) == 24 for folder in folders)


def test_hidden_entries_are_told(tmp_path: Path) -> None:
    (tmp_path / "__MACOSX").mkdir()
    assert students(tmp_path, "bob.py") == ["bob"]
    for name in (".ada.py", "._bob.py", "Thumbs.db", ".\x1b[2J"):
        (tmp_path / name).write_text("")
    assert find_submissions(tmp_path).left_out == (
        ".\\x1b[2J",
        "._bob.py",
        ".ada.py",
        "Thumbs.db",
        "__MACOSX",
    )
    (tmp_path / "bob.py").unlink()
    with pytest.raises(UsageError, match=r"holds no submissions.*left out: .*\.ada\.py"):
        find_submissions(tmp_path)
