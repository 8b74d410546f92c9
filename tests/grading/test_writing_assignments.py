"""docs/writing-assignments.md followed word for word, the commands behind it, and what the gate finds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from slamcmp.errors import UsageError
from slamcmp.grading.assignment.description import load_assignment
from slamcmp.grading.assignment.reference import reference
from slamcmp.grading.assignment.skeleton import write_skeleton
from slamcmp.grading.run.publish import check_publishable, gate
from slamcmp.support.configuration.config_errors import ConfigError

GUIDE = (Path(__file__).parents[2] / "docs" / "writing-assignments.md").read_text(encoding="utf-8")
FILE = re.compile(r"^`([\w/.]+)`\n\n````\w+\n(.*?)^````$", re.MULTILINE | re.DOTALL)


def command(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "slamcmp", "assignment", *words], cwd=folder, capture_output=True, text=True
    )


def test_the_guides_example_is_ready_to_publish(tmp_path: Path) -> None:
    files = dict(FILE.findall(GUIDE))
    for place, text in files.items():
        path = tmp_path / "fusion" / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    answer = command("verify", "fusion", "--in-process", "--seeds", "10", folder=tmp_path)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert answer.stdout.splitlines()[-1] == "ready to publish"
    assert answer.stdout.count("\nok   solution, seed ") == 10
    assert answer.stdout.count("\nok   mutant ") == len(re.findall("- name", files["mutants.yaml"]))
    # And it is what the command writes.
    made = command("new", "fusion", "made", folder=tmp_path)
    assert made.returncode == 0
    written = {
        path.relative_to(tmp_path / "made" / "fusion").as_posix(): path.read_text(encoding="utf-8")
        for path in (tmp_path / "made" / "fusion").rglob("*.*")
    }
    assert written == files


def test_the_reference_in_the_guide_is_current(tmp_path: Path) -> None:
    told = GUIDE.partition("<!-- reference: begin -->\n\n")[2].partition("\n<!-- reference: end -->")[0]
    assert told == reference()
    assert command("reference", folder=tmp_path).stdout == reference()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")
def test_a_new_assignment_of_any_name_passes_in_the_sandbox(tmp_path: Path) -> None:
    write_skeleton("wheel_odometry_2", tmp_path)
    found = check_publishable(tmp_path / "wheel_odometry_2", seeds=1, mutants=1, accept_weak_sandbox=True)
    assert found == []


@pytest.mark.parametrize("name", ["Fusion", "2d", "a-b", "../x", "", "a b", "ä"])
def test_a_name_that_no_module_can_have_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="small letters, digits"):
        write_skeleton(name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    write_skeleton("fusion", tmp_path)
    with pytest.raises(UsageError, match="is there already"):
        write_skeleton("fusion", tmp_path)


@pytest.mark.parametrize(
    ("file", "old", "new", "who", "what"),
    [
        ("starter.py", "raise NotImplementedError", "return mean, variance", "starter", "earns marks in"),
        ("public_tests.py", "(2.0, 0.5)", "(2.0, 0.6)", "public tests", "the solution fails"),
        ("public_tests.py", "from fusion", "from fission", "public tests", "fusion.py is handed in"),
        (
            "starter.py",
            "raise NotImplementedError",
            "return mean + variance * (z - mean) / (variance + R), variance * R / (variance + R)",
            "public tests",
            "the starter passes them all",
        ),
        (
            "mutants.yaml",
            "new: gain = 0.5\n",
            "new: gain = variance / (R + variance)\n",
            "average",
            "loses no",
        ),
        ("mutants.yaml", "new: gain = 0.5\n", "new: gain = R / (R + variance)\n", "average", "is not named"),
        # Who believes the truth from the start does best to do nothing.
        ("cases.py", "truth + generator.normal() * 2.0, 4.0", "truth, 1e-9", "echo", "earns marks"),
    ],
)
def test_the_gate_finds(tmp_path: Path, file: str, old: str, new: str, who: str, what: str) -> None:
    write_skeleton("fusion", tmp_path)
    path = tmp_path / "fusion" / file
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")
    findings = check_publishable(tmp_path / "fusion", seeds=1, sandboxed=False)
    assert any(who in each.who and what in each.what for each in findings), findings


@pytest.mark.parametrize("field", ["{your}", "{yours", "{}", "{yours.x.y}", "{0}"])
def test_a_message_that_cannot_be_filled_in_has_a_place(tmp_path: Path, field: str) -> None:
    write_skeleton("fusion", tmp_path)
    path = tmp_path / "fusion" / "mutants.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace("{yours:.3g}", field), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_assignment(tmp_path / "fusion")
    (line,) = caught.value.lines
    assert line.startswith(f"{path}:13:")
    assert "{{ and }}" in line


def test_verify_tells_what_is_wrong_and_fails(tmp_path: Path) -> None:
    write_skeleton("fusion", tmp_path)
    starter = tmp_path / "fusion" / "starter.py"
    starter.write_text(starter.read_text().replace("raise NotImplementedError", "return mean, variance / 2"))
    answer = command("verify", "fusion", "--in-process", "--mutants", "0", folder=tmp_path)
    assert answer.returncode == 1
    assert "\nFAIL starter" in answer.stdout
    assert answer.stdout.splitlines()[-1] == "1 fault"
    starter.unlink()
    answer = command("verify", "fusion", "--in-process", folder=tmp_path)
    assert (answer.returncode, answer.stderr.count("\n")) == (3, 1)
    assert "starter.py: no such file; an assignment needs it" in answer.stderr


def test_steps_tell_points_and_seconds(tmp_path: Path) -> None:
    write_skeleton("fusion", tmp_path)
    steps = list(gate(tmp_path / "fusion", seeds=2, mutants=0, sandboxed=False))
    assert [(step.who, step.wanted, step.earned) for step in steps[:4]] == [
        ("public tests", "passed", None),
        ("solution, seed 0", "all", 100.0),
        ("solution, seed 1", "all", 100.0),
        ("starter", "nothing", 0.0),
    ]
    assert all(0 < step.seconds < 60 for step in steps)
