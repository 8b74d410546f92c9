"""Where attacks take place: things worth stealing or breaking, and what became of them afterwards."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.errors import SandboxError, StudentError
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.grading.sandbox.walls.kernel import machine
from slamcmp.grading.sandbox.walls.syscalls import DENIED, FILTERED, number
from tests.grading.catalogue import FOLDER

EVERY_LAYER = ("private root", "own uid", "limits", "Landlock", "seccomp", "bubblewrap")
POLICY = Policy(packages=("numpy",), memory_bytes=640 << 20, load_s=2.0, request_s=4.0, reply_bytes=1 << 20)

# Hands the attack the pipes' numbers, which it could find by trying, and offers an honest function beside it.
_ENTRY = """
import importlib
import sys


def run(name, target):
    frame = sys._getframe()
    while not hasattr(frame.f_locals.get("self"), "_operations"):
        frame = frame.f_back
    worker = frame.f_locals["self"]
    target["pipes"] = (worker._request, worker._reply)
    return importlib.import_module(name).attack(target)


def double(values):
    return 2 * values
"""


class Arena:
    """Targets of the attacks, with everything undone at the end."""

    def __init__(self) -> None:
        self.secret = f"SECRET{secrets.token_hex(12)}"
        self._memory = ctypes.create_string_buffer(self.secret.encode())
        self._base = Path(tempfile.mkdtemp(prefix="arena-"))
        self._base.chmod(0o755)
        self._signals = 0
        self._handlers = {
            which: signal.signal(which, self._signalled) for which in (signal.SIGUSR1, signal.SIGIO)
        }
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._victim: subprocess.Popen[bytes] | None = None
        (self._base / "private").mkdir(mode=0o700)
        self._private = self._file("private/file", self.secret, 0o600)
        self._public = self._file("file", self.secret, 0o644)
        self._descriptor = os.open(self._private, os.O_RDONLY)
        self.token_name = f"slamcmp-attack-{os.getpid()}"

    def close(self) -> None:
        for which, handler in self._handlers.items():
            signal.signal(which, handler)
        self._listener.close()
        os.close(self._descriptor)
        if self._victim is not None:
            self._victim.kill()
            self._victim.wait()
        shutil.rmtree(self._base, ignore_errors=True)

    def prepare(self) -> dict[str, Any]:
        """Set everything up anew; what the attack is told."""
        self._signals = 0
        shutil.rmtree(self._base / "writable", ignore_errors=True)
        self._writable = self._base / "writable"
        self._writable.mkdir()
        self._writable.chmod(0o777)
        self._file("writable/victim", "intact", 0o666)
        if self._victim is None or self._victim.poll() is not None:
            self._victim = subprocess.Popen(["sleep", "600"], env={"SECRET": self.secret})
        self._before = self._state()
        numbers = {name: number(name, machine()) for name in (*DENIED, *FILTERED)}
        return {
            "private_file": self._private,
            "public_file": self._public,
            "writable": str(self._writable),
            "victim_file": str(self._writable / "victim"),
            "other_submission": f"{tempfile.gettempdir()}/slamcmp-*/submission/honest.py",
            "parent": os.getpid(),
            "victim": self._victim.pid,
            "address": ctypes.addressof(self._memory),
            "length": len(self.secret),
            "secret_descriptor": self._descriptor,
            "port": self._listener.getsockname()[1],
            "token_name": self.token_name,
            "nr": {name: value for name, value in numbers.items() if value is not None},
        }

    def damage(self, answer: Any, printed: str) -> list[str]:
        """Every way in which the attack won."""
        told = _flat(answer) + printed
        won = []
        if self.secret in told:
            won.append("the secret came back")
        if "WON" in told:
            won.append("it says so itself")
        for name, value in self._state().items():
            if value != self._before[name]:
                won.append(f"{name} changed")
        if self._signals:
            won.append("a signal arrived")
        with contextlib.suppress(BlockingIOError):
            self._listener.accept()
            won.append("a connection arrived")
        for path in Path("/dev/shm").glob(f"{self.token_name}*"):
            path.unlink()
            won.append("shared memory is left")
        if not np.allclose(1.0, 1.0) or np.allclose(1.0, 2.0) or abs(-1) != 1:
            won.append("the grader's functions are patched")
        return won

    def _state(self) -> dict[str, Any]:
        assert self._victim is not None
        victim = self._victim.pid
        entries = sorted(os.listdir(self._writable))
        state: dict[str, Any] = {"the folder": entries, "the other process": self._victim.poll()}
        if "victim" in entries:
            seen = os.lstat(self._writable / "victim")
            state["the file"] = (seen.st_mode, seen.st_nlink, seen.st_mtime_ns, seen.st_size, seen.st_uid)
        else:
            state["the file"] = None
        if self._victim.poll() is None:
            state["limits"] = resource.prlimit(victim, resource.RLIMIT_NOFILE)
            state["affinity"] = os.sched_getaffinity(victim)
        else:
            state["limits"] = state["affinity"] = None
        return state

    def _signalled(self, *_: object) -> None:
        self._signals += 1

    def _file(self, name: str, content: str, mode: int) -> str:
        path = self._base / name
        path.write_text(content)
        path.chmod(mode)
        return str(path)


def attack_submission(*names: str) -> Submission:
    """A submission with these attacks, chosen by ``run(name, target)``; one alone is imported at once."""
    files = {f"{name}.py": (FOLDER / f"{name}.py").read_bytes() for name in names}
    entry = _ENTRY + (f"\nimport {names[0]}\n" if len(names) == 1 else "")
    return Submission("attack", "folder", {**files, "entry.py": entry.encode()}, "entry.py")


def honest_submission(secret: str) -> Submission:
    """What must keep working beside every attack, and holds something to be stolen by other submissions."""
    source = f"# {secret}\nimport numpy as np\n\n\ndef double(values):\n    return 2 * np.asarray(values)\n"
    return Submission("honest", "file", {"honest.py": source.encode()}, "honest.py")


def answers_honestly(session: SandboxSession) -> bool:
    """Whether the session's ``double`` gives the right numbers."""
    values = np.arange(4.0)
    return bool(np.array_equal(session.call("double", values), 2 * values))


