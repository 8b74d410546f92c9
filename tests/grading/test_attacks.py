"""Attacks on the grader: none may win in the sandbox, and those marked so must win without it.

The controls matter as much as the attacks: "stopped" means nothing where the attack is broken, or where
honest code is stopped as well.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from slamcmp.grading.sandbox.errors import StudentCrashed, StudentError, StudentTimeout
from slamcmp.grading.sandbox.session import SandboxSession
from tests.grading.arena import (
    EVERY_LAYER,
    POLICY,
    Arena,
    answers_honestly,
    attack_submission,
    honest_submission,
    run_attack,
)
from tests.grading.catalogue import DOCUMENT, Attack, attacks, documented, table

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")

ATTACKS = attacks()
# Without root and bubblewrap, names outside stay visible to stat: said in the level, and in the document.
NAMES_VISIBLE = {"look_up_file"}
# Winning, they leave a process behind that cannot run another attack.
CHANGES_ITS_PROCESS = {"raising rights", "resources"}


@pytest.fixture(scope="module")
def arena() -> Iterator[Arena]:
    made = Arena()
    yield made
    made.close()


@pytest.fixture(scope="module")
def honest(arena: Arena) -> Iterator[SandboxSession]:
    """Runs beside all attacks: one of its own kind, and something for them to steal from."""
    with SandboxSession(honest_submission(arena.secret), POLICY, accept_weak=True) as session:
        yield session


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_no_attack_wins(attack: Attack, arena: Arena, honest: SandboxSession) -> None:
    if honest.level in ("reads unprotected", "weak"):
        pytest.skip(f"this machine gives level {honest.level!r} only: {dict(honest.layers)}")
    if honest.level == "names visible" and attack.name in NAMES_VISIBLE:
        pytest.skip("level 'names visible': no root, no bubblewrap")
    won, seen = run_attack(arena, attack.name, deadline_s=attack.deadline_s)
    assert won == [], seen
    assert answers_honestly(honest)


def test_attacks_win_without_the_sandbox(arena: Arena, honest: SandboxSession) -> None:
    """The control. Attacks of a kind that needs root to begin with are left out where not root."""
    waiting = [attack for attack in ATTACKS if attack.control]
    submission = attack_submission(*(attack.name for attack in waiting))
    lost = []
    session: SandboxSession | None = None
    for attack in waiting:
        if session is None:
            session = SandboxSession(submission, POLICY, accept_weak=True, without=EVERY_LAYER)
            assert session.level == "weak"
        target = arena.prepare()
        answer, alive = None, attack.kind not in CHANGES_ITS_PROCESS
        with contextlib.suppress(StudentError):
            try:
                answer = session.call("run", attack.name, target)
            except (StudentCrashed, StudentTimeout):
                alive = False
        if not arena.damage(answer, ""):
            lost.append(attack.name)
        if not alive:
            session.close()
            session = None
    if session is not None:
        session.close()
    needs_root = (
        {attack.name for attack in ATTACKS if attack.kind == "raising rights"} if os.geteuid() else set()
    )
    assert set(lost) <= needs_root
    assert answers_honestly(honest)


def test_the_suite_is_as_large_as_promised() -> None:
    assert len(ATTACKS) >= 40
    assert len({attack.kind for attack in ATTACKS}) >= 10
    assert sum(attack.control for attack in ATTACKS) >= 40


def test_every_attack_is_documented_with_its_defence() -> None:
    assert documented() == table(), f"run python -m tests.grading.catalogue to update {DOCUMENT.name}"


def test_no_process_outlives_a_killed_grader(tmp_path: Path, staging_area: Path) -> None:
    script = f"""
import sys
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.grading.hand_in.submission import Submission
source = b"def loop():\\n    while True:\\n        pass\\n"
session = SandboxSession(Submission("s", "file", {{"s.py": source}}, "s.py"), accept_weak=True)
open({str(tmp_path / "pid")!r}, "w").write(str(session._worker.pid))
print("ready", flush=True)
session.call("loop", deadline_s=60)
"""
    grader = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    assert grader.stdout is not None
    assert grader.stdout.readline() == b"ready\n"
    worker = Path("/proc") / (tmp_path / "pid").read_text()
    assert worker.exists()
    grader.kill()
    grader.wait()
    for _ in range(100):
        if not worker.exists() or ") Z" in (worker / "stat").read_text():
            return
        time.sleep(0.05)
    pytest.fail("the worker still runs 5 s after its grader was killed")
