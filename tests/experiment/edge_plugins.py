"""Back ends that meet the edges of the machinery around them."""

import os
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from tests.user_plugins import DeadReckoning


class Late(DeadReckoning):
    """Quick frames, then one that takes longer than all limits."""

    def misbehave(self) -> None:
        time.sleep(60.0)

    def diagnostics(self) -> dict[str, float]:
        return {"n": float(len(self.poses))}


class LeavesAThread(DeadReckoning):
    def __init__(self, problem) -> None:
        super().__init__(problem)
        threading.Thread(target=time.sleep, args=(3600,)).start()


class LeavesChildren(DeadReckoning):
    """One child in its group, one in a session of its own, one whose parent ends at once."""

    def __init__(self, problem, *, pids: str = "", then_hang: bool = False) -> None:
        super().__init__(problem)
        plain = subprocess.Popen(["sleep", "3600"])
        apart = subprocess.Popen(["sleep", "3600"], start_new_session=True)
        orphan = subprocess.check_output(
            ["sh", "-c", "setsid sleep 3600 >/dev/null 2>&1 & echo $!"], text=True
        )
        Path(pids).write_text(f"{plain.pid} {apart.pid} {orphan.strip()}")
        self.then_hang = then_hang

    def misbehave(self) -> None:
        if self.then_hang:
            time.sleep(3600)


class LeavesFiles(DeadReckoning):
    def __init__(self, problem, *, told: str = "") -> None:
        super().__init__(problem)
        descriptor, name = tempfile.mkstemp()
        os.write(descriptor, b"x" * 1000)
        Path(told).write_text(name)


class PrintsALot(DeadReckoning):
    def update(self, frame) -> None:
        super().update(frame)
        for _ in range(100):
            print("x" * 10_000, flush=True)
        if frame.k == 39:
            print("the last words", flush=True)


class UnprintableText(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")


class Says(DeadReckoning):
    """Fails with a text that files and tables find hard to hold."""

    def __init__(self, problem, *, what: str = "surrogate") -> None:
        super().__init__(problem)
        self.what = what

    def misbehave(self) -> None:
        if self.what == "surrogate":
            raise ValueError("a name like \ud800\udfff.txt and a \0 in it")
        if self.what == "long":
            raise ValueError("y" * 1_000_000)
        if self.what == "unprintable":
            raise UnprintableText
        raise BaseException("of no usual kind")


class KilledOnce(DeadReckoning):
    """The first time it is killed from outside, as by a system that is out of memory."""

    def __init__(self, problem, *, marker: str = "", number: int = int(signal.SIGKILL)) -> None:
        super().__init__(problem)
        self.marker, self.number = Path(marker), number

    def misbehave(self) -> None:
        if not self.marker.exists():
            self.marker.write_text("")
            os.kill(os.getpid(), self.number)
            time.sleep(60)


class ClosesFiles(DeadReckoning):
    """Closes all that its process has open, its own result's way out among it."""

    def misbehave(self) -> None:
        os.closerange(0, 200)


class NamesOddly(DeadReckoning):
    """Calls its diagnostics as no file or table calls anything."""

    def diagnostics(self) -> dict[str, float]:
        k = float(len(self.poses))
        return {"plain": k, "": k, "x\ud800": k, "y" * 100_000: k, "a/../b\0": k}


class NamesOddlyAndDies(NamesOddly):
    def misbehave(self) -> None:
        os._exit(3)
