"""The gradebook: what a spreadsheet would run, it does not get."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcmp.grading.results.gradebook import GradebookRow, gradebook_csv, safe_cell, write_gradebook
from tests.grading.outcomes import example


def _read(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t=", "\r=", "\n=", " =", "＝", "\t", "\r"])
def test_no_cell_begins_as_a_formula(start: str) -> None:
    hostile = f"{start}cmd|' /C calc'!A0"
    cell = safe_cell(hostile)
    assert cell[0] == "'"
    assert not set(cell) & {"\t", "\r", "\n"}
    rows = _read(gradebook_csv([GradebookRow(hostile, hostile, "ok", replace(example(), notes=(hostile,)))]))
    assert [value[0] for value in (rows[1][0], rows[1][4], rows[1][6])] == ["'"] * 3


@given(st.text())
def test_every_text_comes_back_as_one_harmless_cell(text: str) -> None:
    rows = _read(gradebook_csv([GradebookRow(text, "a.py", "pending", None)]))
    assert len(rows) == 2
    assert len(rows[1]) == len(rows[0])
    assert not rows[1][0].lstrip().startswith(("=", "+", "-", "@"))


def test_numbers_stay_numbers_also_negative_ones() -> None:
    tests = (replace(example().tests[0], score=-2.5),)
    rows = _read(gradebook_csv([GradebookRow("ada", "ada.py", "ok", replace(example(), tests=tests))]))
    assert rows[1][1] == "-2.5"


def test_columns_are_the_union_of_the_tests(tmp_path: Path) -> None:
    short = replace(example(complete=False), tests=example().tests[:2])
    rows = [
        GradebookRow("ada", "ada.py", "ok", example()),
        GradebookRow("bob", "bob.zip", "timed_out", short),
        GradebookRow("cyd", "cyd", "pending", None),
    ]
    write_gradebook(rows, tmp_path / "gradebook.csv")
    content = (tmp_path / "gradebook.csv").read_bytes()
    assert content.startswith(b"\xef\xbb\xbf"), "the mark by which a spreadsheet knows UTF-8"
    header, ada, bob, cyd = _read(content.decode("utf-8-sig"))
    assert header[7:] == ["1 predict", "2 track", "3 crash", "4 consistency", "5 HIDDEN-NAME"]
    assert ada[:4] == ["ada", "29.3456", "100.0", "ok"]
    assert ada[7:] == ["10.0", "12.3456", "0.0", "7.0", "0.0"]
    assert bob[:4] == ["bob", "22.3456", "40.0", "timed_out"]
    assert bob[7:] == ["10.0", "12.3456", "", "", ""]
    assert cyd[:4] == ["cyd", "", "", "pending"]
