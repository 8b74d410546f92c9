"""The autograder zip, unpacked and run as Gradescope documents it, as root and as somebody else."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp.errors import DataError, MissingDataError
from slamcmp.grading.run.autograder import (
    Layout,
    gradescope_layout,
    prairielearn_layout,
    run_autograder,
    self_test,
    student_of,
)
from slamcmp.grading.run.bundle import constraints, requirements, write_bundle
from slamcmp.grading.sandbox.walls.readable import world_reachable
from tests.grading import toy_assignment
from tests.grading.toy_assignment import SOLUTION

SECRET = b"0123456789abcdef-the-course's"
ROOT = os.geteuid() == 0
OTHER_UID = 31_337
USERS = ["ourselves", pytest.param("another", marks=pytest.mark.skipif(not ROOT, reason="needs root"))]

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundle")
    return write_bundle(toy_assignment.write(folder), folder / "autograder.zip", secret=SECRET)


@pytest.fixture
def autograder(bundle: Path) -> Iterator[Path]:
    """``/autograder`` as the platform lays it out, elsewhere; this interpreter stands in for its own."""
    root = Path(tempfile.mkdtemp(prefix="autograder-"))
    root.chmod(0o755)
    for name in ("source", "submission", "results", "tmp"):
        (root / name).mkdir()
    with zipfile.ZipFile(bundle) as archive:
        for entry in archive.infolist():
            path = Path(archive.extract(entry, root / "source"))
            path.chmod((entry.external_attr >> 16) & 0o777)
    (root / "venv").symlink_to(sys.prefix)
    metadata = {
        "users": [{"email": "zoe@example.edu", "id": 2, "name": "Z"}, {"email": "ada@example.edu", "id": 1}],
        "assignment": {"late_due_date": None},
        "previous_submissions": [{"score": 30.0, "results": {"output": "EARLIER-RESULT"}}],
    }
    (root / "submission_metadata.json").write_text(json.dumps(metadata))
    yield root
    shutil.rmtree(root, ignore_errors=True)


def _submit(root: Path, source: str) -> None:
    (root / "submission" / "toy.py").write_text(source)


def _start(root: Path, script: str = "run_autograder", user: str = "ourselves") -> subprocess.Popen[str]:
    words = [str(root / "source" / script)]
    if user == "another":
        _make_interpreter_reachable(root)
        subprocess.run(["chown", "-R", "-h", f"{OTHER_UID}:{OTHER_UID}", str(root)], check=True)
        words = ["setpriv", f"--reuid={OTHER_UID}", f"--regid={OTHER_UID}", "--clear-groups", *words]
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": "/nonexistent",
        "AUTOGRADER_ROOT": str(root),
        "PIP_NO_INDEX": "1",
        "TMPDIR": str(root / "tmp"),
    }
    return subprocess.Popen(
        words, env=environment, cwd="/", stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _make_interpreter_reachable(root: Path) -> None:
    """Where this interpreter is private, as below /root, the system's own with the same libraries."""
    if world_reachable(os.path.realpath(sys.executable)) and world_reachable(str(root / "venv/bin/python")):
        return
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    system = shutil.which(version, path="/usr/local/bin:/usr/bin")
    if system is None or not world_reachable(np.__file__):
        pytest.skip(f"other users reach neither this interpreter nor a {version} of the system's")
    (root / "venv").unlink()
    subprocess.run([system, "-m", "venv", "--without-pip", str(root / "venv")], check=True)
    path_file = root / "venv" / "lib" / version / "site-packages" / "same.pth"
    path_file.write_text(sysconfig.get_path("purelib") + "\n")


def _grade(root: Path, source: str, user: str = "ourselves") -> tuple[dict[str, Any], str]:
    _submit(root, source)
    process = _start(root, user=user)
    printed = process.communicate(timeout=120)[0]
    assert process.returncode == 0, printed
    return _results(root), printed


