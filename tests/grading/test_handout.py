"""What students get: handouts are whole, nothing is overwritten, and every assignment says how to check."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.assignment.description import find_assignment, load_assignment
from slamcmp.grading.assignment.handout import (
    SHIPPED,
    STAFF_VARIABLE,
    export_staff,
    find_handout,
    handouts,
    read_handout,
    write_handout,
)

NAMES = sorted(path.parent.name for path in SHIPPED.glob("*/assignment.yaml"))


def test_every_assignment_can_be_handed_out() -> None:
    assert list(handouts()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_handout_is_what_the_staff_s_part_grades(name: str, tmp_path: Path) -> None:
    files = write_handout(name, tmp_path / "mine")
    assignment = load_assignment(find_assignment(name))
    handout = find_handout(name)
    assert handout.title == assignment.fields.title
    assert handout.entry == assignment.fields.entry
    mine = tmp_path / "mine" / handout.entry
    assert mine in files
    assert mine.read_text("utf-8") == (assignment.folder / "starter.py").read_text("utf-8")
    assert f"slamcmp check {handout.entry}" in (tmp_path / "mine" / "README.md").read_text("utf-8")


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "ekf.py").write_text("my work")
    with pytest.raises(UsageError, match=r"ekf\.py is there already"):
        write_handout("ekf", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["ekf.py"]
    with pytest.raises(UsageError, match="is there already"):
        export_staff(tmp_path)


def test_a_file_in_the_way_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"file/sub: cannot be written"):
        write_handout("ekf", tmp_path / "file" / "sub")


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(MissingDataError, match=r"'efk'; did you mean 'ekf'"):
        find_handout("efk")


def test_the_staffs_folder_is_found_by_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    staff = tmp_path / "course"
    assert [path.name for path in export_staff(staff)] == NAMES
    (staff / "ekf").rename(staff / "my_own")
    monkeypatch.setenv(STAFF_VARIABLE, str(staff))
    assert find_assignment("my_own") == (staff / "my_own").resolve()
    assert find_assignment("ekf_slam") == (staff / "ekf_slam").resolve()
    assert "my_own" in handouts()
    monkeypatch.setenv(STAFF_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(MissingDataError, match=rf"{STAFF_VARIABLE}=.*nowhere: there is no such folder"):
        find_assignment("ekf")


@pytest.mark.parametrize(
    ("readme", "tests", "what"),
    [
        ("The filter\n", "import a\n", "the first line has to be the title"),
        ("# The filter\n", "import numpy\n", "no other; here: none"),
        ("# The filter\n", "import a\nfrom b import c\n", "no other; here: a, b"),
    ],
)
def test_a_handout_with_a_fault_is_told(tmp_path: Path, readme: str, tests: str, what: str) -> None:
    (tmp_path / "README.md").write_text(readme)
    (tmp_path / "public_tests.py").write_text(tests)
    with pytest.raises(UsageError, match=what):
        read_handout(tmp_path)


def test_the_commands(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "slamcmp"]
    answer = subprocess.run(
        [*command, "handout", "kalman_filter", "mine"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.splitlines()[-1] == (
        "read mine/README.md, fill in mine/kalman_filter.py, and try it: slamcmp check mine/kalman_filter.py"
    )
    again = subprocess.run(
        [*command, "handout", "kalman_filter", "mine"], cwd=tmp_path, capture_output=True, text=True
    )
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
