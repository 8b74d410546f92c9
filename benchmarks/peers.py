"""One EKF-SLAM step beside other people's, in one run: ratios of ours to theirs, medians.

The frames are those of ``ekf.py``: N landmarks kept, 10 of them seen by range and bearing. Each peer is taken
where it is, and told as skipped, with the reason, where it is not:

* filterpy (``pip install 'slamcmp[peers]'``): its ExtendedKalmanFilter, one stacked update a frame;
* PythonRobotics: ``--pythonrobotics FOLDER`` of a checkout; its EKF-SLAM as published, which also looks
  for the landmark of each observation among all of them;
* MRPT: ``kf-slam`` and ``simul-landmarks`` on the PATH (Debian: mrpt-apps); frames of its own simulator
  with as many landmarks and about as many of them in sight, associations known, the mean of its own profiler.

Run ``python benchmarks/peers.py`` (a minute; ``--json`` for numbers only). There is no limit: exit code 0.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import contextlib
import importlib.util
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slamcmp import geometry
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.types import Frame

sys.path.insert(0, str(Path(__file__).parent))
from ekf import SEEN, make_frames

STEPS = {50: 60, 200: 20}
"""Landmarks: steps timed."""
Step = Callable[[Frame], None]


class Absent(Exception):
    """Why a peer is not measured."""


def filterpy_step(mean: np.ndarray, P: np.ndarray) -> Step:
    """One step of filterpy's ExtendedKalmanFilter on the state (x, y, theta, l1x, l1y, ...)."""
    try:
        from filterpy.kalman import ExtendedKalmanFilter
    except ImportError:
        raise Absent("filterpy is not installed: pip install 'slamcmp[peers]'") from None
    peer = ExtendedKalmanFilter(mean.size, 2 * SEEN)
    peer.x, peer.P = mean.copy(), P.copy()

    def relative(x: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = x[3:].reshape(-1, 2)[ids] - x[:2]
        return away, np.linalg.norm(away, axis=1)

    def h(x: np.ndarray, ids: np.ndarray) -> np.ndarray:
        away, distance = relative(x, ids)
        return np.column_stack([distance, np.arctan2(away[:, 1], away[:, 0]) - x[2]]).ravel()

    def jacobian(x: np.ndarray, ids: np.ndarray) -> np.ndarray:
        away, distance = relative(x, ids)
        H = np.zeros((ids.size, 2, x.size))
        of_range = away / distance[:, None]
        of_bearing = np.column_stack([-away[:, 1], away[:, 0]]) / distance[:, None] ** 2
        each = np.arange(ids.size)
        for axis in (0, 1):
            H[:, 0, axis], H[:, 1, axis] = -of_range[:, axis], -of_bearing[:, axis]
            H[each, 0, 3 + 2 * ids + axis] = of_range[:, axis]
            H[each, 1, 3 + 2 * ids + axis] = of_bearing[:, axis]
        H[:, 1, 2] = -1.0
        return H.reshape(-1, x.size)

    def residual(z: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        difference = z - predicted
        difference[1::2] = geometry.wrap(difference[1::2])
        return difference

    def step(frame: Frame) -> None:
        u = geometry.se2_coordinates(frame.T_prev_body)
        c, s = np.cos(peer.x[2]), np.sin(peer.x[2])
        peer.F[:2, 2] = -s * u[0] - c * u[1], c * u[0] - s * u[1]
        G = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        peer.Q[:] = 0.0
        peer.Q[:3, :3] = G @ frame.Q @ G.T
        # Its predict() moves the mean by F alone, which is linear: the turned step goes first.
        peer.x[:3] += G @ u
        peer.P = peer.F @ peer.P @ peer.F.T + peer.Q
        R = np.kron(np.eye(SEEN), frame.R[0])
        peer.update(frame.z.ravel(), jacobian, h, R, args=frame.ids, hx_args=frame.ids, residual=residual)

    return step


def pythonrobotics_step(folder: Path | None, mean: np.ndarray, P: np.ndarray) -> Step:
    """One step of PythonRobotics' ``ekf_slam``, its own noise and its own search for associations."""
    if folder is None:
        raise Absent(
            "no checkout was named: --pythonrobotics FOLDER (github.com/AtsushiSakai/PythonRobotics)"
        )
    path = folder / "SLAM" / "EKFSLAM" / "ekf_slam.py"
    if not path.is_file():
        raise Absent(f"{folder} holds no SLAM/EKFSLAM/ekf_slam.py")
    specification = importlib.util.spec_from_file_location("pythonrobotics_ekf_slam", path)
    assert specification is not None
    assert specification.loader is not None
    module: Any = importlib.util.module_from_spec(specification)
    os.environ.setdefault("MPLBACKEND", "agg")
    specification.loader.exec_module(module)
    state = [mean[:, None].copy(), P.copy()]

    def step(frame: Frame) -> None:
        forward, _, turn = geometry.se2_coordinates(frame.T_prev_body)
        u = np.array([[forward], [turn]]) / module.DT
        seen = np.column_stack([frame.z, frame.ids])
        # It says "New LM" for each one that it takes for new.
        with contextlib.redirect_stdout(io.StringIO()):
            state[:] = module.ekf_slam(*state, u, seen)

    return step


def measured(landmarks: int, peers: dict[str, Callable[[np.ndarray, np.ndarray], Step]]) -> dict[str, Any]:
    """Median seconds of a step of ours and of each peer, interleaved; a reason where a peer is absent."""
    problem, frames, filling = make_frames(landmarks, STEPS[landmarks])
    ours = EkfSlam(problem)
    for frame in frames[:filling]:
        ours.update(frame)
    pose = geometry.se2_coordinates(ours.estimate().T_world_body)
    mean, P = np.concatenate([pose, ours.landmarks().positions.ravel()]), ours.joint_covariance()

    def our_step(frame: Frame) -> None:
        ours.update(frame)
        ours.estimate()

    steps: dict[str, Step] = {"ours": our_step}
    found: dict[str, Any] = {}
    for name, make in peers.items():
        try:
            steps[name] = make(mean, P)
        except Absent as reason:
            found[name] = str(reason)
    times: dict[str, list[float]] = {name: [] for name in steps}
    for frame in frames[filling:]:
        for name, step in steps.items():
            start = time.perf_counter()
            step(frame)
            times[name].append(time.perf_counter() - start)
    return found | {name: float(np.median(each)) for name, each in times.items()}


SIMULATED = """[Params]
random_seed = 1
nSteps = {steps}
circularPath = 1
squarePathLength = 50
odometryNoiseXY_std = 0.02
minSensorDistance = 0.2
maxSensorDistance = {range_m}
fieldOfView_deg = 360
stdRange = 0.1
stdYaw_deg = 1
stdPitch_deg = 0
outFile = simulated.rawlog
outDir = .
show_in_3d = false
"""
LANDMARK = """[RANDOMSET_{number}]
nLandmarks = 1
min_x = {x}
max_x = {x}
min_y = {y}
max_y = {y}
min_z = 0
max_z = 0
"""
CENTRE_M, RADIUS_M = (-0.1, 2.29), 2.29
"""Where simul-landmarks drives its circle."""
RING_M = RADIUS_M + 0.5
FILTERED = """[MappingApplication]
rawlog_file = simulated.rawlog
kf_implementation = CRangeBearingKFSLAM2D
ground_truth_file =
ground_truth_file_robot =
logOutput_dir = log
SAVE_LOG_FREQUENCY = 1000000
SHOW_3D_LIVE = false
SAVE_3D_SCENES = false
SAVE_MAP_REPRESENTATIONS = false
SAVE_DA_LOG = false
[RangeBearingKFSLAM_KalmanFilter]
method = 0
verbose = false
enable_profiler = true
[RangeBearingKFSLAM]
std_sensor_range = 0.1
std_sensor_yaw_deg = 1
force_ignore_odometry = false
data_assoc_method = 0
"""


def mrpt_seconds(landmarks: int) -> float:
    """Mean seconds of a step of MRPT's kf-slam once its map is whole, by its own profiler."""
    for program in ("simul-landmarks", "kf-slam"):
        if shutil.which(program) is None:
            raise Absent(f"{program} is not on the PATH (Debian: apt install mrpt-apps)")
    # Landmarks on a ring about the circle that it drives: all are seen in a round, SEEN of them at once.
    angle = np.pi * SEEN / landmarks
    range_m = np.sqrt(RADIUS_M**2 + RING_M**2 - 2 * RADIUS_M * RING_M * np.cos(angle))
    around = np.linspace(-np.pi, np.pi, landmarks, endpoint=False)
    places = np.array(CENTRE_M) + RING_M * np.column_stack([np.cos(around), np.sin(around)])
    ring = "".join(LANDMARK.format(number=k + 1, x=x, y=y) for k, (x, y) in enumerate(places))
    totals = []
    # The first steps meet an empty map: what the later ones took is the difference of two runs.
    for steps in (400, 800):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "simulated.ini").write_text(SIMULATED.format(steps=steps, range_m=range_m) + ring)
            Path(folder, "filtered.ini").write_text(FILTERED)
            said = ""
            for command in (("simul-landmarks", "simulated.ini"), ("kf-slam", "filtered.ini")):
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
                if done.returncode != 0:
                    raise Absent(f"{command[0]} ended with exit code {done.returncode}")
                said = done.stdout + done.stderr
            totals.append(profiled_total(said))
    (first, whole) = totals
    return (whole[1] - first[1]) / (whole[0] - first[0])


def profiled_total(report: str) -> tuple[int, float]:
    """Count and total seconds of ``complete_step`` in a report of MRPT's CTimeLogger.

    Its columns are count, least, mean, most and total.

    Raises:
        Absent: it is not in the report.
    """
    number = r"([\d.]+) ?(ns|us|ms|s)"
    line = re.search(rf"^KF:complete_step\s+(\d+)\s+{number}\s+{number}\s", report, re.MULTILINE)
    if line is None:
        raise Absent("kf-slam's report has no line for KF:complete_step")
    count, mean = int(line[1]), float(line[4]) * {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}[line[5]]
    return count, count * mean


def rows_of(pythonrobotics: Path | None) -> list[dict[str, Any]]:
    """One row for each number of landmarks and peer: microseconds and their ratio, or why there is none."""
    rows = []
    for landmarks in STEPS:
        found = measured(
            landmarks,
            {
                "filterpy": filterpy_step,
                "PythonRobotics": lambda mean, P: pythonrobotics_step(pythonrobotics, mean, P),
            },
        )
        ours = found.pop("ours")
        try:
            found["MRPT"] = mrpt_seconds(landmarks)
        except Absent as reason:
            found["MRPT"] = str(reason)
        for peer, value in found.items():
            absent = value if isinstance(value, str) else None
            rows.append(
                {
                    "landmarks": landmarks,
                    "peer": peer,
                    "ours_us": 1e6 * ours,
                    "peer_us": None if absent else 1e6 * value,
                    "ratio": None if absent else ours / value,
                    "skipped": absent,
                }
            )
    return rows


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON list and nothing else")
    parser.add_argument("--pythonrobotics", type=Path, help="a checkout of PythonRobotics", metavar="FOLDER")
    arguments = parser.parse_args(words)
    rows = rows_of(arguments.pythonrobotics)
    if arguments.json:
        print(json.dumps(rows))
        return
    print(f"{'N':>5}  {'peer':15} {'ours':>10} {'theirs':>12} {'ratio':>8}")
    for row in rows:
        head = f"{row['landmarks']:5d}  {row['peer']:15} {row['ours_us']:7.0f} µs"
        if row["skipped"]:
            print(f"{head} skipped: {row['skipped']}")
        else:
            print(f"{head} {row['peer_us']:9.0f} µs {row['ratio']:8.4f}")


if __name__ == "__main__":
    main()
