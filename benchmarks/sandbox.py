"""What the sandbox costs: its start over a bare worker, and a frame's way there and back.

    python benchmarks/sandbox.py

Start: median over interleaved pairs of (sandboxed session, bare Python process with the same imports).
Round trip: ``step`` with a frame of 10 observations; back come pose, P and the landmark blocks (position and
2×2 covariance each), or the whole n×n covariance as well. The back end in the worker only hands out arrays it
holds, so what is timed is the pipe, the protocol and the checks on both sides.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import statistics
import subprocess
import sys
import time

import numpy as np

from slamcmp.grading.hand_in.submission import Submission
from slamcmp.grading.sandbox.process import ROOT
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Frame, Problem

START_LIMIT_MS, ROUND_TRIP_LIMIT_MS = 50.0, 0.5

ECHO = b"""
import numpy as np
from slamcmp.types import Estimate, Landmarks

class Echo:
    def __init__(self, problem, *, landmarks):
        n = 3 + 2 * landmarks
        self.joint = np.eye(n)
        self.map = Landmarks(np.arange(landmarks), np.zeros((landmarks, 2)), np.zeros((landmarks, 2, 2)))

    def update(self, frame):
        pass

    def estimate(self):
        return Estimate(np.eye(3), np.eye(3))

    def landmarks(self):
        return self.map

    def joint_covariance(self):
        return self.joint
"""
SUBMISSION = Submission("echo", "file", {"echo.py": ECHO}, "echo.py")
BARE = f"""
import sys
sys.path.insert(0, {ROOT!r})
import numpy, slamcmp.types, slamcmp.models.sensors
import slamcmp.grading.sandbox.pipes.protocol, slamcmp.grading.sandbox.inside.student
print("ready", flush=True)
sys.stdin.read()
"""


def main() -> int:
    over = start_over_bare_ms(pairs=20)
    within = [over <= START_LIMIT_MS]
    print(f"start over a bare worker: {over:.1f} ms (at most {START_LIMIT_MS:g})")
    for landmarks in (0, 100, 500):
        for joint in (False, True):
            median, slow = round_trip_ms(landmarks, joint=joint, frames=1000 if landmarks < 500 else 200)
            n = 3 + 2 * landmarks
            what = "pose, P, landmark blocks" + (f", {n}×{n} covariance" if joint else "")
            limit = f" (at most {ROUND_TRIP_LIMIT_MS:g})" if n == 203 else ""
            print(f"round trip, n = {n}, {what}: median {median:.3f} ms{limit}, 99 % {slow:.3f} ms")
            if n == 203:
                within.append(median <= ROUND_TRIP_LIMIT_MS)
    return 0 if all(within) else 1


def start_over_bare_ms(*, pairs: int) -> float:
    """Median difference; one of each in turn, so that a busy machine slows both."""
    started_sandbox()
    differences, bares = [], []
    for _ in range(pairs):
        bare = started_bare()
        differences.append(started_sandbox() - bare)
        bares.append(bare)
    print(f"bare worker: {statistics.median(bares) * 1e3:.1f} ms")
    return statistics.median(differences) * 1e3


def started_bare() -> float:
    """Seconds until a bare process has imported everything."""
    begun = time.perf_counter()
    words = [sys.executable, "-P", "-s", "-u", "-X", "utf8", "-c", BARE]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    taken = time.perf_counter() - begun
    process.communicate()
    return taken


def started_sandbox() -> float:
    """Seconds until a session is closed, proved and has loaded its submission."""
    begun = time.perf_counter()
    with SandboxSession(SUBMISSION, accept_weak=True):
        return time.perf_counter() - begun


def round_trip_ms(landmarks: int, *, joint: bool, frames: int) -> tuple[float, float]:
    """Median and 99th percentile."""
    m = 10
    frame = Frame(
        1, 0.1, np.eye(3), np.eye(3), np.arange(m), np.ones((m, 2)), np.broadcast_to(np.eye(2), (m, 2, 2))
    )
    problem = Problem(np.eye(3), np.eye(3), make_sensor("range_bearing", {}))
    times = []
    with SandboxSession(SUBMISSION, accept_weak=True) as session:
        handle = session.construct("Echo", problem, {"landmarks": landmarks})
        for _ in range(frames):
            begun = time.perf_counter()
            session.step(handle, frame, landmarks=True, joint_covariance=joint)
            times.append((time.perf_counter() - begun) * 1e3)
    return statistics.median(times), float(np.quantile(times, 0.99))


if __name__ == "__main__":
    sys.exit(main())
