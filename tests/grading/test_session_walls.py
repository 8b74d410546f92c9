"""A session tells how well it is closed, and leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from slamcmp.grading.sandbox.errors import (
    SandboxError,
    SandboxUnavailable,
)
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.grading.sandbox.walls import kernel
from slamcmp.grading.sandbox.walls.proofs import MEANING
from slamcmp.grading.sandbox.walls.readable import world_reachable
from tests.grading.sandboxed import FUNCTIONS, submission

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


@pytest.fixture(scope="module")
def functions() -> Iterator[SandboxSession]:
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        yield session


def test_hidden_grading_is_refused_without_read_protection() -> None:
    unprotected = ("private root", "own uid", "Landlock", "bubblewrap")
    with pytest.raises(SandboxUnavailable, match="cannot keep hidden tests from a submission") as caught:
        SandboxSession(submission(FUNCTIONS), without=unprotected)
    assert "read_public_file" in str(caught.value)
    with SandboxSession(submission(FUNCTIONS), without=unprotected, accept_weak=True) as session:
        assert session.level == "reads unprotected"
        assert session.proofs["read_public_file"] == "failed"
        assert session.proofs["open_socket"] == "proved"
        assert session.layers["Landlock"] == "not active: switched off"
    with SandboxSession(
        submission(FUNCTIONS), without=(*unprotected, "seccomp"), accept_weak=True
    ) as session:
        assert session.level == "weak"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_as_root_everything_is_proved(functions: SandboxSession) -> None:
    if "not active" in functions.layers["private root"] + functions.layers["Landlock"]:
        pytest.skip(f"this machine lacks a layer: {dict(functions.layers)}")
    assert functions.level == "strong"
    assert set(functions.layers.values()) == {"active"}
    assert dict(functions.proofs) == dict.fromkeys(MEANING, "proved")


def test_nothing_is_left_behind(staging_area: Path) -> None:
    def state() -> tuple[int, int, int, list[str]]:
        staged = os.listdir(staging_area)
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        return len(os.listdir("/proc/self/fd")), len(children), kernel.prctl(kernel.PR_GET_DUMPABLE), staged

    before = state()
    with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
        assert kernel.prctl(kernel.PR_GET_DUMPABLE) == 0
        assert len(os.listdir(staging_area)) == 1
        session.call("talk", 10)
    for source in ("raise ValueError", "import os; os._exit(1)"):
        with pytest.raises(SandboxError):
            SandboxSession(submission(source), accept_weak=True)
    assert state() == before


def test_what_a_killed_grader_left_is_removed(staging_area: Path) -> None:
    gone, alive = 2**22 + 1, os.getpid()
    for name, age_s in ((f"slamcmp-{gone}-a", 7200), (f"slamcmp-{gone}-b", 60), (f"slamcmp-{alive}-c", 7200)):
        (staging_area / name / "submission").mkdir(parents=True)
        os.utime(staging_area / name, (time.time() - age_s,) * 2)
    SandboxSession(submission(FUNCTIONS), accept_weak=True).close()
    assert sorted(os.listdir(staging_area)) == sorted([f"slamcmp-{gone}-b", f"slamcmp-{alive}-c"])


def test_sessions_work_side_by_side_in_threads() -> None:
    results: dict[int, float] = {}

    def work(value: int) -> None:
        with SandboxSession(submission(FUNCTIONS), accept_weak=True) as session:
            time.sleep(0.1)
            results[value] = session.call("echo", value)

    threads = [threading.Thread(target=work, args=(value,)) for value in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == {0: 0, 1: 1, 2: 2}


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_another_user_gets_read_protection_too(tmp_path: Path) -> None:
    if not all(world_reachable(path) for path in (sys.executable, os.__file__, np.__file__, __file__)):
        pytest.skip("the interpreter, numpy or slamcmp lie where another user may not read")
    script = """
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.grading.hand_in.submission import Submission
with SandboxSession(Submission("s", "file", {"s.py": b"def f(x): return x"}, "s.py")) as session:
    assert session.call("f", 3) == 3
    print(session.level, *(name for name, outcome in session.proofs.items() if outcome != "proved"))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], user=65534, group=65534, extra_groups=[], cwd="/",
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": os.environ["PATH"]},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if "SandboxUnavailable" in done.stderr:
        pytest.skip(f"no Landlock and no bubblewrap here: {done.stderr.splitlines()[-1]}")
    assert done.stdout.strip() in ("strong", "names visible look_up_file"), done.stderr
