"""The staff's umask is no part of the grade: with 077 the sandbox's own folders stay passable."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.session import SandboxSession

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox needs Linux")


@pytest.fixture
def _private_umask() -> Iterator[None]:
    before = os.umask(0o077)
    yield
    os.umask(before)


@pytest.mark.usefixtures("_private_umask")
def test_a_submission_with_folders_runs_under_a_private_umask() -> None:
    files = {
        "main.py": b"from lib.deep.helper import double\n",
        "lib/deep/helper.py": b"def double(x): return 2 * x\n",
    }
    policy = Policy(packages=("numpy",), memory_bytes=512 << 20)
    with SandboxSession(Submission("s", "folder", files, "main.py"), policy, accept_weak=True) as session:
        assert session.call("double", 21) == 42
