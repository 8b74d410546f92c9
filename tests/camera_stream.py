"""A drive through a corridor of points seen by a camera, without images: for tests of the back ends in space.

Noise is exactly what the stream says; a landmark enters a monocular stream with a depth of its own noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from slamcmp import geometry
from slamcmp.models.camera import FORWARD_CAMERA, Camera, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.types import Detections, Frame, GroundTruth, MeasurementStream, Problem

Kind = Literal["stereo", "mono", "rgbd"]

SIZE_PX = np.array([640.0, 480.0])
MOUNTING = geometry.exp(np.array([0.02, -0.03, 0.01, 0.4, 0.1, 0.3])) @ FORWARD_CAMERA
INTRINSICS = {"fx_px": 400.0, "fy_px": 390.0, "cx_px": 322.0, "cy_px": 237.0, "T_body_camera": MOUNTING}
CAMERAS: dict[Kind, Camera] = {
    "stereo": StereoCamera(**INTRINSICS, baseline_m=0.4),
    "mono": MonoCamera(**INTRINSICS),
    "rgbd": RgbdCamera(**INTRINSICS),
}
SIGMAS: dict[Kind, np.ndarray] = {
    "stereo": np.array([0.7, 0.7, 0.7]),
    "mono": np.array([0.7, 0.7]),
    "rgbd": np.array([0.7, 0.7, 0.08]),
}
"""Standard deviations of a measurement's components [px, px, px or m]."""


def camera_stream(
    kind: Kind,
    *,
    frames: int = 30,
    landmarks: int = 80,
    seed: int = 0,
    noise: float = 1.0,
    seen_at_once: int = 12,
    step_m: float = 0.5,
) -> tuple[MeasurementStream, GroundTruth]:
    """The stream and its truth; ``noise`` scales every standard deviation, those of the prior too.

    Landmarks between 2.5 and 14 m ahead and in the image are seen, in a fixed order of preference, so that
    they come, stay for some frames and are not seen again once they are behind.
    """
    rng = np.random.default_rng(seed)
    sensor = CAMERAS[kind]
    length = step_m * frames + 12.0
    world = np.stack(
        [
            rng.uniform(2.0, length, landmarks),
            rng.uniform(-5.0, 5.0, landmarks),
            rng.uniform(-2.0, 3.0, landmarks),
        ],
        axis=1,
    )
    turn = 0.02 * np.sin(0.3 * np.arange(frames))
    sigmas = noise * np.array([0.004, 0.004, 0.004, 0.02, 0.02, 0.02])
    prior_sigmas = 0.5 * sigmas
    R_one = np.diag(noise * SIGMAS[kind]) ** 2
    T = geometry.exp(prior_sigmas * rng.normal(size=6))
    made, poses, entered = [], [], set()
    for k in range(frames):
        increment = geometry.exp(np.array([0.0, 0.3 * turn[k], turn[k], step_m, 0.0, 0.0]))
        if k:
            T = T @ increment @ geometry.exp(sigmas * rng.normal(size=6))
        z = sensor.predict(T, world)
        depth = sensor.camera_point(T, world)[:, 2]
        pixels = z[:, [0, 2]] if kind == "stereo" else z[:, :2]
        in_image = ((pixels > 0) & (pixels < SIZE_PX)).all(axis=1)
        ids = np.flatnonzero((depth > 2.5) & (depth < 14.0) & in_image)[:seen_at_once]
        entries = None
        if kind == "mono":
            new = np.array([i for i in ids if i not in entered], dtype=np.int64)
            ids = np.array([i for i in ids if i in entered], dtype=np.int64)
            entered.update(new.tolist())
            if new.size:
                entries = _entries(sensor, T, world, new, noise, rng)
        z = z[ids] + rng.normal(size=(ids.size, sensor.dim)) @ np.sqrt(R_one)
        R = np.broadcast_to(R_one, (ids.size, sensor.dim, sensor.dim))
        step, Q = (increment, np.diag(sigmas**2)) if k else (np.eye(4), np.zeros((6, 6)))
        made.append(Frame(k, 0.1 * k, step, Q, ids, z, R, entries))
        poses.append(T)
    truth = GroundTruth(0.1 * np.arange(frames), np.stack(poses), np.arange(landmarks), world)
    return MeasurementStream(Problem(np.eye(4), np.diag(prior_sigmas**2), sensor), tuple(made)), truth


def _entries(
    sensor: Camera, T: np.ndarray, world: np.ndarray, ids: np.ndarray, noise: float, rng: np.random.Generator
) -> Detections:
    """A pixel and a disparity (of the virtual pair) with noise of their own: R is full."""
    virtual = sensor.entry_sensor
    # From (u, disparity, v) to (u, u - disparity, v).
    A = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    R = noise**2 * A @ np.diag([0.7, 2.0, 0.7]) ** 2 @ A.T
    z = virtual.predict(T, world[ids]) + rng.normal(size=(ids.size, 3)) @ np.linalg.cholesky(R).T
    return Detections(z, np.broadcast_to(R, (ids.size, 3, 3)), ids)


def without_returns(stream: MeasurementStream, gap: int = 1) -> MeasurementStream:
    """The stream without what is seen again of landmarks after ``gap`` or more frames out of sight."""
    last: dict[int, int] = {}
    frames = []
    for frame in stream.frames:
        if frame.entries is not None:
            last.update(dict.fromkeys(frame.entries.ids.tolist(), frame.k))
        keep = np.array([frame.k - last.get(i, frame.k) <= gap for i in frame.ids.tolist()], dtype=bool)
        last.update(dict.fromkeys(frame.ids[keep].tolist(), frame.k))
        frames.append(replace(frame, ids=frame.ids[keep], z=frame.z[keep], R=frame.R[keep]))
    return MeasurementStream(stream.problem, tuple(frames))
