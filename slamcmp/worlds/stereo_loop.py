"""A stereo camera that drives round and round among points: known matches, the noise of pixels.

What the planar ``circle`` is to range and bearing, this is to a camera: laps of a chosen length, a chosen
number of points in sight, odometry in all six directions. No images are drawn (``rendered`` does), so that a
thousand runs take minutes.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval

from slamcmp.errors import UsageError
from slamcmp.geometry import exp, inverse, pose
from slamcmp.models.camera import StereoCamera
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.types import BoolArray, Detections, FloatArray, GroundTruth, Log, Problem
from slamcmp.worlds.in_view import landmarks_for

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]

_GRID = 10
"""Places in each direction at which a point is tried, to find how many are needed."""


@sources.register("stereo_loop", seeded=True)
def stereo_loop(
    seed: int,
    *,
    steps: Annotated[int, Ge(2)] = 240,
    lap_steps: Annotated[int, Ge(4)] = 60,
    time_step_s: Positive = 0.2,
    speed_m_s: Positive = 2.0,
    in_view: Positive = 12.0,
    map_seed: Annotated[int, Ge(0)] | None = None,
    gap_min_m: NotNegative = 1.5,
    gap_max_m: Positive = 8.0,
    height_m: Positive = 2.0,
    width_px: Annotated[int, Ge(64)] = 640,
    height_px: Annotated[int, Ge(64)] = 480,
    field_of_view_deg: Annotated[float, Interval(ge=20, le=140)] = 90.0,
    baseline_m: Positive = 0.3,
    depth_min_m: Positive = 1.0,
    depth_max_m: Positive = 12.0,
    sigma_px: Positive = 0.5,
    outlier_fraction: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    rotation_sigma_deg: Positive = 0.3,
    translation_sigma_m: Positive = 0.02,
    odometry_scale: Positive = 1.0,
    prior_sigma: Positive = 1e-6,
) -> Log:
    """A stereo camera that looks ahead on a circle among points at both sides; matches are known.

    Args:
        seed: of the points (but for ``map_seed``), the odometry noise and the pixels' noise.
        steps: frames, the first one included.
        lap_steps: frames of one turn: the time between loop closures.
        time_step_s: between frames.
        speed_m_s: along the circle; with the lap it sets its radius.
        in_view: points in sight on average.
        map_seed: one map for all trials; None: a map a seed.
        gap_min_m: least distance of a point from the path, to either side.
        gap_max_m: largest.
        height_m: points lie up to this far above and below the camera.
        width_px: of the images.
        height_px: of the images.
        field_of_view_deg: horizontal.
        baseline_m: between the cameras.
        depth_min_m: nearer points are not measured.
        depth_max_m: farther points are not measured.
        sigma_px: of u in the left image, u in the right one, and v.
        outlier_fraction: share of the measurements that show another place: anything in sight.
        rotation_sigma_deg: of the odometry, a step, about each axis.
        translation_sigma_m: of the odometry, a step, along each axis.
        odometry_scale: multiplies the last two.
        prior_sigma: of the first pose, per axis [rad, m].

    Raises:
        UsageError: two values contradict each other, or no point would ever be in sight.
    """
    for low, high, name in ((gap_min_m, gap_max_m, "gap"), (depth_min_m, depth_max_m, "depth")):
        if low >= high:
            raise UsageError(
                f"{name}_min_m is {low:g} and {name}_max_m {high:g}: the first must be below the second"
            )
    focal = 0.5 * width_px / math.tan(math.radians(field_of_view_deg) / 2)
    camera = StereoCamera(
        fx_px=focal, fy_px=focal, cx_px=(width_px - 1) / 2, cy_px=(height_px - 1) / 2, baseline_m=baseline_m
    )
    size = np.array([width_px, width_px, height_px])
    turn = 2 * math.pi / lap_steps
    radius = speed_m_s * time_step_s / turn

    def seen(T_world_body: FloatArray, points: FloatArray) -> BoolArray:
        """Which points (m, 3) are in both images and neither too near nor too far, (m,)."""
        depth = camera.camera_point(T_world_body, points)[:, 2]
        z = camera.predict(T_world_body, points)
        # NaN, behind the camera, is no place in the image.
        return (depth_min_m <= depth) & (depth <= depth_max_m) & ((z >= 0) & (z <= size - 1)).all(axis=1)

    def place(angle: FloatArray, gap: FloatArray, height: FloatArray) -> FloatArray:
        """Points (m, 3); a negative gap lies inside the circle."""
        away = radius + gap
        return np.stack([away * np.sin(angle), radius - away * np.cos(angle), height], axis=-1)

    streams = random_streams(seed)
    gaps = np.linspace(gap_min_m, gap_max_m, _GRID)
    tried = np.meshgrid(
        np.linspace(-math.pi, math.pi, 20 * _GRID, endpoint=False),
        np.concatenate([gaps, -gaps]),
        np.linspace(-height_m, height_m, _GRID),
    )
    count = landmarks_for(in_view, seen(np.eye(4), place(*(each.ravel() for each in tried))))
    map_generator = streams.world if map_seed is None else np.random.default_rng(map_seed)
    draws = map_generator.random((count, 4))
    gap = (gap_min_m + (gap_max_m - gap_min_m) * draws[:, 1]) * np.where(draws[:, 2] < 0.5, 1.0, -1.0)
    points = place(2 * math.pi * draws[:, 0], gap, height_m * (2 * draws[:, 3] - 1))

    angles: FloatArray = turn * np.arange(steps, dtype=np.float64)
    T_world_body = _circle(radius, angles)
    step = inverse(T_world_body[0]) @ T_world_body[1]
    sigmas = odometry_scale * np.array([math.radians(rotation_sigma_deg)] * 3 + [translation_sigma_m] * 3)
    increments, Q = np.tile(np.eye(4), (steps, 1, 1)), np.zeros((steps, 6, 6))
    increments[1:] = step @ exp(sigmas * streams.odometry.standard_normal((steps - 1, 6)))
    Q[1:] = np.diag(sigmas**2)

    detections, outliers = [], []
    for T in T_world_body:
        noise = streams.sensor.standard_normal((count, 3))
        luck = streams.outliers.random((count, 4))
        ids = np.flatnonzero(seen(T, points))
        wild = luck[ids, 0] < outlier_fraction
        z = camera.predict(T, points[ids])
        z[wild] = _anywhere(camera, size, depth_min_m, depth_max_m, luck[ids][wild, 1:])
        R = np.tile(sigma_px**2 * np.eye(3), (ids.size, 1, 1))
        detections.append(Detections(z + sigma_px * noise[ids], R, ids))
        outliers.append(wild)

    t: FloatArray = np.arange(steps, dtype=np.float64) * time_step_s
    return Log(
        name="stereo_loop",
        problem=Problem(T_world_body[0], prior_sigma**2 * np.eye(6), camera),
        t=t,
        T_prev_body=increments,
        Q=Q,
        detections=tuple(detections),
        truth=GroundTruth(t, T_world_body, np.arange(count), points, tuple(outliers)),
    )


def _circle(radius: float, angle: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) on a circle to the left, from the origin on, along x at first."""
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rotation = np.stack(
        [
            np.stack([cos, -sin, zero], -1),
            np.stack([sin, cos, zero], -1),
            np.stack([zero, zero, zero + 1], -1),
        ],
        -2,
    )
    return pose(rotation, np.stack([radius * sin, radius * (1 - cos), zero], axis=-1))


def _anywhere(
    camera: StereoCamera, size: FloatArray, depth_min_m: float, depth_max_m: float, luck: FloatArray
) -> FloatArray:
    """Measurements (m, 3) of anything in sight, uniform in the left image and in disparity.

    ``luck`` (m, 3) is uniform in [0, 1).
    """
    disparity = camera.fx_px * camera.baseline_m / np.array([depth_max_m, depth_min_m])
    u, v = luck[:, 0] * (size[0] - 1), luck[:, 1] * (size[2] - 1)
    return np.stack([u, u - disparity[0] - (disparity[1] - disparity[0]) * luck[:, 2], v], axis=-1)
