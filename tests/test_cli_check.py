"""``slamcmp check`` as a student calls it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.experiment.test_conformance import example


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "slamcmp", "check", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_good_back_end_is_told_so(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(example())
    done = call(f"{path}:MyEkf", "--json")
    assert done.returncode == 0, done.stderr
    findings = json.loads(done.stdout)
    assert all(finding["passed"] for finding in findings)


def test_a_fault_gives_exit_code_1_and_its_cause(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(example().replace("A @ self.P @ A.T", "A.T @ self.P @ A"))
    done = call(f"{path}:MyEkf")
    assert done.returncode == 1
    assert "not A^T P A" in done.stdout.replace("\n     ", " ")


def test_usage_errors_give_exit_code_2(tmp_path: Path) -> None:
    for arguments, message in (
        (["ekf_slam", "--set", "gate=["], "--set 'gate=[': '[' is not a YAML value: "),
        (["isam"], "did you mean 'isam2'?"),
        (["isam2", "--set", "relinearize_skip=x"], "relinearize_skip: Input should be a valid integer"),
        (["isam2", "--set", "relinearize_skip"], "NAME=VALUE is needed"),
        ([f"{tmp_path}/none.py:X"], "there is no file"),
    ):
        done = call(*arguments)
        assert done.returncode == 2
        assert message in done.stderr
        assert "Traceback" not in done.stderr
