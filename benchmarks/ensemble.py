"""How many runs a second does an ensemble make? P1 with the EKF and the right-invariant filter.

On one core, on all cores, and on a GPU where there is one. Needs numpy and numba alone (on a GPU numba-cuda),
so that a bare machine with a GPU can run it from a checkout: ``pip install numpy numba numba-cuda``.

Interleaved: the same blocks of seeds on one thread and on all; on two cores their ratio may be 1 / 1.8. A
GPU's first launch compiles and is not timed; its scores must be a core's to 1e-6, for the last bits of sines
and logarithms differ and a run of 2500 frames makes more of them.

Run ``python benchmarks/ensemble.py`` (a minute; ``--runs 100`` for less, ``--json`` for numbers).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from slamcmp.ensembles import targets
from slamcmp.ensembles.kernels import settings as at

STEPS, SPEED, TURN, LANDMARKS, MOST = 2500, 0.25, math.radians(1.5), 20, 4
BATCHES, BLOCK = 50, 50
CHARTS = {"EKF": at.WORLD, "right-invariant": at.RIGHT}
REPEATS = 3


def p1() -> tuple[Any, ...]:
    """Numbers, options, path, controls and landmarks of the experiment anchors/p1."""
    angles = TURN * np.arange(STEPS)
    path = np.empty((STEPS, 4))
    path[:, 0], path[:, 1] = np.cos(angles), np.sin(angles)
    path[0, 2:] = 0.0
    path[1:, 2:] = np.cumsum(SPEED * path[:-1, :2], axis=0)
    radius = SPEED / TURN
    around = 2 * np.pi * np.arange(LANDMARKS) / LANDMARKS
    ring = np.array([0.0, radius]) + (radius + 3.0) * np.stack([np.cos(around), np.sin(around)], axis=-1)
    numbers = np.zeros(at.NUMBERS)
    numbers[at.TIME_STEP] = 1.0
    numbers[at.SPEED_SIGMA], numbers[at.TURN_SIGMA] = 0.05 * SPEED / math.sqrt(2), 0.1 * SPEED * math.sqrt(2)
    numbers[at.FIRST_SIGMA] = numbers[at.SECOND_SIGMA] = 0.1
    numbers[at.NEAREST], numbers[at.FARTHEST], numbers[at.HALF_VIEW] = 1.0, 5.0, math.pi
    numbers[at.TOO_FAR] = 5.0
    options = np.zeros(at.OPTIONS, dtype=np.int64)
    options[at.FIRST_LOOK] = options[at.PARTS] = 1
    return numbers, options, path, np.tile([SPEED, TURN], (STEPS - 1, 1)), ring


def on_threads(options: Any, world: tuple[Any, ...], runs: int, threads: int) -> tuple[float, Any]:
    """Wall time [s] and scores of so many runs."""
    numbers, _, path, controls, landmarks = world
    entry = targets.load("cpu").entry
    scores, failed = np.empty((runs, at.SCORES)), np.empty(runs, dtype=np.int64)
    shapes = ((0, 4), (0, 3, 3), (0, 0), (0, 0, 2), (0, 4), (0, 3, 3), (0, 2), (0,))
    nothing = tuple(np.zeros(shape) for shape in shapes)

    def block(first: int) -> None:
        seeds = np.arange(first, min(first + 10, runs), dtype=np.int64)
        part = slice(first, first + len(seeds))
        sums = np.zeros((STEPS, 2))
        entry(
            seeds,
            numbers,
            options,
            path,
            controls,
            landmarks,
            MOST,
            scores[part],
            sums,
            failed[part],
            False,
            nothing,
        )

    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, range(0, runs, 10)))
    return time.perf_counter() - start, scores


def on_gpu(options: Any, world: tuple[Any, ...], runs: int) -> tuple[float, Any]:
    """Wall time [s] and scores of so many runs in one launch."""
    numbers, _, path, controls, landmarks = world
    launch = targets.load("cuda").launch
    start = time.perf_counter()
    scores, *_ = launch(0, runs, numbers, options, path, controls, landmarks, MOST, BATCHES, BLOCK)
    return time.perf_counter() - start, scores


def measure(runs: int) -> dict[str, Any]:
    """Runs a second of every way, and ratios."""
    world, cores = p1(), os.cpu_count() or 1
    found: dict[str, Any] = {"runs": runs, "cores": cores, "filters": {}}
    no_gpu = targets.why_no_gpu()
    found["gpu"] = no_gpu or "used"
    for label, chart in CHARTS.items():
        options = world[1].copy()
        options[at.CHART] = chart
        on_threads(options, world, 2, 1)
        one, every = [], []
        for _ in range(REPEATS):
            one.append(on_threads(options, world, runs, 1)[0])
            seconds, scores = on_threads(options, world, runs, cores)
            every.append(seconds)
        row = {
            "runs_per_s_one_core": runs / statistics.median(one),
            "runs_per_s_all_cores": runs / statistics.median(every),
            "all_cores_over_one": statistics.median(b / a for a, b in zip(one, every, strict=True)),
        }
        if no_gpu is None:
            on_gpu(options, world, 2)
            many = max(runs, 100_000)
            row["runs_per_s_gpu"] = many / statistics.median(
                on_gpu(options, world, many)[0] for _ in range(REPEATS)
            )
            np.testing.assert_allclose(on_gpu(options, world, runs)[1], scores, rtol=1e-6, atol=1e-9)
        found["filters"][label] = row
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=400, help="of each filter and way")
    parser.add_argument("--json", action="store_true", help="print numbers only")
    options = parser.parse_args()
    found = measure(options.runs)
    if options.json:
        print(json.dumps(found))
        return 0
    print(f"P1, {found['runs']} runs, medians of {REPEATS}; GPU: {found['gpu']}")
    for label, row in found["filters"].items():
        print(label)
        for name, value in row.items():
            print(f"  {name.replace('_', ' ')}: {value:.3g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