def _results(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((root / "results" / "results.json").read_text())
    return found


@pytest.mark.parametrize("user", USERS)
def test_a_submission_is_graded_where_gradescope_puts_it(autograder: Path, user: str) -> None:
    results, printed = _grade(autograder, SOLUTION.replace("x / 2.0", "x / 3.0"), user)
    assert results["score"] == 20.0
    assert [test["score"] for test in results["tests"]] == [10.0, 0.0, 10.0]
    assert [test["max_score"] for test in results["tests"]] == [10.0, 10.0, 10.0]
    assert [test["visibility"] for test in results["tests"]] == ["visible", "visible", "hidden"]
    assert results["extra_data"]["complete"] is True
    assert printed.startswith("ada@example.edu+zoe@example.edu: 20 of 30 points")
    assert "SECRET-SQUARE" in printed
    text = json.dumps(results)
    assert [leak for leak in ("SECRET-SQUARE", SECRET.decode(), SECRET.hex()) if leak in text] == []


_SPY = """
import glob
root = {root!r}
stolen = []
for name in ["submission_metadata.json", "source/secret", "results/results.json",
             "source/assignments/toy/solution/solution.py", "source/package/slamcmp/geometry.py"]:
    try:
        stolen.append(open(root + "/" + name).read()[:300])
    except OSError as error:
        stolen.append(type(error).__name__)
def double(x): raise RuntimeError(repr(stolen))
"""


@pytest.mark.parametrize("user", USERS)
def test_the_submission_reads_neither_earlier_results_nor_secret_nor_solution(
    autograder: Path, user: str
) -> None:
    assert "EARLIER-RESULT" in (autograder / "submission_metadata.json").read_text(), "control: it is there"
    results, _ = _grade(autograder, _SPY.format(root=str(autograder)), user)
    message = results["tests"][0]["output"]
    stolen = re.search(r"RuntimeError: (\[.*?\])", message)
    assert stolen is not None, message
    refused = {"PermissionError", "FileNotFoundError"}
    assert set(re.findall(r"'([^']*)'", stolen[1])) <= refused, message
    assert message.count("Error'") == 5
    text = json.dumps(results)
    assert [leak for leak in ("EARLIER-RESULT", SECRET.decode()) if leak in text] == []


def _installed_as_pinned() -> bool:
    pinned = dict(line.split("==") for line in constraints().splitlines() if "==" in line)
    names = [re.split(r"[<>=!~ ;\[]", line)[0] for line in requirements()]
    lower = {name.lower(): version for name, version in pinned.items()}
    return all(importlib.metadata.version(name) == lower[name.lower()] for name in names)


def test_setup_installs_pinned_versions_and_tests_itself(autograder: Path) -> None:
    if not _installed_as_pinned():
        pytest.skip("this environment has other versions than constraints.txt, and the test installs nothing")
    process = _start(autograder, "setup.sh")
    printed = process.communicate(timeout=120)[0]
    assert process.returncode == 0, printed
    assert "self-test passed: the solution got 30 of 30 points" in printed
    assert (autograder / "source").stat().st_mode & 0o077 == 0, "nobody else gets to what is in there"


def test_the_self_test_fails_where_the_solution_does_not_get_all_points(
    autograder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solution = autograder / "source/assignments/toy/solution/solution.py"
    # Right where the expected values are computed, wrong in the sandbox.
    where = "x / 2.0 if 'slamcmp.grading.run.grader' in sys.modules else 0.0"
    solution.write_text(f"{solution.read_text()}\nimport sys\ndef half(x): return {where}\n")
    monkeypatch.setenv("AUTOGRADER_ROOT", str(autograder))
    with pytest.raises(DataError, match="self-test failed: the solution got 20 of 30 points"):
        self_test(gradescope_layout())


_SLOW = SOLUTION.replace("return x / 2.0", "\n    import time; time.sleep(1.0); return x / 2.0")


def _set_time_limit(root: Path, seconds: float) -> None:
    path = root / "source" / "settings.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "time_limit_s": seconds}))


def _assert_cut_short(results: dict[str, Any]) -> None:
    assert results["score"] == 10.0
    assert sum(test["max_score"] for test in results["tests"]) == 30.0, "points not reached are points"
    assert results["tests"][1]["output"] == "not run\nNot run: the grading had ended before."
    assert "did not come to its end" in results["output"]
    assert results["extra_data"]["complete"] is False


def test_a_grading_that_takes_too_long_keeps_what_was_scored(autograder: Path) -> None:
    _set_time_limit(autograder, 3.0)
    results, printed = _grade(autograder, _SLOW)
    _assert_cut_short(results)
    assert "longer than the time that the course allows" in results["output"]
    assert "The grading ended early: timed_out" in printed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL], ids=["stopped", "killed"])
