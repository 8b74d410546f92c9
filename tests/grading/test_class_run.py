"""A class run: one bad submission stops nothing, a killed run goes on, and no process is left behind."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from slamcmp.errors import UsageError
from slamcmp.grading.results.class_summary import summarise
from slamcmp.grading.results.gradebook import GradebookRow
from slamcmp.grading.results.outcome import load_outcome
from slamcmp.grading.run import class_run
from slamcmp.grading.run.class_run import ClassResult, run_class
from tests.grading.outcomes import example
from tests.grading.school import HONEST, WRONG, build

ROOT = Path(__file__).resolve().parents[2]
GRADER = "tests.grading.fake_grader:grade"

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder that other users may pass through, as the sandbox's own users have to."""
    folder = Path(tempfile.mkdtemp(prefix="class-"))
    folder.chmod(0o711)
    (folder / "tmp").mkdir()
    (folder / "tmp").chmod(0o711)
    (folder / "assignment").mkdir()
    (folder / "assignment" / "assignment.yaml").write_text("name: toy\n")
    monkeypatch.setenv("TMPDIR", str(folder / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def _run(
    place: Path, *, secret: bytes = b"secret", rerun_failed: bool = False, **options: float
) -> ClassResult:
    return run_class(
        place / "assignment",
        place / "class",
        place / "out",
        secret=secret,
        jobs=2,
        accept_weak_sandbox=True,
        rerun_failed=rerun_failed,
        pages=False,
        grader=GRADER,
        **options,
    )


def _gradebook(place: Path) -> dict[str, dict[str, str]]:
    with (place / "out" / "gradebook.csv").open(encoding="utf-8-sig", newline="") as file:
        return {row["student"].removeprefix("'"): row for row in csv.DictReader(file)}


def _of(place: Path, student: str) -> Path:
    """The student's folder in the results."""
    (folder,) = place.glob(f"out/students/{student}-*")
    return folder


def _scores(place: Path) -> dict[str, float]:
    return {student: float(row["score"]) for student, row in _gradebook(place).items()}


def _memory_of_graders(place: Path) -> list[int]:
    """The most that each grader told it held [KiB]."""
    outcomes = [load_outcome(path) for path in place.glob("out/students/*/outcome.json")]
    details = "\n".join(test.staff_detail for outcome in outcomes for test in outcome.tests)
    return [int(told) for told in re.findall(r"largest (\d+) KiB", details)]


def _processes_of(pid: int, place: Path) -> list[str]:
    """Command lines of what a class run with this process number, or its sandbox, has started."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        graders = b"slamcmp.grading.run.grade_process" in words and str(pid).encode() in words
        if graders or any(str(place / "tmp").encode() in word for word in words):
            found.append(f"{entry.name}: {b' '.join(words).decode(errors='replace')}")
    return found


def _start(place: Path) -> subprocess.Popen[bytes]:
    code = (
        "import sys; from pathlib import Path; from slamcmp.grading.run.class_run import run_class; "
        f"run_class(Path({str(place / 'assignment')!r}), Path({str(place / 'class')!r}), "
        f"Path({str(place / 'out')!r}), secret=b'secret', jobs=2, accept_weak_sandbox=True, pages=False, "
        f"grader={GRADER!r})"
    )
    return subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.DEVNULL)


def _end_when_done(place: Path, process: subprocess.Popen[bytes], count: int, number: int) -> set[str]:
    """Send a signal once ``count`` gradings are done; who is done then, by folder."""
    until = time.monotonic() + 600
    while len(list(place.glob("out/students/*/done.json"))) < count:
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < until
        time.sleep(0.02)
    process.send_signal(number)
    process.wait(30)
    return {path.parent.name for path in place.glob("out/students/*/done.json")}


def _assert_nothing_runs(pid: int, place: Path) -> None:
    until = time.monotonic() + 5
    while (left := _processes_of(pid, place)) and time.monotonic() < until:
        time.sleep(0.05)
    assert left == []


@pytest.mark.parametrize("size", [22, pytest.param(300, marks=pytest.mark.slow)])
def test_a_killed_class_run_goes_on_with_the_same_scores_and_leaves_no_process(
    place: Path, size: int
) -> None:
    expected = build(place / "class", size)
    process = _start(place)
    _end_when_done(place, process, size // 4, signal.SIGINT)
    _assert_nothing_runs(process.pid, place)
    process = _start(place)
    done = _end_when_done(place, process, size // 2, signal.SIGKILL)
    _assert_nothing_runs(process.pid, place)
    halfway = {student: row for student, row in _gradebook(place).items() if row["graded"] != "pending"}
    assert len(halfway) >= size // 2 - 2, "the gradebook of a killed run is usable"
    assert {student: float(row["score"]) for student, row in halfway.items()} == {
        student: expected[student] for student in halfway
    }
    stamps = {name: (place / "out/students" / name / "done.json").stat().st_mtime_ns for name in done}

    result = _run(place)
    assert (result.reused, result.graded) == (len(done), size - len(done))
    assert _scores(place) == expected
    assert stamps == {name: (place / "out/students" / name / "done.json").stat().st_mtime_ns for name in done}
    _assert_nothing_runs(os.getpid(), place)

    again = _run(place)
    assert (again.reused, again.graded) == (size, 0)
    assert _scores(place) == expected
    assert max(_memory_of_graders(place)) < 400 << 10, "whatever comes in [KiB]"
    assert _gradebook(place)["grader_crashes"]["graded"] == "crashed"
    assert again.summary.endings == {"ok": size - 1, "crashed": 1}


def test_ctrl_c_ends_the_run_cleanly(place: Path) -> None:
    build(place / "class", 21)
    process = _start(place)
    done = _end_when_done(place, process, 3, signal.SIGINT)
    assert process.returncode == 0, "run_class returns, marked as interrupted"
    _assert_nothing_runs(process.pid, place)
    assert list((place / "tmp").iterdir()) == [], "no temporary files of those that were ended"
    summary = json.loads((place / "out" / "summary.json").read_text())
    assert summary["graded"] == len(done)
    assert summary["endings"]["pending"] == 21 - len(done)


def _small_class(place: Path, **sources: str) -> None:
    (place / "class").mkdir(exist_ok=True)
    for name, source in sources.items():
        (place / "class" / f"{name}.py").write_text(source)


def test_only_what_changed_is_graded_again(place: Path) -> None:
    _small_class(place, ada=HONEST, bob=WRONG)
    assert _run(place).graded == 2
    assert _run(place).graded == 0
    _small_class(place, bob=HONEST)
    assert _run(place).graded == 1
    assert _scores(place) == {"ada": 30.0, "bob": 30.0}
    assert _run(place, secret=b"another").graded == 2, "other hidden tests"
    (place / "assignment" / "assignment.yaml").write_text("name: toy\npoints: 31\n")
    assert _run(place, secret=b"another").graded == 2
    (place / "assignment" / "__pycache__").mkdir()
    (place / "assignment" / "__pycache__" / "solution.pyc").write_bytes(b"x")
    assert _run(place, secret=b"another").graded == 0


@pytest.mark.parametrize("what", ["assignment", "submission"])
def test_a_grade_of_something_else_than_the_key_says_is_no_grade(place: Path, what: str) -> None:
    _small_class(place, ada=f"{HONEST}\n# the grader sees_another_{what}\n")
    (row,) = _run(place).rows
    assert row.ended == "crashed"
    done = json.loads((_of(place, "ada") / "done.json").read_text())
    assert done["message"] == f"the {what} was changed while this was graded; give the same command again"
    # Also where the change is taken back: what was graded in between is not taken for a grade of this.
    (place / "assignment" / "assignment.yaml").write_text("name: toy\n")
    _small_class(place, ada=HONEST)
    (row,) = _run(place).rows
    assert row.ended == "ok"
    assert _scores(place) == {"ada": 30.0}


def test_a_grade_by_other_code_than_the_run_began_with_is_no_grade(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = iter(["before", "after", "before", "before"])
    monkeypatch.setattr(class_run, "_code", lambda: next(versions))
    _small_class(place, ada=HONEST)
    (row,) = _run(place).rows
    assert row.ended == "crashed"
    assert "slamcmp was changed while" in json.loads((_of(place, "ada") / "done.json").read_text())["message"]
    (row,) = _run(place).rows
    assert (row.ended, _scores(place)) == ("ok", {"ada": 30.0})


def test_a_grader_that_ends_well_without_a_whole_result_has_not_ended_well(place: Path) -> None:
    _small_class(place, ada=f"{HONEST}\n# the grader leaves\n")
    (row,) = _run(place).rows
    assert (row.ended, _scores(place)) == ("crashed", {"ada": 10.0})
    assert "no whole result" in json.loads((_of(place, "ada") / "done.json").read_text())["message"]


def test_faults_of_the_grader_keep_what_was_scored_and_say_so(place: Path) -> None:
    _small_class(
        place,
        honest=HONEST,
        hangs=f"{HONEST}\n# the grader hangs\n",
        raises=f"{HONEST}\n# the grader raises\n",
        segfault=f"{HONEST}\n# the grader crashes\n",
    )
    result = _run(place, time_limit_s=2.5)
    assert {row.student: row.ended for row in result.rows} == {
        "honest": "ok",
        "hangs": "timed_out",
        "raises": "crashed",
        "segfault": "crashed",
    }
    assert _scores(place) == {"honest": 30.0, "hangs": 10.0, "raises": 10.0, "segfault": 10.0}
    hung = load_outcome(_of(place, "hangs") / "outcome.json")
    assert not hung.complete
    assert hung.notes == ("The grading took longer than the time that the course allows.",)
    done = json.loads((_of(place, "raises") / "done.json").read_text())
    assert done["message"] == "RuntimeError: a fault in the grader"
    assert json.loads((_of(place, "segfault") / "done.json").read_text())["message"] == "killed by SIGSEGV"
    assert _run(place, time_limit_s=2.5).graded == 0
    assert _run(place, time_limit_s=2.5, rerun_failed=True).graded == 3


def test_a_machine_that_refuses_every_grading_stops_the_run_with_its_reason(place: Path) -> None:
    _small_class(place, **{f"s{i}": f"{HONEST}\n# the grader refuses\n" for i in range(8)})
    with pytest.raises(UsageError, match="this machine protects nothing"):
        _run(place)
    assert len(list(place.glob("out/students/*/done.json"))) == 3
    _assert_nothing_runs(os.getpid(), place)


def test_two_runs_in_one_folder_are_refused(place: Path) -> None:
    _small_class(place, ada=f"{HONEST}\n# the grader hangs\n")
    process = _start(place)
    try:
        until = time.monotonic() + 20
        while not list(place.glob("out/students/ada-*")) and time.monotonic() < until:
            time.sleep(0.02)
        with pytest.raises(UsageError, match="another class run"):
            _run(place)
    finally:
        process.terminate()
        assert process.wait(20) == 0


def test_pages_are_written_for_student_and_staff(place: Path) -> None:
    _small_class(place, ada=WRONG)
    run_class(
        place / "assignment",
        place / "class",
        place / "out",
        secret=b"secret",
        accept_weak_sandbox=True,
        grader=GRADER,
    )
    feedback = (_of(place, "ada") / "feedback.html").read_text()
    staff = (_of(place, "ada") / "staff.html").read_text()
    assert "half(3) is 1.0, 1.5 was expected" in feedback
    assert "STAFF-DETAIL" in staff
    assert "STAFF-DETAIL" not in feedback
    assert b"secret".hex() not in feedback


def test_the_summary_counts_scores_and_failures() -> None:
    first, second = example(), example()
    second = replace(
        second,
        tests=(
            second.tests[0],
            replace(
                second.tests[1], message="Your innovation is not wrapped: bearing residual -5.9 rad at step 3"
            ),
            *second.tests[2:],
        ),
    )
    perfect = replace(first, tests=tuple(replace(t, score=t.max_score, status="passed") for t in first.tests))
    short = replace(first, tests=first.tests[:1], complete=False)
    rows = [
        GradebookRow("a", "a.py", "ok", first),
        GradebookRow("b", "b.py", "ok", second),
        GradebookRow("c", "c.py", "ok", perfect),
        GradebookRow("d", "d.py", "timed_out", short),
        GradebookRow("e", "e.py", "pending", None),
    ]
    summary = summarise(rows)
    assert (summary.submissions, summary.graded) == (5, 4)
    assert summary.endings == {"ok": 3, "timed_out": 1, "pending": 1}
    assert summary.mean == pytest.approx((29.3456 * 2 + 100 + 10) / 4)
    assert summary.quartiles == pytest.approx((10.0, 24.5092, 29.3456, 47.0092, 100.0))
    assert summary.histogram == (0, 1, 2, 0, 0, 0, 0, 0, 0, 1)
    track = next(failure for failure in summary.failures if failure.test == "2 track")
    assert (track.submissions, track.message_count) == (2, 2)
    assert track.message == "Your innovation is not wrapped: bearing residual # rad at step #"
    assert track.lost == pytest.approx(1 - (2 * 12.345649 + 30) / 90)


def test_what_a_killed_run_left_is_cleared_by_a_later_one(place: Path) -> None:
    left = [place / "tmp" / f"slamcmp-{pid}-abc" for pid in (2**22 + 1, os.getpid())]
    for folder in left:
        folder.mkdir()
        os.utime(folder, (0, 0))
    _small_class(place, ada=HONEST)
    _run(place)
    assert [folder.exists() for folder in left] == [False, True], "one of a living process stays"
