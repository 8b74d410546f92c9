"""How much does the ``isam2`` back end add to bare GTSAM? Ratios within one run, interleaved, medians.

Both sides feed the same frames to ``gtsam.ISAM2`` with the same settings, build the same factors with the
same noise and the same initial values, and read the newest pose after each update; with ``+ covariance``
both also read its marginal covariance. *Bare* is the shortest script a GTSAM user would write for that
sensor: noise models made once where all are the same, straight-line code, no checks. Both solutions must
agree (to 1e-9 in the plane, where they do to the last bit; to 1e-6 for the stereo camera, whose landmarks
have a prior of 100 km in the back end and none in the script).

The order of the two alternates from frame to frame, and each frame's times are compared in pairs: the ratio
is that of the totals over the whole run (what a user waits for), beside the median over frames.

Run ``python benchmarks/isam2.py`` (about a minute; ``--json`` for numbers only).
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import math
import time
from collections.abc import Callable

import gtsam
import numpy as np

from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.frontend.labelled import labelled
from slamcmp.registry import sources
from slamcmp.types import Frame, MeasurementStream

TARGET = 1.25
X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L


class BareRangeBearing:
    """iSAM2 written out for a planar range-bearing stream; ``same_noise``: every sighting has the same R."""

    def __init__(self, stream: MeasurementStream, *, same_noise: bool) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.1)
        parameters.relinearizeSkip = 10
        self.isam = gtsam.ISAM2(parameters)
        first = next(f.R[0] for f in stream.frames if f.ids.size)
        self.noise = gtsam.noiseModel.Gaussian.Covariance(first[::-1, ::-1]) if same_noise else None
        self.prior_noise = gtsam.noiseModel.Gaussian.Covariance(stream.problem.P)
        self.known: set[int] = set()
        self.k = 0
        T = stream.problem.T_world_body
        self.pose = gtsam.Pose2(T[0, 2], T[1, 2], math.atan2(T[1, 0], T[0, 0]))

    def update(self, frame: Frame) -> None:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        k = self.k = frame.k
        if k == 0:
            predicted = self.pose
            graph.add(gtsam.PriorFactorPose2(X(0), predicted, self.prior_noise))
        else:
            T = frame.T_prev_body
            increment = gtsam.Pose2(T[0, 2], T[1, 2], math.atan2(T[1, 0], T[0, 0]))
            predicted = self.pose.compose(increment)
            noise = gtsam.noiseModel.Gaussian.Covariance(frame.Q)
            graph.add(gtsam.BetweenFactorPose2(X(k - 1), X(k), increment, noise))
        values.insert(X(k), predicted)
        sightings = zip(frame.ids.tolist(), frame.z.tolist(), frame.R, strict=True)
        for landmark, (distance, bearing), R in sightings:
            noise = self.noise or gtsam.noiseModel.Gaussian.Covariance(R[::-1, ::-1])
            angle = gtsam.Rot2(bearing)
            graph.add(gtsam.BearingRangeFactor2D(X(k), L(landmark), angle, distance, noise))
            if landmark not in self.known:
                self.known.add(landmark)
                here = np.array([distance * math.cos(bearing), distance * math.sin(bearing)])
                values.insert(L(landmark), predicted.transformFrom(here))
        self.isam.update(graph, values)
        self.pose = self.isam.calculateEstimatePose2(X(k))

    def covariance(self) -> np.ndarray:
        return self.isam.marginalCovariance(X(self.k))


class BareStereo:
    """The same for a stereo camera in space."""

    def __init__(self, stream: MeasurementStream) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.1)
        parameters.relinearizeSkip = 10
        self.isam = gtsam.ISAM2(parameters)
        camera = stream.problem.sensor
        self.K = gtsam.Cal3_S2Stereo(
            camera.fx_px, camera.fy_px, 0.0, camera.cx_px, camera.cy_px, camera.baseline_m
        )
        self.mounting = gtsam.Pose3(camera.T_body_camera)
        self.noise = gtsam.noiseModel.Gaussian.Covariance(stream.frames[0].R[0])
        self.prior_noise = gtsam.noiseModel.Gaussian.Covariance(stream.problem.P)
        self.known: set[int] = set()
        self.k = 0
        self.pose = gtsam.Pose3(stream.problem.T_world_body)

    def update(self, frame: Frame) -> None:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        k = self.k = frame.k
        if k == 0:
            predicted = self.pose
            graph.add(gtsam.PriorFactorPose3(X(0), predicted, self.prior_noise))
        else:
            increment = gtsam.Pose3(frame.T_prev_body)
            predicted = self.pose.compose(increment)
            noise = gtsam.noiseModel.Gaussian.Covariance(frame.Q)
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), increment, noise))
        values.insert(X(k), predicted)
        camera = gtsam.StereoCamera(predicted.compose(self.mounting), self.K)
        for landmark, (left, right, v) in zip(frame.ids.tolist(), frame.z.tolist(), strict=True):
            point = gtsam.StereoPoint2(left, right, v)
            factor = gtsam.GenericStereoFactor3D(
                point, self.noise, X(k), L(landmark), self.K, False, False, self.mounting
            )
            graph.add(factor)
            if landmark not in self.known:
                self.known.add(landmark)
                values.insert(L(landmark), camera.backproject(point))
        self.isam.update(graph, values)
        self.pose = self.isam.calculateEstimatePose3(X(k))

    def covariance(self) -> np.ndarray:
        return self.isam.marginalCovariance(X(self.k))


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def measure(stream: MeasurementStream) -> dict[str, float]:
    """Median milliseconds a frame and ratios, of update + pose and of update + pose + covariance."""
    noise = np.concatenate([frame.R for frame in stream.frames])
    same_noise = bool((noise == noise[0]).all())
    ours = Isam2(stream.problem)
    planar = stream.problem.sensor.space_dim == 2
    bare = BareRangeBearing(stream, same_noise=same_noise) if planar else BareStereo(stream)
    times = np.empty((len(stream.frames), 4))
    for frame in stream.frames:
        pairs = [
            (0, lambda frame=frame: ours.update(frame)),
            (1, lambda frame=frame: bare.update(frame)),
            (2, ours.estimate),
            (3, bare.covariance),
        ]
        # Who goes first profits from nothing over the run.
        if frame.k % 2:
            pairs = [pairs[1], pairs[0], pairs[3], pairs[2]]
        for column, call in pairs:
            times[frame.k, column] = seconds(call)
    difference = np.abs(ours.estimate().T_world_body - bare.pose.matrix()).max()
    if difference > (1e-9 if planar else 1e-6):
        raise SystemExit(f"the two sides disagree by {difference:.3g}: they do not do the same work")
    update, both = times[:, :2], times[:, :2] + times[:, 2:]
    return {
        "frames": float(len(times)),
        "bare_update_ms": float(np.median(update[:, 1]) * 1e3),
        "our_update_ms": float(np.median(update[:, 0]) * 1e3),
        "update_ratio_total": float(update[:, 0].sum() / update[:, 1].sum()),
        "update_ratio_median": float(np.median(update[:, 0] / update[:, 1])),
        "bare_with_covariance_ms": float(np.median(both[:, 1]) * 1e3),
        "our_with_covariance_ms": float(np.median(both[:, 0]) * 1e3),
        "with_covariance_ratio_total": float(both[:, 0].sum() / both[:, 1].sum()),
        "with_covariance_ratio_median": float(np.median(both[:, 0] / both[:, 1])),
    }


def streams() -> dict[str, MeasurementStream]:
    """Few and many sightings a frame; on Victoria Park most frames have none, and each R is its own.

    KITTI 00's stereo camera sees some 650 landmarks a frame; it stops before the script's system is singular.
    """
    settings = {
        "victoria park": ("victoria_park", {}),
        "circle, 40 landmarks": ("circle", {"steps": 1000, "landmarks": 40}),
        "random, 100 landmarks": ("random", {"steps": 1000, "landmarks": 100, "range_max_m": 12.0}),
        "KITTI 00 stereo": ("kitti00_stereo", {"steps": 20}),
    }
    return {
        name: labelled(sources.get(source).target(0, **parameters), 0)
        for name, (source, parameters) in settings.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print numbers only")
    arguments = parser.parse_args()
    results = {name: measure(stream) for name, stream in streams().items()}
    if arguments.json:
        print(json.dumps({"target": TARGET, "results": results}, indent=2))
        return
    print(f"isam2 back end against bare gtsam.ISAM2 (target: at most {TARGET})")
    print(f"{'stream':24}{'work':22}{'bare ms':>9}{'ours ms':>9}{'median ratio':>14}{'total ratio':>13}")
    for name, found in results.items():
        for label, kind in (("update + pose", "update"), ("  + covariance", "with_covariance")):
            print(
                f"{name:24}{label:22}{found[f'bare_{kind}_ms']:9.3f}{found[f'our_{kind}_ms']:9.3f}"
                f"{found[f'{kind}_ratio_median']:14.3f}{found[f'{kind}_ratio_total']:13.3f}"
            )


if __name__ == "__main__":
    main()
