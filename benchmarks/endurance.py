"""What does a frame cost over a very long run? Laws of cost by frame, and of memory.

A robot drives round a large ring again and again, and sees the landmarks about it, a dozen a frame. Frames
are made one at a time and forgotten. Of each back end the median cost of a frame (update and estimate) in
twelve spans of the run is told, and the law that fits the second half: cost = a k^b, frame k, by least
squares on logarithms. Bounded is what has b near zero: limits hold it below 0.25 (noise on a short run).

Run ``python benchmarks/endurance.py`` (3000 frames, 300 landmarks, two minutes; ``--json`` for numbers only;
``--frames 20000 --landmarks 1000`` for the long one). A back end whose frames take longer than ``--slowest``
milliseconds is ended there, and the table says at which frame.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

SPANS = 12
SEEN = 12
STEP_M = 0.5
BOUNDED = 0.25
"""Largest exponent of a cost that is bounded."""
BACK_ENDS: dict[str, tuple[type[Any], dict[str, Any], bool]] = {
    "ekf_slam, 40 active": (EkfSlam, {"active_landmarks": 40}, True),
    "sliding_window": (SlidingWindow, {}, True),
    "fixed_lag": (FixedLag, {}, True),
    "sliding_window, keeps all": (SlidingWindow, {"most_landmarks": None}, False),
    "fixed_lag, keeps all": (FixedLag, {"most_landmarks": None}, False),
    "isam2": (Isam2, {}, False),
}
"""Class, parameters, and whether it promises a bounded frame."""


@dataclass(frozen=True)
class Found:
    """One back end over the run."""

    frames: int
    median_ms: list[float]
    """Of each span."""
    exponent: float
    grown_mb: float
    """Resident memory, second half of the run."""
    bounded: bool


def problem() -> Problem:
    return Problem(np.eye(3), 1e-12 * np.eye(3), RangeBearing())


def frames_of(count: int, landmarks: int, seed: int = 0) -> Iterator[Frame]:
    """The drive; each frame exists while it is used."""
    rng = np.random.default_rng(seed)
    sensor = RangeBearing()
    Q = np.diag([0.02, 0.01, 0.005]) ** 2
    R = np.broadcast_to(np.diag([0.1, np.radians(1.0)]) ** 2, (SEEN, 2, 2))
    # A landmark every 2.5 m on the way, to both sides; once round in as many steps as that takes.
    around = 2.5 * landmarks
    radius, turn = around / (2.0 * np.pi), 2.0 * np.pi * STEP_M / around
    angles = 2.0 * np.pi * np.arange(landmarks) / landmarks
    distance = radius + rng.uniform(2.0, 8.0, landmarks) * rng.choice([-1.0, 1.0], landmarks)
    positions = np.stack([distance * np.sin(angles), radius - distance * np.cos(angles)], axis=-1)
    increment = geometry.se2(STEP_M * np.cos(turn / 2), STEP_M * np.sin(turn / 2), turn)
    T = np.eye(3)
    for k in range(count):
        first = k == 0
        if not first:
            T = T @ geometry.retract(increment, rng.normal(size=3) * np.sqrt(np.diag(Q)))
        # By where the plan is, so that a robot that has drifted sees what is about it all the same.
        near = round(k * STEP_M / 2.5) + np.arange(SEEN) - SEEN // 2
        ids = np.sort(near % landmarks)
        z = sensor.predict(T, positions[ids])
        z = z + rng.normal(size=z.shape) * np.sqrt(np.diag(R[0]))
        z[:, 1] = geometry.wrap(z[:, 1])
        step, noise = (np.eye(3), np.zeros((3, 3))) if first else (increment, Q)
        yield Frame(k, float(k), step, noise, ids, z, R)


def endure(name: str, count: int, landmarks: int, slowest_ms: float) -> Found:
    """Feed the drive to a back end until its end, or until a span's frames are too slow."""
    make, parameters, bounded = BACK_ENDS[name]
    back_end = make(problem(), **parameters)
    times: list[float] = []
    edges = np.linspace(0, count, SPANS + 1).astype(int)
    before_mb = 0.0
    for frame in frames_of(count, landmarks):
        start = time.perf_counter()
        back_end.update(frame)
        back_end.estimate()
        times.append(1e3 * (time.perf_counter() - start))
        if frame.k == count // 2:
            before_mb = resident_mb()
        if frame.k % 20 == 19 and np.median(times[-20:]) > slowest_ms:
            break
    spans = [times[a:b] for a, b in pairwise(edges.tolist()) if b <= len(times)]
    if len(spans) < 4:
        # It was ended early: spans of its own.
        spans = [list(span) for span in np.array_split(times, SPANS)]
    medians = [float(np.median(span)) for span in spans]
    ends = np.cumsum([len(span) for span in spans])
    half = len(spans) // 2
    exponent = float(np.polyfit(np.log(ends[half:]), np.log(medians[half:]), 1)[0])
    grown = resident_mb() - before_mb if before_mb else float("nan")
    return Found(len(times), medians, exponent, grown, bounded)


def resident_mb() -> float:
    """Of this process, where the system tells it; else NaN."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return float("nan")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=3000)
    parser.add_argument("--landmarks", type=int, default=300)
    parser.add_argument("--slowest", type=float, default=100.0, help="ms a frame")
    parser.add_argument("--only", nargs="+", choices=list(BACK_ENDS), default=list(BACK_ENDS))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {name: endure(name, options.frames, options.landmarks, options.slowest) for name in options.only}
    wrong = [
        f"{name}: frame {each.frames} of {options.frames}, exponent {each.exponent:.2f}"
        for name, each in found.items()
        if each.bounded and (each.frames < options.frames or each.exponent > BOUNDED)
    ]
    if options.json:
        told = {name: asdict(each) for name, each in found.items()}
        print(json.dumps({"limit": 2.0**BOUNDED, "back_ends": told}))
    else:
        for name, each in found.items():
            spans = " ".join(f"{value:.2f}" for value in each.median_ms)
            law = f"k^{each.exponent:.2f}, {each.grown_mb:+.1f} MB"
            print(f"{name:28} {each.frames:6d} frames, ms {spans}; {law}")
        for line in wrong:
            print(f"not bounded: {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