def run_attack(
    arena: Arena, name: str, *, deadline_s: float | None, without: tuple[str, ...] = ()
) -> tuple[list[str], str]:
    """(how it won, what the grader saw) for one attack in a session of its own."""
    target = arena.prepare()
    answer: Any = None
    seen, won = "answered", []
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.monotonic()
    session: SandboxSession | None = None
    try:
        session = SandboxSession(attack_submission(name), POLICY, accept_weak=True, without=without)
        try:
            answer = session.call("run", name, target, deadline_s=deadline_s)
        except StudentError as error:
            seen, answer = f"StudentError: {error}", [error.type_name, error.message]
        if "advance" in name:
            # Until its thread has written what it invents.
            time.sleep(0.1)
        if not answers_honestly(session):
            won.append("a later answer is forged")
        if not session.cpu_s() > 0:
            won.append("the processor time is wrong")
    except SandboxError as error:
        seen = f"{type(error).__name__}: {error}"
    if any(ord(letter) < 32 and letter != "\n" for letter in seen):
        won.append("control characters in the message")
    printed = ""
    if session is not None:
        session.close()
        printed = session.output
        if len(printed) > POLICY.output_bytes + 100:
            won.append("the output is kept whole")
        if _left_over(session._worker.pid):
            won.append("processes are left")
    if time.monotonic() - started > 15:
        won.append("the grader waited too long")
    if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory > 100_000:
        won.append("the grader's memory grew")
    return won + arena.damage(answer, printed), seen


def _left_over(session: int) -> bool:
    """Whether a process of the worker's session still runs."""
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                fields = Path(entry.path, "stat").read_text().rsplit(")", 1)[1].split()
                if int(fields[3]) == session and fields[0] not in "ZX":
                    return True
    return False


def _flat(answer: Any) -> str:
    if isinstance(answer, np.ndarray):
        return bytes(answer.astype(np.uint8)).decode(errors="replace") if answer.size < 10_000 else ""
    if isinstance(answer, list | tuple):
        return " ".join(_flat(item) for item in answer)
    if isinstance(answer, dict):
        return " ".join(f"{key}={_flat(value)}" for key, value in answer.items())
    return str(answer)
