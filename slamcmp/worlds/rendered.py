"""Rendered camera worlds: a robot with a camera drives through a textured room or corridor.

The truth is exact; images show perspective, texture, occlusion, changing light, motion blur and noise. The
camera is mono, stereo or RGB-D. Images are the same on one machine; another version of OpenCV may round a
grey value differently, so that a stream made from them keeps its digest only where it was stored.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Interval

from slamcmp.errors import UsageError
from slamcmp.geometry import dead_reckoning, exp, inverse
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.models.motion import Unicycle
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem
from slamcmp.worlds import paths

if TYPE_CHECKING:
    from slamcmp.worlds.rendering.images import RenderedImages

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Interval(ge=0, lt=1)]
CameraName = Literal["mono", "stereo", "rgbd"]
Building = Literal["room", "corridor"]

_CLEARANCE_M = {"room": 1.6, "corridor": 0.9}
"""Between the path and the walls."""


@sources.register("rendered", seeded=True, images=True)
def rendered(
    seed: int,
    *,
    building: Building = "room",
    camera: CameraName = "stereo",
    steps: Annotated[int, Ge(2)] = 200,
    time_step_s: Positive = 0.1,
    speed_m_s: Positive = 0.6,
    turn_deg_s: Positive = 30.0,
    length_m: Positive = 3.0,
    width_px: Annotated[int, Ge(64)] = 640,
    height_px: Annotated[int, Ge(64)] = 480,
    field_of_view_deg: Annotated[float, Interval(ge=20, le=140)] = 75.0,
    baseline_m: Positive = 0.12,
    camera_height_m: Annotated[float, Interval(gt=0, lt=2.5)] = 0.6,
    camera_yaw_deg: float = 0.0,
    exposure_share: Share = 0.1,
    exposure_samples: Annotated[int, Interval(ge=1, le=16)] = 4,
    light_change: Share = 0.2,
    noise_sigma: NotNegative = 2.0,
    vignetting: Share = 0.2,
    depth_sigma_per_m2: NotNegative = 0.002,
    depth_max_m: Positive = 8.0,
    translation_sigma_m: NotNegative = 0.004,
    rotation_sigma_deg: NotNegative = 0.25,
    tilt_sigma_deg: Positive = 0.02,
    height_sigma_m: Positive = 0.0005,
    prior_sigma: NotNegative = 1e-6,
) -> Log:
    """Images of a drive round a textured room or up and down a corridor, with noisy wheel odometry.

    Args:
        seed: of the furniture, the light, the odometry noise and the image noise.
        building: ``room`` or ``corridor``.
        camera: ``mono``, ``stereo`` or ``rgbd``.
        steps: frames, the first one included.
        time_step_s: between frames.
        speed_m_s: along the path.
        turn_deg_s: in the bends; with the speed it sets their radius.
        length_m: of the path's straight lines.
        width_px: of the images.
        height_px: of the images.
        field_of_view_deg: horizontal.
        baseline_m: between the two cameras of ``stereo``.
        camera_height_m: above the floor.
        camera_yaw_deg: of the camera against the direction of travel, to the left.
        exposure_share: of the time step that the shutter is open; sets the motion blur.
        exposure_samples: drawings that one image is the mean of.
        light_change: largest share by which the light rises and falls over the drive.
        noise_sigma: of each pixel, in grey levels.
        vignetting: share of the light that is missing in the image's corners.
        depth_sigma_per_m2: of ``rgbd``: sigma at 1 m, growing with the square of the depth.
        depth_max_m: of ``rgbd``: farther surfaces have no depth.
        translation_sigma_m: of the odometry, a step, along x and y.
        rotation_sigma_deg: of the odometry, a step, about the vertical axis.
        tilt_sigma_deg: of the odometry, a step, about the other axes.
        height_sigma_m: of the odometry, a step.
        prior_sigma: of the first pose, per axis [rad, m].

    Returns:
        A log whose ``images`` are rendered on demand and know the true matches; it has no detections yet.

    Raises:
        UsageError: ``building`` or ``camera`` is not one of the names above.
    """
    streams = random_streams(seed)
    radius = speed_m_s / math.radians(turn_deg_s)
    controls = paths.drive(paths.stadium(length_m, radius), steps, speed_m_s, time_step_s)
    T_world_body = _spatial(dead_reckoning(np.eye(3), _planar_increments(controls, time_step_s)))
    model = _camera(
        camera, width_px, height_px, field_of_view_deg, baseline_m, camera_height_m, camera_yaw_deg
    )

    # OpenCV is loaded only now: planar worlds do not need it.
    from slamcmp.worlds.rendering import buildings
    from slamcmp.worlds.rendering.images import Exposure, RenderedImages

    builders = {"room": buildings.room, "corridor": buildings.corridor}
    if building not in builders:
        raise UsageError(f"building is {building!r}; room or corridor is needed")
    clearance = _CLEARANCE_M[building]
    low = np.array([-radius - clearance, -clearance])
    high = np.array([length_m + radius + clearance, 2 * radius + clearance])
    furniture, light = streams.world.spawn(2)
    exposure = Exposure(
        exposure_share,
        exposure_samples,
        _gains(steps, light_change, light),
        noise_sigma,
        vignetting,
        depth_sigma_per_m2,
        depth_max_m,
    )
    images = RenderedImages(
        builders[building](low, high, furniture),
        model,
        (width_px, height_px),
        T_world_body,
        exposure,
        np.random.SeedSequence(int(streams.sensor.integers(2**63))),
        with_depth=camera == "rgbd",
    )
    sigmas = np.array(
        [
            math.radians(tilt_sigma_deg),
            math.radians(tilt_sigma_deg),
            math.radians(rotation_sigma_deg),
            translation_sigma_m,
            translation_sigma_m,
            height_sigma_m,
        ]
    )
    return _log(
        f"rendered_{building}", T_world_body, time_step_s, sigmas, prior_sigma, images, streams.odometry
    )


def _log(
    name: str,
    T_world_body: FloatArray,
    time_step_s: float,
    sigmas: FloatArray,
    prior_sigma: float,
    images: RenderedImages,
    generator: np.random.Generator,
) -> Log:
    steps = len(T_world_body)
    increments = np.tile(np.eye(4), (steps, 1, 1))
    noise = exp(sigmas * generator.standard_normal((steps - 1, 6)))
    increments[1:] = inverse(T_world_body[:-1]) @ T_world_body[1:] @ noise
    Q = np.zeros((steps, 6, 6))
    Q[1:] = np.diag(sigmas**2)
    t: FloatArray = np.arange(steps, dtype=np.float64) * time_step_s
    sensor = images.camera
    nothing = Detections(
        np.empty((0, sensor.dim)), np.empty((0, sensor.dim, sensor.dim)), np.empty(0, np.int64)
    )
    prior = T_world_body[0] @ exp(-prior_sigma * generator.standard_normal(6))
    truth = GroundTruth(t, T_world_body, np.empty(0, np.int64), np.empty((0, 3)))
    problem = Problem(prior, prior_sigma**2 * np.eye(6), sensor)
    return Log(name, problem, t, increments, Q, (nothing,) * steps, truth, images)


def _planar_increments(controls: FloatArray, time_step_s: float) -> FloatArray:
    return np.concatenate([np.eye(3)[None], Unicycle().increment(controls, time_step_s)])


def _spatial(planar: FloatArray) -> FloatArray:
    """Planar poses (K, 3, 3) as poses (K, 4, 4) on the floor."""
    poses = np.tile(np.eye(4), (len(planar), 1, 1))
    poses[:, :2, :2], poses[:, :2, 3] = planar[:, :2, :2], planar[:, :2, 2]
    return poses


def _camera(
    name: CameraName,
    width_px: int,
    height_px: int,
    field_of_view_deg: float,
    baseline_m: float,
    camera_height_m: float,
    camera_yaw_deg: float,
) -> MonoCamera | StereoCamera | RgbdCamera:
    focal = 0.5 * width_px / math.tan(math.radians(field_of_view_deg) / 2)
    cx, cy = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    mounting = exp(np.array([0.0, 0.0, math.radians(camera_yaw_deg), 0.0, 0.0, 0.0])) @ FORWARD_CAMERA
    mounting[2, 3] = camera_height_m
    if name == "mono":
        return MonoCamera(fx_px=focal, fy_px=focal, cx_px=cx, cy_px=cy, T_body_camera=mounting)
    if name == "rgbd":
        return RgbdCamera(fx_px=focal, fy_px=focal, cx_px=cx, cy_px=cy, T_body_camera=mounting)
    if name == "stereo":
        return StereoCamera(
            fx_px=focal, fy_px=focal, cx_px=cx, cy_px=cy, baseline_m=baseline_m, T_body_camera=mounting
        )
    raise UsageError(f"camera is {name!r}; mono, stereo or rgbd is needed")


def _gains(steps: int, change: float, generator: np.random.Generator) -> FloatArray:
    """Slow waves of light with a little flicker, (K,)."""
    phase = generator.uniform(0.0, 2.0 * math.pi)
    waves = np.sin(2.0 * math.pi * np.arange(steps) / 75.0 + phase)
    gains: FloatArray = (1.0 + change * waves) * (1.0 + 0.05 * change * generator.standard_normal(steps))
    return gains
