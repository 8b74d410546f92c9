"""Loops through a space of landmarks in three dimensions, with noise proportional to what is measured.

The study of Zhang, Wu and Huang 2017, "Convergence and consistency analysis for a 3-D invariant-EKF SLAM".
The article gives sizes and noise; the course, a body that tumbles on a Lissajous curve, the meaning of the
field of view and where the odometry's noise enters are those of its authors' public simulator. With u the
rotation vector and the translation of a step, noise comes before the step, ``T_{k+1} = T_k exp(n) U(u)``, and
the standard deviation of each component of n is a share of that of u. Both covariances are made of the true
components, as there; a floor replaces smaller ones, since a component of 0 would be known exactly.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval

from slamcmp.geometry import adjoint_of_inverse, exp, inverse, pose, so3_exp, so3_log
from slamcmp.models.sensors import make_sensor
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem
from slamcmp.worlds.outliers import OutlierDraws, OutlierRates

Positive = Annotated[float, Gt(0)]
Share = Annotated[float, Interval(gt=0, lt=1)]


@sources.register("space", seeded=True)
def space(
    seed: int,
    *,
    steps: Annotated[int, Ge(2)] = 501,
    loops: Positive = 8.0,
    time_step_s: Positive = 1.0,
    length_m: Positive = 100.0,
    width_m: Positive = 80.0,
    height_m: Positive = 40.0,
    landmarks: Annotated[int, Ge(1)] = 300,
    map_seed: Annotated[int, Ge(0)] | None = None,
    odometry_share: Share = 0.01,
    observation_share: Share = 0.01,
    noise_scale: Positive = 1.0,
    rotation_floor_rad: Positive = 0.01,
    translation_floor_m: Positive = 0.1,
    observation_floor_m: Positive = 0.1,
    range_max_m: Positive = 20.0,
    field_of_view_deg: Annotated[float, Interval(gt=0, le=360)] = 240.0,
    first_look: Annotated[int, Ge(0)] = 0,
    outlier_fraction: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    wrong_association_fraction: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    clutter_per_frame: Annotated[float, Ge(0)] = 0.0,
    burst_probability: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    burst_frames: Annotated[int, Ge(1)] = 5,
    slip_probability: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    slip_share: Annotated[float, Ge(0)] = 0.5,
) -> Log:
    """A body that tumbles along a Lissajous curve in a box full of landmarks; relative positions in space.

    At the angle a of a loop the body is at half the box times (cos 3a, sin 2a, sin(2a + 1)), turned by
    Rz(4a) Ry(-3a) Rx(5a + 2): with the defaults a step is about 12 m and 0.7 rad.

    Args:
        seed: of the map (but for ``map_seed``), the odometry noise and the sensor noise.
        steps: frames, the first one included.
        loops: in all.
        time_step_s: between frames.
        length_m: of the box, along x, about the origin.
        width_m: along y.
        height_m: along z.
        landmarks: in the box.
        map_seed: one map for all trials; None: a map a seed.
        odometry_share: standard deviation of each component of the motion over its size.
        observation_share: standard deviation of each component of a relative position over its size.
        noise_scale: multiplies both shares.
        rotation_floor_rad: size that a component of the rotation counts for at least.
        translation_floor_m: size that a component of the translation counts for at least.
        observation_floor_m: size that a component of a relative position counts for at least.
        range_max_m: farther landmarks are not seen.
        field_of_view_deg: full angle of the cone about the body's z axis.
        first_look: the first frame with detections.
        outlier_fraction: share of the detections that are replaced by a uniform draw from the cone of view.
        wrong_association_fraction: share that measure another landmark of the same frame than they say.
        clutter_per_frame: mean number of ghosts a frame: draws from the cone under labels out of sight.
        burst_probability: chance that a burst begins with a frame: all that is seen in it is such a draw.
        burst_frames: frames that a burst lasts.
        slip_probability: chance that odometry tells more translation than there was, and Q does not know.
        slip_share: how much more, as a share of the step.
    """
    streams = random_streams(seed)
    box = np.array([length_m, width_m, height_m])
    map_generator = streams.world if map_seed is None else np.random.default_rng(map_seed)
    positions = map_generator.uniform(-box / 2, box / 2, (landmarks, 3))
    T_world_body = _course(box, 2 * math.pi * loops * np.arange(steps) / (steps - 1))

    true_step = inverse(T_world_body[:-1]) @ T_world_body[1:]
    motion = np.concatenate([so3_log(true_step[:, :3, :3]), true_step[:, :3, 3]], axis=1)
    floor = np.array([rotation_floor_rad] * 3 + [translation_floor_m] * 3)
    sigmas = noise_scale * odometry_share * np.maximum(np.abs(motion), floor)
    increments, Q = np.tile(np.eye(4), (steps, 1, 1)), np.zeros((steps, 6, 6))
    increments[1:] = exp(-sigmas * streams.odometry.standard_normal(motion.shape)) @ true_step
    draws = OutlierDraws(
        OutlierRates(
            wrong_association_fraction=wrong_association_fraction,
            clutter_per_frame=clutter_per_frame,
            burst_probability=burst_probability,
            burst_frames=burst_frames,
            slip_probability=slip_probability,
            slip_share=slip_share,
        ),
        streams.outliers,
    )
    increments[1:, :3, 3] *= draws.slips(steps - 1)[:, None]
    # The noise acts in the axes of the body before the step.
    carried = adjoint_of_inverse(increments[1:])
    Q[1:] = carried @ (sigmas[:, :, None] ** 2 * np.swapaxes(carried, 1, 2))

    sensor = make_sensor("relative_position", {"space_dim": 3})
    cosine = math.cos(math.radians(field_of_view_deg / 2))
    detections, masks = [], []
    for k, T in enumerate(T_world_body):
        noise = streams.sensor.standard_normal(positions.shape)
        luck = streams.outliers.random((landmarks, 4))
        true = sensor.predict(T, positions)
        distance = np.linalg.norm(true, axis=1)
        seen = (distance < range_max_m) & (true[:, 2] >= cosine * distance) & (k >= first_look)
        of = draws.measured_instead(seen)
        ghosts = draws.ghosts(seen) & (k >= first_look)
        wild = (luck[:, 0] < outlier_fraction) | ghosts | draws.in_burst()
        seen |= ghosts
        # What the sensor believes to see decides how exact it says to be.
        sighted = np.where(wild[:, None], _in_cone(luck[:, 1:], range_max_m, cosine), true[of])
        deviations = noise_scale * observation_share * np.maximum(np.abs(sighted), observation_floor_m)
        ids = np.flatnonzero(seen)
        R = deviations[ids, :, None] * np.eye(3) * deviations[ids, None, :]
        detections.append(Detections((sighted + deviations * noise)[ids], R, ids))
        masks.append((wild | (of != np.arange(of.size)))[ids])

    t: FloatArray = np.arange(steps, dtype=np.float64) * time_step_s
    return Log(
        name="space",
        problem=Problem(T_world_body[0], np.zeros((6, 6)), sensor),
        t=t,
        T_prev_body=increments,
        Q=Q,
        detections=tuple(detections),
        truth=GroundTruth(t, T_world_body, np.arange(landmarks), positions, tuple(masks)),
    )


def _in_cone(luck: FloatArray, range_max_m: float, cosine: float) -> FloatArray:
    """Points (m, 3), uniform in the cone about z, from uniform numbers (m, 3)."""
    distance, z = range_max_m * np.cbrt(luck[:, 0]), 1.0 - (1.0 - cosine) * luck[:, 1]
    turn, across = 2 * math.pi * luck[:, 2], np.sqrt(1.0 - z**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=-1)
    points: FloatArray = distance[:, None] * directions
    return points


def _course(box: FloatArray, angle: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) at these angles of the loop."""
    curve = np.stack([np.cos(3 * angle), np.sin(2 * angle), np.sin(2 * angle + 1)], axis=-1)
    turns = (5 * angle + 2, -3 * angle, 4 * angle)
    about_x, about_y, about_z = (
        so3_exp(turn[:, None] * axis) for turn, axis in zip(turns, np.eye(3), strict=True)
    )
    return pose(about_z @ about_y @ about_x, curve * box / 2)
