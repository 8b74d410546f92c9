"""Grades by other rules, and the page of a class: closed forms, and what a table may hold that is wrong."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slamcmp.cli import app, main
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.grading.results.class_page import class_page
from slamcmp.grading.results.class_results import read_class
from slamcmp.grading.results.class_statistics import clusters, named_mistakes, test_statistics
from slamcmp.grading.results.gradebook import GradebookRow, write_folders, write_gradebook
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, load_outcome, save_outcome
from slamcmp.grading.results.rules import (
    AttemptFields,
    LateFields,
    RulesFields,
    Submitted,
    deduction,
    load_rules,
    load_submitted,
    regraded,
    reweighted,
)
from tests.grading.outcomes import HOSTILE, example

NAMES = ("predict", "update", "speed")
POINTS = (20.0, 50.0, 30.0)


def row(student: str, shares: Sequence[float], causes: Sequence[str] = (), **changed: object) -> GradebookRow:
    """A student with these shares of 20, 50 and 30 points, and causes named in the tests that lost some."""
    tests = tuple(
        TestOutcome(
            *(str(number), name, "unit", "passed" if share == 1 else "partial", share * points, points),
            *("visible", "", "", 0.1),
            causes=tuple(causes) if share < 1 else (),
        )
        for number, (name, points, share) in enumerate(zip(NAMES, POINTS, shares, strict=True), start=1)
    )
    outcome: GradeOutcome = replace(example(student=student), tests=tests, leaderboard=())
    return GradebookRow(student, f"{student}.py", "ok", replace(outcome, **changed))  # type: ignore[arg-type]


def misjudged(given: GradebookRow) -> GradebookRow:
    """The same where the grader itself failed at the second test."""
    assert given.outcome is not None
    first, second, third = given.outcome.tests
    tests = (first, replace(second, judged=False, score=0.0), third)
    return replace(given, outcome=replace(given.outcome, tests=tests))


# Deductions.


@pytest.mark.parametrize(
    ("late_h", "percent"),
    [(0, 0), (1.1, 0), (1.2, 10), (25.1, 10), (25.2, 20), (49.1, 20), (24 * 4 + 1.1, 40), (24 * 30, 45)],
)
def test_a_day_that_has_begun_counts_whole(late_h: float, percent: float) -> None:
    rules = RulesFields(late=LateFields(percent_per_day=10, grace_h=1.1, most_percent=45))
    assert deduction(rules, Submitted(late_h=late_h)) == percent


def test_late_and_attempts_add_up_and_take_no_more_than_all() -> None:
    rules = RulesFields(
        late=LateFields(percent_per_day=40), attempts=AttemptFields(free=2, percent_each=5, most_percent=15)
    )
    assert deduction(rules, Submitted(1.0, 2)) == 40
    assert deduction(rules, Submitted(1.0, 4)) == 50
    assert deduction(rules, Submitted(0.0, 9)) == 15
    assert deduction(rules, Submitted(72.0, 9)) == 100


# Other points.


def test_other_points_are_what_a_grading_with_them_would_give() -> None:
    outcome = row("ada", (1.0, 0.3, 0.5)).outcome
    assert outcome is not None
    other = reweighted(outcome, {"update": 10.0, "speed": 0.0})
    assert [(test.score, test.max_score) for test in other.tests] == [
        (20, 20),
        (pytest.approx(3), 10),
        (0, 0),
    ]
    assert outcome.score == 50, "nothing that was graded is changed"
    with pytest.raises(UsageError, match=r"'speed' was graded with 0 points.*grade again"):
        reweighted(other, {"speed": 30.0})


def test_rules_that_do_not_fit_the_table_are_refused() -> None:
    rows = [row("ada", (1.0, 1.0, 1.0))]
    late = RulesFields(late=LateFields(percent_per_day=10))
    with pytest.raises(UsageError, match="the rules have late, and no table tells late_h"):
        regraded(rows, late, {})
    with pytest.raises(UsageError, match="the table tells attempts, and no rule uses it"):
        regraded(rows, late, {"ada": Submitted(1.0, 3, frozenset({"late_h", "attempts"}))})
    with pytest.raises(UsageError, match="no test is worth anything"):
        regraded(rows, RulesFields(points=dict.fromkeys(NAMES, 0.0)), {})
    (same,) = regraded(rows, RulesFields(points={"update": 1.0}), {})
    assert (same.final, same.deducted_percent) == (51.0, None)
    (less,) = regraded(rows, late, {"ada": Submitted(30.0, told=frozenset({"late_h"}))})
    assert (less.final, less.deducted_percent) == (80.0, 20.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("points: {updat: 3}\n", r":1:10: no test is called 'updat'; did you mean 'update'\?"),
        ("points: {update: -1}\n", r":1:\d+: points are a number from 0 on"),
        ("points: {speed: .nan}\n", r":1:\d+: "),
        ("points: {speed: ten}\n", r":1:\d+: .*number"),
        ("points: {twice: 3}\n", r":1:10: 2 tests are called 'twice'"),
        (
            "late: {percent_per_dy: 3}\n",
            r":1:8: unknown key 'percent_per_dy'; did you mean",
        ),
        ("late: {percent_per_day: 120}\n", r":1:\d+: .*100"),
        ("attempts: {percent_each: 3}\n", r"free"),
        ("weights: {}\n", r":1:1: unknown key 'weights'"),
    ],
)
def test_rules_are_checked_with_their_place(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "rules.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=told):
        load_rules(path, [*NAMES, "twice", "twice"])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r":1: columns are student, late_h, attempts .*found: nothing"),
        ("student\n", r"holds no student"),
        ("name,late_h\nada,1\n", r":1: columns are .*found: name, late_h"),
        ("student,late_h,late_h\nada,1,2\n", r":1: columns are"),
        ("student,late_h\nada,1\nbib,2\n", r":3: nobody is called 'bib'; did you mean 'bob'\?"),
        ("student,late_h\nada,1\n\nada,2\n", r":4: 'ada' stands above already"),
        ("student,late_h\nada,soon\n", r":2: late_h 'soon': hours, a number from 0 on is needed"),
        ("student,late_h\nada,-1\n", r":2: late_h '-1'"),
        ("student,late_h\nada,nan\n", r":2: late_h 'nan'"),
        ("student,attempts\nada,1.5\n", r":2: attempts '1.5': a whole number from 1 on is needed"),
        ("student,late_h\nada\n", r":2: 1 cells where the first line has 2"),
        ('student,late_h\n"ada\n\n",x\nbob,1\n', r":2: late_h 'x'"),
        ('student,late_h\n"ada,1\n', r"is no CSV"),
        ("student,late_h\n\x1b[2Jada,1\n", r":2: nobody is called '.\[2Jada'"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_with_its_line(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "submitted.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=told):
        load_submitted(path, ["ada", "bob"])


def test_tables_as_spreadsheets_write_them_are_read(tmp_path: Path) -> None:
    path = tmp_path / "submitted.csv"
    path.write_bytes(b"\xef\xbb\xbfstudent , late_h\r\nada,2.5\r\n'=x,3\r\n,\r\n'tis,4\r\n")
    found = load_submitted(path, ["ada", "=x", "'tis"])
    assert {student: each.late_h for student, each in found.items()} == {"ada": 2.5, "=x": 3.0, "'tis": 4.0}
    with pytest.raises(MissingDataError):
        load_submitted(tmp_path / "nowhere.csv", ["ada"])
    path.write_bytes("student\nad\xe9\n".encode("latin-1"))
    with pytest.raises(DataError, match="no UTF-8"):
        load_submitted(path, ["ada"])


# What a class shows.


def test_difficulty_and_discrimination_are_their_definitions() -> None:
    shares = np.random.default_rng(3).integers(0, 5, size=(12, 3)) / 4.0
    rows = [row(f"s{number}", each) for number, each in enumerate(shares)]
    points = shares * np.array(POINTS)
    for index, found in enumerate(test_statistics(rows)):
        rest = np.delete(points, index, axis=1).sum(axis=1)
        assert found.mean_share == pytest.approx(shares[:, index].mean())
        assert found.full == (shares[:, index] == 1).sum()
        assert found.discrimination == pytest.approx(np.corrcoef(shares[:, index], rest)[0, 1])


def test_who_was_not_graded_or_misjudged_is_in_no_statistics() -> None:
    rows = [row(f"s{number}", (1.0, 0.2 * number, 0.5)) for number in range(5)]
    whole = test_statistics(rows)
    stopped = row("stopped", (0.0, 0.0, 0.0), complete=False)
    assert test_statistics([*rows, stopped]) == whole
    failed = row("failed", (1.0, 0.4, 0.5)).outcome
    assert failed is not None
    tests = tuple(
        replace(test, judged=False, score=0.0) if test.number == "2" else test for test in failed.tests
    )
    update = test_statistics([*rows, GradebookRow("failed", "f.py", "ok", replace(failed, tests=tests))])[1]
    assert (update.submissions, update.mean_share) == (5, pytest.approx(whole[1].mean_share))
    lost = [row(name, (0.5, 0.25, 0.1)) for name in ("one", "other")]
    assert len(clusters(lost)) == 1
    assert clusters([lost[0], misjudged(lost[1])]) == ()


def test_one_program_is_the_same_with_the_data_of_two_students() -> None:
    """A wrong update earned 0 of 20 with one student's data and 0.8 with another's."""
    causes = ["Your correct answers as if R counted half."]
    rows = [
        row(name, shares, causes) for name, shares in (("eva", (0.0, 0.5, 0.4)), ("fay", (0.04, 0.5, 0.4)))
    ]
    (found,) = clusters(rows)
    assert found.students == ("eva", "fay")
    assert clusters([rows[0], row("gus", (0.2, 0.5, 0.4), causes)]) == ()


def test_only_those_who_fail_alike_in_three_tests_are_hinted_at() -> None:
    alike = [row(name, (0.5, 0.25, 0.1), ["You forget Q."]) for name in ("ada", "bob")]
    others = [
        row("other cause", (0.5, 0.25, 0.1), ["You forget R."]),
        row("other share", (0.5, 0.4, 0.1), ["You forget Q."]),
        *(row(name, (1.0, 0.25, 0.1), ["You forget Q."]) for name in ("two tests", "two again")),
        *(row(name, (0.0, 0.0, 0.0), ["You forget Q."]) for name in ("nothing", "nothing too")),
    ]
    (found,) = clusters([*others, *alike])
    assert found.students == ("ada", "bob")
    assert found.tests == ("1 predict", "2 update", "3 speed")
    mistakes = named_mistakes([*others, *alike])
    assert [(each.message, each.students) for each in mistakes] == [
        ("You forget Q.", 7),
        ("You forget R.", 1),
    ]


def test_the_page_needs_nothing_runs_nothing_and_escapes_names() -> None:
    rows = [row(HOSTILE, (0.5, 0.25, 0.1), [HOSTILE]), row("bob", (0.5, 0.25, 0.1), [HOSTILE])]
    page = class_page(rows)
    assert "default-src 'none'" in page
    assert "<script" not in page
    assert not re.search(r"""(src|href)=|url\(|@import""", page)
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202e]", page)
    assert "&lt;script&gt;" in page
    assert "A hint and no evidence" in page


def test_old_results_say_that_causes_were_not_recorded() -> None:
    rows = [row("ada", (1.0, 0.5, 1.0))]
    assert "None: no answer was that of a known mistake" in class_page(rows)
    outcome = rows[0].outcome
    assert outcome is not None
    old = replace(outcome, tests=tuple(replace(test, causes=None) for test in outcome.tests))
    page = class_page([replace(rows[0], outcome=old)])
    assert "Not recorded" in page
    assert "None: no answer" not in page


# The command.


def graded_class(folder: Path, rows: Sequence[GradebookRow]) -> Path:
    """The results folder that a class run leaves of these."""
    folders = {each.student: f"students/s{number}" for number, each in enumerate(rows)}
    for each in rows:
        place = folder / folders[each.student]
        place.mkdir(parents=True)
        if each.outcome is not None:
            save_outcome(each.outcome, place / "outcome.json")
            (place / "done.json").write_text(json.dumps({"ended": each.ended}))
    write_folders(folders, folder / "folders.csv")
    write_gradebook(rows, folder / "gradebook.csv")
    return folder


CLASS = [
    row("ada", (1.0, 0.5, 1.0)),
    row("=bob", (1.0, 1.0, 0.0)),
    GradebookRow("=cyd", "cyd.zip", "pending", None),
]


def test_a_class_is_read_as_it_was_written(tmp_path: Path) -> None:
    found = read_class(graded_class(tmp_path / "grades", CLASS))
    assert found == CLASS


def test_regrading_writes_new_tables_beside_the_old_ones(tmp_path: Path) -> None:
    folder = graded_class(tmp_path / "grades", CLASS)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (tmp_path / "rules.yaml").write_text("points: {update: 30, speed: 0}\nlate: {percent_per_day: 10}\n")
    (tmp_path / "late.csv").write_text("student,late_h\n'=bob,30\n")
    answer = CliRunner().invoke(
        app,
        ["regrade", str(folder), "--rules", f"{tmp_path}/rules.yaml", "--submitted", f"{tmp_path}/late.csv"],
    )
    assert answer.exit_code == 0, answer.output
    assert "2 of 3 by the rules" in answer.output
    lines = (folder / "regraded" / "gradebook.csv").read_text(encoding="utf-8-sig").splitlines()
    assert lines[0].endswith('"earned","deducted_percent","1 predict","2 update","3 speed"')
    assert lines[1].startswith('"ada","35.0","50.0","ok"')
    assert lines[2].startswith('"\'=bob","40.0","50.0","ok"')
    assert '"50.0","20.0"' in lines[2]
    assert lines[3].startswith('"\'=cyd","","","pending"')
    assert "points are deducted from 1 of 3" in (folder / "regraded" / "class.html").read_text()
    assert {path: path.read_bytes() for path in before} == before


def folders(text: str | bytes) -> Callable[[Path], object]:
    """Replaces the table of folders."""
    content = text if isinstance(text, bytes) else text.encode()
    return lambda folder: (folder / "folders.csv").write_bytes(content)


@pytest.mark.parametrize(
    ("change", "told", "code"),
    [
        (lambda folder: (folder / "folders.csv").unlink(), "no results folder of `slamcmp grade-all`", 3),
        (folders(b"\xff\xfe\x00"), "cannot be read", 2),
        (folders('student,folder\n"ada,x'), "cannot be read", 2),
        (folders("who,where\nada,x\n"), "is no table with columns", 2),
        (folders("student,folder\nada\n"), "is no table with columns", 2),
        (folders("student,folder\nada,../..\n"), "no folder of", 2),
        (folders("student,folder\nada,/etc\n"), "no folder of", 2),
        (folders("student,folder\nada,new\n"), "nobody is graded", 2),
        (lambda folder: (folder / "students/s0/outcome.json").write_text("{}"), "is no outcome", 2),
        (
            lambda folder: save_outcome(
                replace(load_outcome(folder / "students/s0/outcome.json"), assignment_digest="other"),
                folder / "students/s0/outcome.json",
            ),
            "outcomes of 2 versions of the assignment",
            2,
        ),
        (lambda folder: (folder / "regraded").write_text("a file"), "--out .*regraded: File exists", 2),
    ],
)
def test_a_spoilt_results_folder_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Path], object],
    told: str,
    code: int,
) -> None:
    folder = graded_class(tmp_path / "grades", CLASS)
    change(folder)
    (tmp_path / "rules.yaml").write_text("points: {update: 30}\n")
    monkeypatch.setattr("sys.argv", ["slamcmp", "regrade", str(folder), "--rules", f"{tmp_path}/rules.yaml"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err.strip()
    assert (ended.value.code, len(said.splitlines())) == (code, 1), said
    assert re.search(told, said), said
