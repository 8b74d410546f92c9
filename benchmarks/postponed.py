"""What does postponing the update of far landmarks save? Ratios within one run, steps interleaved.

A robot works for 40 frames in each of 25 regions of 40 landmarks, seeing 10 of them a frame, and then moves
on; a quick first lap, not measured, has seen every landmark twice. Compared are the mean steps (update
and estimate), for a flush now and then is part of the price, and both filters' numbers must agree.

Run ``python benchmarks/postponed.py`` (half a minute; ``--json`` for numbers only).
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import time

import numpy as np

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

TARGET = 0.3
TOLERANCE = 1e-12
REGIONS, LANDMARKS, SEEN = 25, 40, 10
MAPPING, STAY = 8, 40
SPACING = 4.0


def make_frames(seed: int = 0) -> tuple[Problem, list[Frame]]:
    """Circles inside one region after another, the regions on a ring."""
    rng = np.random.default_rng(seed)
    sensor = RangeBearing()
    Q = np.diag([0.02, 0.01, 0.005]) ** 2
    R = np.broadcast_to(np.diag([0.1, np.radians(1.0)]) ** 2, (SEEN, 2, 2))
    angles = 2 * np.pi * np.arange(REGIONS) / REGIONS
    centres = SPACING * REGIONS / (2 * np.pi) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    landmarks = centres[:, None] + rng.uniform(-10, 10, size=(REGIONS, LANDMARKS, 2))
    circling = 2 * np.pi * np.arange(STAY) / STAY
    frames: list[Frame] = []
    planned = T = geometry.se2(*centres[0], 0.0)
    start = T
    for region, stay in [(region, stay) for stay in (MAPPING, STAY) for region in range(REGIONS)]:
        # Every landmark of the region within four frames.
        order = np.concatenate([rng.permutation(LANDMARKS) for _ in range(STAY * SEEN // LANDMARKS)])
        for step in range(stay):
            here = centres[region] + 4.0 * np.array([np.cos(circling[step]), np.sin(circling[step])])
            goal = geometry.se2(*here, circling[step])
            first = not frames
            increment = np.eye(3) if first else geometry.inverse(planned) @ goal
            if not first:
                T = T @ geometry.retract(increment, rng.normal(size=3) * np.sqrt(np.diag(Q)))
                planned = goal
            chosen = np.sort(order[step * SEEN : (step + 1) * SEEN])
            z = sensor.predict(T, landmarks[region, chosen])
            z = z + rng.normal(size=z.shape) * np.sqrt(np.diag(R[0]))
            z[:, 1] = geometry.wrap(z[:, 1])
            noise = np.zeros((3, 3)) if first else Q
            ids = region * LANDMARKS + chosen
            frames.append(Frame(len(frames), float(len(frames)), increment, noise, ids, z, R))
    return Problem(start, 1e-12 * np.eye(3), sensor), frames


def measure(active: int) -> dict[str, float | None]:
    """Mean and median seconds of a step of both filters in the measured lap, and how far they come apart."""
    problem, frames = make_frames()
    filters = {"plain": EkfSlam(problem), "postponed": EkfSlam(problem, active_landmarks=active)}
    times: dict[str, list[float]] = {name: [] for name in filters}
    gap = 0.0
    for k, frame in enumerate(frames):
        for name in list(times) if k % 2 else reversed(list(times)):
            start = time.perf_counter()
            filters[name].update(frame)
            filters[name].estimate()
            if k >= REGIONS * MAPPING:
                times[name].append(time.perf_counter() - start)
        plain, postponed = (ekf.estimate() for ekf in filters.values())
        gap = max(gap, float(np.abs(plain.T_world_body - postponed.T_world_body).max()))
    P, P_postponed = (ekf.joint_covariance() for ekf in filters.values())
    result = {f"{name}_us": 1e6 * float(np.mean(values)) for name, values in times.items()}
    return {
        "landmarks": REGIONS * LANDMARKS,
        "active_landmarks": active,
        **result,
        "postponed_median_us": 1e6 * float(np.median(times["postponed"])),
        "postponed_worst_us": 1e6 * max(times["postponed"]),
        "ratio": result["postponed_us"] / result["plain_us"],
        "target": TARGET if active == LANDMARKS else None,
        "pose_gap": gap,
        "covariance_gap": float(np.abs(P - P_postponed).max() / np.abs(P).max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    rows = [measure(active) for active in (40, 60, 80)]
    if arguments.json:
        print(json.dumps(rows))
        return
    print(f"{'active':>6} {'plain':>9} {'postponed':>10} {'(median':>9} {'worst)':>10} {'ratio':>6}  target")
    for row in rows:
        target = "" if row["target"] is None else f"{row['target']:.2f}"
        print(
            f"{row['active_landmarks']:6d} {row['plain_us']:6.0f} µs {row['postponed_us']:7.0f} µs "
            f"{row['postponed_median_us']:6.0f} µs {row['postponed_worst_us']:7.0f} µs {row['ratio']:6.3f} "
            f"{target:>7}   |ΔT| {row['pose_gap']:.1e}  |ΔP|/max|P| {row['covariance_gap']:.1e}"
        )
        assert row["covariance_gap"] <= TOLERANCE, f"the covariances differ by more than {TOLERANCE:g}"


if __name__ == "__main__":
    main()
