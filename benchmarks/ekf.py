"""How fast is one EKF-SLAM step? Ratios within one run, steps interleaved, medians.

Every frame: 10 range-bearing observations of a map of N landmarks, all kept. Compared with
* one in-place BLAS ``dsyrk`` of rank 20 on a matrix of the same size (the arithmetic nobody can avoid),
* a naive sequential EKF with dense H (benchmarks/naive_ekf.py).

Run ``python benchmarks/ekf.py`` (ten seconds; ``--json`` for numbers only, ``--plain`` for the filter without
numba, which has limits of its own); exit code 1: a target is missed.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from scipy.linalg.blas import dsyrk

from slamcmp import geometry
from slamcmp.backends.filters import loops
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

sys.path.insert(0, str(Path(__file__).parent))
from naive_ekf import NaiveEkfSlam

SEEN = 10
TARGETS = {("dsyrk", 1000): 1.25, ("naive", 200): 0.06, ("naive", 50): 0.12}
TARGETS_PLAIN = {("naive", 50): 0.35}


def make_frames(landmark_count: int, steps: int, seed: int = 0) -> tuple[Problem, list[Frame], int]:
    """A robot on a circle inside a square of landmarks; first all are seen, then 10 a frame."""
    rng = np.random.default_rng(seed)
    sensor = RangeBearing()
    landmarks = rng.uniform(-60, 60, size=(landmark_count, 2))
    increment = geometry.se2(0.5, 0.0, 0.02)
    Q = np.diag([0.02, 0.01, 0.005]) ** 2
    R_one = np.diag([0.1, np.radians(1.0)]) ** 2
    T = np.eye(3)
    frames = []
    filling = -(-landmark_count // SEEN)
    for k in range(filling + steps):
        if k:
            T = T @ geometry.retract(increment, rng.normal(size=3) * np.sqrt(np.diag(Q)))
        if k < filling:
            ids = np.arange(k * SEEN, min((k + 1) * SEEN, landmark_count))
        else:
            ids = np.sort(rng.choice(landmark_count, SEEN, replace=False))
        z = sensor.predict(T, landmarks[ids]) + rng.normal(size=(ids.size, 2)) * np.sqrt(np.diag(R_one))
        z[:, 1] = geometry.wrap(z[:, 1])
        first = k == 0
        frames.append(
            Frame(
                k,
                float(k),
                np.eye(3) if first else increment,
                np.zeros((3, 3)) if first else Q,
                ids,
                z,
                np.broadcast_to(R_one, (ids.size, 2, 2)),
            )
        )
    return Problem(np.eye(3), 1e-12 * np.eye(3), sensor), frames, filling


def measure(landmark_count: int, steps: int) -> dict[str, float]:
    """Median seconds of one full step (update and estimate), of one dsyrk, and of the naive step."""
    problem, frames, filling = make_frames(landmark_count, steps)
    ekf = EkfSlam(problem)
    for frame in frames[:filling]:
        ekf.update(frame)
    joint = ekf.joint_covariance()
    mean = np.concatenate(
        [geometry.se2_coordinates(ekf.estimate().T_world_body), ekf.landmarks().positions.ravel()]
    )
    naive = NaiveEkfSlam(mean, joint)
    C = np.asfortranarray(joint)
    rng = np.random.default_rng(1)
    A = np.asfortranarray(1e-9 * rng.normal(size=(joint.shape[0], 2 * SEEN)))
    with_naive = landmark_count <= 200
    times: dict[str, list[float]] = {"ekf": [], "dsyrk": [], "naive": []}
    for frame in frames[filling:]:
        start = time.perf_counter()
        ekf.update(frame)
        ekf.estimate()
        times["ekf"].append(time.perf_counter() - start)

        start = time.perf_counter()
        result = dsyrk(-1.0, A, beta=1.0, c=C, lower=1, overwrite_c=1)
        times["dsyrk"].append(time.perf_counter() - start)
        assert np.shares_memory(result, C)

        if with_naive:
            start = time.perf_counter()
            naive.predict(geometry.se2_coordinates(frame.T_prev_body), frame.Q)
            for i, landmark in enumerate(frame.ids.tolist()):
                naive.correct(landmark, frame.z[i], frame.R[i])
            times["naive"].append(time.perf_counter() - start)
    return {name: float(np.median(values)) if values else float("nan") for name, values in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--plain", action="store_true", help="the filter as it is without numba")
    arguments = parser.parse_args()
    rows = []
    targets = TARGETS
    if arguments.plain:
        targets = TARGETS_PLAIN
        loops.kernels = lambda: None
    for landmark_count, steps in ((50, 600), (200, 300), (1000, 200)):
        medians = measure(landmark_count, steps)
        for yardstick in ("dsyrk", "naive"):
            rows.append(
                {
                    "landmarks": landmark_count,
                    "against": yardstick,
                    "ekf_us": 1e6 * medians["ekf"],
                    "yardstick_us": 1e6 * medians[yardstick],
                    "ratio": medians["ekf"] / medians[yardstick],
                    "target": targets.get((yardstick, landmark_count)),
                }
            )
    missed = [row for row in rows if row["target"] is not None and row["ratio"] > row["target"]]
    if arguments.json:
        print(json.dumps(rows))
        sys.exit(1 if missed else 0)
    print(f"{'N':>5}  {'against':8} {'EKF step':>10} {'yardstick':>10} {'ratio':>7} {'target':>7}")
    for row in rows:
        if np.isfinite(row["ratio"]):
            target = "" if row["target"] is None else f"{row['target']:.2f}"
            print(
                f"{row['landmarks']:5d}  {row['against']:8} {row['ekf_us']:7.0f} µs "
                f"{row['yardstick_us']:7.0f} µs {row['ratio']:7.3f} {target:>7}"
            )
    if missed:
        sys.exit(f"{len(missed)} target(s) missed")


if __name__ == "__main__":
    main()
