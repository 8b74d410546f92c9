"""Submissions that the tests of a sandboxed session share."""

from __future__ import annotations

from slamcmp.grading.hand_in.submission import Submission

DEAD_RECKONING = """
import numpy as np
from slamcmp.types import Estimate, Landmarks, Trajectory

class DeadReckoning:
    def __init__(self, problem, *, inflation=1.0):
        self.T, self.P, self.inflation = problem.T_world_body, problem.P, inflation
        self.sensor, self.seen, self.path = problem.sensor, {}, []

    def update(self, frame):
        self.T = self.T @ frame.T_prev_body
        self.P = self.P + self.inflation * frame.Q
        self.path.append((frame.t, self.T))
        for i, z in zip(frame.ids, frame.z):
            self.seen.setdefault(int(i), self.sensor.invert(self.T, z))

    def estimate(self):
        return Estimate(self.T, self.P)

    def landmarks(self):
        positions = np.array(list(self.seen.values())).reshape(-1, 2)
        return Landmarks(list(self.seen), positions, np.tile(np.eye(2), (len(positions), 1, 1)))

    def joint_covariance(self):
        return np.eye(3 + 2 * len(self.seen))

    def trajectory(self):
        return Trajectory([t for t, _ in self.path], [T for _, T in self.path])
"""


FUNCTIONS = """
import time
import numpy as np
from slamcmp.types import Estimate

def swap(a, b, *, scale=1.0):
    return scale * b, a

def echo(value):
    return value

def bad(x):
    return helper(x)

def helper(x):
    raise ValueError(f"no good: {x}")

def nothing_to_see():
    return object()

def loop():
    while True:
        pass

def spend(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

def talk(n):
    print("x" * n)

def imports():
    import decimal, fractions, sqlite3, statistics, unittest
    import scipy.linalg, scipy.stats
    return float(scipy.linalg.norm(np.random.default_rng(0).normal(size=3)))

class Wrong:
    def __init__(self, kind):
        self.kind = kind
    def estimate(self):
        return {
            "tuple": (np.eye(3), np.eye(3)),
            "shape": Estimate.__new__(Estimate),
            "none": None,
        }[self.kind]
    def landmarks(self):
        class Made:
            ids, positions, covariances = np.arange(2), np.zeros((3, 2)), np.zeros((2, 2, 2))
        return Made()
"""


def submission(source: str, **more: str) -> Submission:
    files = {"ekf.py": source.encode(), **{name: text.encode() for name, text in more.items()}}
    return Submission("test", "folder", files, "ekf.py")