def test_a_platform_that_ends_the_grader_finds_what_was_scored(autograder: Path, number: int) -> None:
    _submit(autograder, _SLOW)
    process = _start(autograder)
    until = time.monotonic() + 30
    while time.monotonic() < until:
        path = autograder / "results" / "results.json"
        if path.exists() and path.stat().st_size and _results(autograder)["score"] == 10.0:
            break
        time.sleep(0.05)
    process.send_signal(number)
    process.communicate(timeout=30)
    _assert_cut_short(_results(autograder))
    mark = str(process.pid).encode()
    until = time.monotonic() + 5
    while time.monotonic() < until:
        left = [
            words
            for entry in Path("/proc").glob("[0-9]*")
            if (words := _words(entry)) and b"slamcmp.grading.run.grade_process" in words and mark in words
        ]
        if not left:
            break
        time.sleep(0.05)
    assert left == []


def _words(entry: Path) -> list[bytes]:
    try:
        return (entry / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return []


def test_a_grader_that_cannot_start_leaves_a_result(autograder: Path) -> None:
    (autograder / "venv").unlink()
    process = _start(autograder)
    process.communicate(timeout=30)
    assert process.returncode != 0
    assert _results(autograder)["score"] == 0
    assert _results(autograder)["output"].startswith("The grader could not start. This is not your fault")


def test_a_crash_of_the_grader_leaves_what_was_scored_and_tells_the_staff(
    autograder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))
    layout = Layout(
        autograder / "source",
        autograder / "submission",
        autograder / "results" / "results.json",
        None,
        write=prairielearn_layout().write,
    )
    _submit(autograder, f"{SOLUTION}\n# the grader raises\n")
    outcome = run_autograder(layout, grader="tests.grading.fake_grader:grade")
    assert (outcome.score, outcome.max_score, outcome.complete) == (10.0, 30.0, False)
    assert _results(autograder)["score"] == pytest.approx(1 / 3)
    assert "RuntimeError: a fault in the grader" in capfd.readouterr().out


def test_prairielearn_reads_the_same_bundle(
    autograder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "student").mkdir()
    (tmp_path / "student" / "toy.py").write_text(SOLUTION)
    monkeypatch.setenv("GRADE_ROOT", str(tmp_path))
    monkeypatch.setenv("AUTOGRADER_ROOT", str(autograder))
    run_autograder(prairielearn_layout())
    results = json.loads((tmp_path / "results" / "results.json").read_text())
    assert results["score"] == 1.0
    assert [test["name"] for test in results["tests"]] == ["1 Double", "2 Half"]


def test_the_student_is_the_group_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "submission_metadata.json"
    for users, student in (
        ([{"email": "b@x"}, {"email": "a@x"}], "a@x+b@x"),
        ([{"id": 7}], "7"),
        ([], "student"),
        ("nonsense", "student"),
    ):
        path.write_text(json.dumps({"users": users}))
        assert student_of(path) == student
    assert student_of(tmp_path / "absent") == "student"


def test_equal_content_makes_an_equal_bundle_and_nobody_else_reads_it(tmp_path: Path) -> None:
    folder = toy_assignment.write(tmp_path)
    first = write_bundle(folder, tmp_path / "first.zip", secret=SECRET)
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "cases.pyc").write_bytes(b"x")
    again = write_bundle(folder, tmp_path / "again.zip", secret=SECRET)
    assert again.read_bytes() == first.read_bytes()
    assert again.stat().st_mode & 0o077 == 0
    names = set(zipfile.ZipFile(again).namelist())
    assert {"setup.sh", "run_autograder", "constraints.txt", "requirements.txt", "secret"} <= names
    assert "package/slamcmp/grading/results/templates/grade.html.j2" in names
    assert not [name for name in names if "pycache" in name]


def test_without_a_checkout_the_installed_versions_are_pinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamcmp.grading.run.bundle.PACKAGE", tmp_path / "slamcmp")
    lines = constraints().splitlines()
    assert f"numpy=={np.__version__}" in lines
    assert not [line for line in lines if line.startswith("slamcmp==")]


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match="no assignment folder"):
        write_bundle(tmp_path / "absent", tmp_path / "a.zip", secret=SECRET)
    layout = Layout(tmp_path, tmp_path, tmp_path / "results.json", None, write=prairielearn_layout().write)
    with pytest.raises(DataError, match="make the bundle again"):
        run_autograder(layout)
