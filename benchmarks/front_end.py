"""How fast is the front end on images? Ratios within one run, frames interleaved, medians.

A rendered drive at 640×480, 500 features, one thread. A frame is: Harris, suppression, ORB, matching with
the frame before, RANSAC and the test for degeneracies. Compared with
* the OpenCV calls that it makes, on the same inputs and nothing around them,
* the OpenCV calls that do the whole job: the same and a brute-force matcher in both directions, which the
  front end replaces by one table of distances,
* for suppression alone, OpenCV's ORB at 3000 features.

Then the registered front end ``tracked_features`` with a single camera, all of it: the same calls, and the
landmarks' predictions, tests, filters and triangulation on top.

Run ``python benchmarks/front_end.py`` (about 40 s; ``--json`` for numbers only).
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import sys
import time
from collections.abc import Callable
from statistics import median

import cv2
import numpy as np

from slamcmp.frontend.tracked_features import tracked_features
from slamcmp.frontend.vision.features.harris import Corners, harris_corners
from slamcmp.frontend.vision.features.orb import BORDER_PX, RADIUS_PX
from slamcmp.frontend.vision.features.suppression import suppress_brown, suppress_cells
from slamcmp.frontend.vision.geometry import fundamental
from slamcmp.frontend.vision.image_pair import Features, extract_features, match_features
from slamcmp.frontend.vision.tracking.tracker import FeatureTracker, TrackingSettings
from slamcmp.support.memory import keep_freed_memory
from slamcmp.types import Log
from slamcmp.worlds.rendered import rendered

TARGETS = {"ratio_same_job": 1.4, "tracking_ratio_same_job": 1.4, "suppression_ratio": 0.1}
RATE_TARGETS = {"frames_per_s": 25.0, "tracking_frames_per_s": 25.0}
SEED = 1


class OpenCvCalls:
    """The calls that the front end makes for one frame, each with inputs made beforehand."""

    def __init__(
        self,
        image: np.ndarray,
        features: Features,
        before: Features,
        first: np.ndarray,
        second: np.ndarray,
    ) -> None:
        self._image = image
        self._keypoints = [
            (x, y, a)
            for (x, y), a in zip(np.rint(features.xy).tolist(), features.angle_deg.tolist(), strict=True)
        ]
        self._orb = cv2.ORB.create(nlevels=1, edgeThreshold=BORDER_PX, patchSize=2 * RADIUS_PX + 1)
        self._described = before.descriptors, features.descriptors
        self._first, self._second = first, second
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)

    def prepare(self) -> None:
        """ORB.compute changes its list of corners, so each run needs a new one."""
        self._ready = [cv2.KeyPoint(x, y, 31.0, a) for x, y, a in self._keypoints]

    def run(self) -> None:
        response = cv2.cornerHarris(self._image, 3, 3, 0.04)
        cv2.dilate(response, np.ones((3, 3), dtype=np.uint8))
        self._orb.compute(self._image, self._ready)
        cv2.findFundamentalMat(self._first, self._second, fundamental.usac_parameters(SEED, 1.0, 0.999, 3000))
        cv2.findHomography(self._first, self._second, fundamental.usac_parameters(SEED, 2.0, 0.999, 1000))

    def match(self) -> None:
        first, second = self._described
        self._matcher.knnMatch(first, second, k=2)
        self._matcher.match(second, first)


def timed(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start)


def measure(rounds: int) -> dict[str, float]:
    log = rendered(SEED, camera="mono", steps=60)
    images = [log.images[k].image for k in range(0, 60, 3)]
    times: dict[str, list[float]] = {"front_end": [], "calls": [], "matcher": []}
    stages: dict[str, list[float]] = {}
    kept: list[int] = []
    for _ in range(rounds):
        before = extract_features(images[0])
        for image in images[1:]:
            start = time.perf_counter()
            features = extract_features(image)
            pair = match_features(before, features, seed=SEED, K=log.problem.sensor.K)
            times["front_end"].append(1e3 * (time.perf_counter() - start))
            calls = OpenCvCalls(image, features, before, pair.first, pair.second)
            calls.prepare()
            times["calls"].append(timed(calls.run))
            times["matcher"].append(timed(calls.match))
            for name, value in {**features.times_ms, **pair.times_ms}.items():
                stages.setdefault(name, []).append(value)
            kept.append(pair.counts["kept"])
            before = features
    result = {f"{name}_ms": median(values) for name, values in times.items()}
    result |= {f"stage_{name}_ms": median(values) for name, values in stages.items()}
    # Ratios frame by frame: a disturbance from outside hits both sides of the same frame.
    pairs = list(zip(times["front_end"], times["calls"], times["matcher"], strict=True))
    result["ratio_calls"] = median(ours / calls for ours, calls, _ in pairs)
    result["ratio_same_job"] = median(ours / (calls + matcher) for ours, calls, matcher in pairs)
    result["frames_per_s"] = 1e3 / result["front_end_ms"]
    result["kept_matches"] = median(kept)
    return result | measure_tracking(log, rounds) | measure_suppression(images, rounds * 10)


def measure_tracking(log: Log, rounds: int) -> dict[str, float]:
    """Every image of the drive, as an experiment takes them; the first ones have little to follow yet."""
    frames = list(log.images)
    described = [extract_features(frame.image) for frame in frames]
    tracking, calls_ms, stages = [], [], {}
    for _ in range(max(rounds // 3, 1)):
        tracker = FeatureTracker(
            log.problem.sensor,
            TrackingSettings(**tracked_features.__kwdefaults__),
            np.random.default_rng(SEED),
        )
        for k, frame in enumerate(frames):
            start = time.perf_counter()
            sighting = tracker.step(frame, log.T_prev_body[k], log.Q[k])
            taken = 1e3 * (time.perf_counter() - start)
            if k < 10:
                continue
            calls = OpenCvCalls(
                frame.image,
                described[k],
                described[k - 1],
                sighting.matches.before,
                sighting.matches.now,
            )
            calls.prepare()
            tracking.append(taken)
            calls_ms.append(timed(calls.run) + timed(calls.match))
            for name, value in sighting.times_ms.items():
                stages.setdefault(name, []).append(value)
    result = {"tracking_ms": median(tracking), "tracking_frames_per_s": 1e3 / median(tracking)}
    result |= {f"tracking_{name}_ms": median(values) for name, values in stages.items()}
    ratios = [ours / calls for ours, calls in zip(tracking, calls_ms, strict=True)]
    return result | {"tracking_ratio_same_job": median(ratios)}


def measure_suppression(images: list[np.ndarray], rounds: int) -> dict[str, float]:
    orb = cv2.ORB.create(3000)
    corners: list[Corners] = [harris_corners(image, count_max=3000, quality=1e-6) for image in images]
    full = [(image, found) for image, found in zip(images, corners, strict=True) if len(found.xy) == 3000]
    times: dict[str, list[float]] = {"orb": [], "cells": [], "brown": []}
    for i in range(rounds):
        image, found = full[i % len(full)]
        times["orb"].append(timed(lambda image=image: orb.detectAndCompute(image, None)))
        times["cells"].append(timed(lambda f=found: suppress_cells(f.xy, f.response, 500)))
        times["brown"].append(timed(lambda f=found: suppress_brown(f.xy, f.response, 500)))
    result = {f"suppression_{name}_ms": median(values) for name, values in times.items()}
    ratios = [cells / orb_ms for cells, orb_ms in zip(times["cells"], times["orb"], strict=True)]
    return result | {"suppression_ratio": median(ratios)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--json", action="store_true", help="print numbers only")
    parser.add_argument("--rounds", type=int, default=8)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    # As ``tracked_features`` does; OpenCV's own calls, which are compared with, gain by it too.
    keep_freed_memory()
    result = measure(options.rounds)
    missed = [name for name, limit in TARGETS.items() if result[name] > limit]
    missed += [name for name, limit in RATE_TARGETS.items() if result[name] < limit]
    if options.json:
        print(json.dumps(result, indent=1))
    else:
        for name, value in result.items():
            limit = f"  (at most {TARGETS[name]})" if name in TARGETS else ""
            limit = f"  (at least {RATE_TARGETS[name]:g})" if name in RATE_TARGETS else limit
            print(f"{name:22} {value:9.3f}{limit}{'  MISSED' if name in missed else ''}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
