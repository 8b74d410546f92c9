"""How fast is a Monte-Carlo study of a small map? 100 runs of P1, three ways, on one core.

P1 is the planar SLAM benchmark of the ukfm project: 2500 steps, 20 landmarks on a ring, relative positions
within 1 to 5 m, so two or three of them in sight. Timed, interleaved run by run: ``ekf_slam`` frame by frame
(update and estimate) without numba, compiled the same way, and its ``run`` over the whole stream. All must
agree to 1e-9 in every frame's pose and covariance.

Run ``python benchmarks/monte_carlo.py`` (a minute or two; ``--runs 10`` for less, ``--json`` for numbers).
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import math
import time
from typing import Any

import numpy as np

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.loops import Loops
from slamcmp.frontend.labelled import labelled
from slamcmp.randomness import random_streams
from slamcmp.types import FloatArray, MeasurementStream, Problem
from slamcmp.worlds.settings import Settings
from slamcmp.worlds.simulate import World, simulate

TARGET = 5.0
TOLERANCE = 1e-9
STEPS, SPEED, TURN = 2500, 0.25, math.radians(1.5)
SIGMA = 0.05 * SPEED


def p1_stream(seed: int) -> MeasurementStream:
    """One run's measurements."""
    radius = SPEED / TURN
    angles = 2 * np.pi * np.arange(20) / 20
    ring = np.array([0.0, radius]) + (radius + 3.0) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    settings = Settings(
        steps=STEPS,
        landmarks=len(ring),
        speed_m_s=SPEED,
        turn_deg_s=math.degrees(TURN),
        sensor="relative_position",
        position_sigma_m=0.1,
        range_min_m=1.0,
        range_max_m=5.0,
        odometry="straight_then_turn",
        speed_sigma_m_s=SIGMA / math.sqrt(2),
        turn_sigma_deg_s=math.degrees(2 * math.sqrt(2) * SIGMA),
        lateral_sigma_m=0.0,
        prior_position_sigma_m=0.0,
        prior_heading_sigma_rad=0.0,
        resolution=0.0,
    )
    controls = np.tile([SPEED, TURN], (STEPS - 1, 1))
    return labelled(simulate("p1", World(controls, ring), settings, random_streams(seed)), seed)


def frame_by_frame(ekf: Any, stream: MeasurementStream) -> tuple[FloatArray, FloatArray]:
    """What the runner does, without its clocks: the online poses and covariances."""
    poses, covariances = np.empty((STEPS, 3, 3)), np.empty((STEPS, 3, 3))
    for k, frame in enumerate(stream.frames):
        ekf.update(frame)
        estimate = ekf.estimate()
        poses[k], covariances[k] = estimate.T_world_body, estimate.P
    return poses, covariances


def without_numba(problem: Problem) -> EkfSlam:
    """The filter as it is without numba."""
    ekf = EkfSlam(problem)
    ekf._loops = Loops(ekf)
    return ekf


def whole_stream(ekf: EkfSlam, stream: MeasurementStream) -> tuple[FloatArray, FloatArray]:
    online = ekf.run(stream.frames)
    assert online.P is not None
    return online.T_world_body, online.P


def measure(runs: int) -> list[dict[str, Any]]:
    """Seconds of each way over all runs, and its largest difference from the first."""
    ways = {
        "without numba, frame by frame": (without_numba, frame_by_frame),
        "compiled, frame by frame": (EkfSlam, frame_by_frame),
        "compiled, whole stream": (EkfSlam, whole_stream),
    }
    first = p1_stream(0)
    for make, feed in ways.values():
        feed(make(first.problem), first)
    seconds = {name: [] for name in ways}  # type: dict[str, list[float]]
    gaps = dict.fromkeys(ways, 0.0)
    for seed in range(runs):
        stream = p1_stream(seed)
        expected = None
        for name, (make, feed) in ways.items():
            start = time.perf_counter()
            poses, covariances = feed(make(stream.problem), stream)
            seconds[name].append(time.perf_counter() - start)
            expected = expected or (poses, covariances)
            gap = max(np.abs(poses - expected[0]).max(), np.abs(covariances - expected[1]).max())
            gaps[name] = max(gaps[name], float(gap))
    plain = np.array(seconds["without numba, frame by frame"])
    return [
        {
            "way": name,
            "runs": runs,
            "total_s": sum(values),
            "us_a_frame": 1e6 * float(np.median(values)) / STEPS,
            "times_faster": float(np.median(plain / np.array(values))),
            "gap": gaps[name],
        }
        for name, values in seconds.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    rows = measure(arguments.runs)
    assert all(row["gap"] <= TOLERANCE for row in rows)
    if arguments.json:
        print(json.dumps(rows))
        return
    print(f"{'way':30} {'all runs':>9} {'a frame':>9} {'times faster':>12}  target  largest difference")
    for row in rows:
        target = f"{TARGET:.0f}" if row["way"].startswith("compiled") else ""
        print(
            f"{row['way']:30} {row['total_s']:7.1f} s {row['us_a_frame']:6.1f} µs {row['times_faster']:12.1f}"
            f"  {target:>6}  {row['gap']:.1e}"
        )


if __name__ == "__main__":
    main()
