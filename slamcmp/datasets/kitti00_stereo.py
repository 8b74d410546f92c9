"""Stereo measurements of KITTI 00's first 154 images, as the gtsam wheel carries them.

``VO_stereo_factors00.txt`` has lines ``pose landmark u_left u_right v X Y Z`` (88 781 of 26 136 landmarks),
``VO_camera_poses00.txt`` the poses of 135 images that a visual odometry found, camera to world. Pose ids are
KITTI's image numbers, of which every second one is left out from 94 to 130: only so do the poses lie 0.318 m
(RMS, aligned) from KITTI's own over 111 m; counted through they are 3.3 m off.

KITTI's own poses are not good everywhere: over the first 15 images their steps are longer than the measured
ones by 27 % falling to 0, where a stereo baseline cannot err so. Most of the 0.318 m comes from there: images
50 to 153 alone lie 0.068 m off.

The file's poses were found with these very measurements. As odometry they are therefore not independent of
them, and a back end counts what they have in common twice; wheels would be fairer, the file has none.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from slamcmp.datasets.folders import DATA_VARIABLE, find_data_file, number_table
from slamcmp.datasets.images.recorded_odometry import OdometryNoise, make_odometry
from slamcmp.datasets.trajectories import nearest_rotations, read_kitti_poses
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.geometry import inverse, pose
from slamcmp.models.camera import FORWARD_CAMERA, StereoCamera
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem

Positive = Annotated[float, Gt(0)]

PERIOD_S = 0.1
"""Between images, nominally."""


def _files(*, truth_file: str | None = None, truth_optional: bool = False, **_: Any) -> list[Path]:
    truth = _truth_path(truth_file, optional=truth_optional)
    names = ("VO_calibration00.txt", "VO_camera_poses00.txt", "VO_stereo_factors00.txt")
    return [*(wheel_file(name) for name in names), *([] if truth is None else [truth])]


@sources.register("kitti00_stereo", seeded=False, files=_files, paths=("truth_file",))
def kitti00_stereo(
    seed: int = 0,  # noqa: ARG001
    *,
    truth_file: str | None = None,
    truth_optional: bool = False,
    start: Annotated[int, Ge(0)] = 0,
    steps: Annotated[int, Ge(2)] | None = None,
    pixel_sigma_px: Positive = 0.4,
    translation_sigma_m: Positive = 0.01,
    translation_sigma_per_m: Annotated[float, Ge(0)] = 0.03,
    rotation_sigma_deg: Positive = 0.06,
    prior_sigma: Annotated[float, Ge(0)] = 1e-6,
) -> Log:
    """Stereo measurements of KITTI 00 from the gtsam wheel: 135 frames, 26 136 landmarks, known association.

    ``truth_file`` holds KITTI's poses of sequence 00 (``poses/00.txt``, or its first 154 lines), here, beside
    the experiment file or under ``SLAMCMP_DATA``; without it there is no truth. With ``truth_optional`` a
    file that cannot be found is a warning and no error. ``pixel_sigma_px`` is that of
    each coordinate, such that the best fit has chi-squared per degree of freedom near 1. The odometry is the
    motion between the file's poses with the sigmas of a step of 0.1 s. ``start`` leaves out frames at the
    beginning, where the truth is doubtful, ``steps`` those after as many. The body is at the left camera with
    x forward, y left, z up; the world is the body at image 0.

    Raises:
        MissingDataError: the gtsam wheel is not installed, or there is no truth file.
        UsageError: fewer than two frames are left.
        DataError: the truth file has fewer poses than the measurements need, or is no file of poses.
    """
    images, poses = _initial_poses()
    wanted = slice(start, None if steps is None else start + steps)
    images, poses = images[wanted], poses[wanted]
    if len(images) < 2:
        raise UsageError(f"kitti00_stereo: start {start} leaves {len(images)} of 135 frames; 2 are needed")
    t: FloatArray = (images - images[0]) * PERIOD_S
    noise = OdometryNoise(translation_sigma_m, translation_sigma_per_m, rotation_sigma_deg, 1.0, 1.0)
    increments, covariances = make_odometry(
        "recorded", t, noise, np.random.default_rng(0), truth=None, recorded=poses
    )
    truth = None
    first = poses[0]
    path = _truth_path(truth_file, optional=truth_optional)
    warnings: tuple[str, ...] = ()
    if truth_file is not None and path is None:
        warnings = (f"no truth: {truth_file} was not found, nor under {DATA_VARIABLE}",)
    if path is not None:
        known = read_kitti_poses(path)
        if len(known) <= images[-1]:
            raise DataError(
                f"{path}: {len(known)} poses, but image {images[-1]} is measured; one an image is needed"
            )
        true_poses = _turned(known[images])
        first = true_poses[0]
        truth = GroundTruth(t, true_poses, np.empty(0, np.int64), np.empty((0, 3)))
    return Log(
        "kitti00_stereo",
        Problem(first, prior_sigma**2 * np.eye(6), _camera()),
        t,
        increments,
        covariances,
        _detections(images, pixel_sigma_px),
        truth,
        warnings=warnings,
    )


def _truth_path(truth_file: str | None, *, optional: bool) -> Path | None:
    if truth_file is None:
        return None
    try:
        return find_data_file(truth_file)
    except MissingDataError:
        if optional:
            return None
        raise


def _camera() -> StereoCamera:
    fx, fy, _, cx, cy, baseline = number_table(wheel_file("VO_calibration00.txt"), 6, exactly=True)[0]
    return StereoCamera(fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, baseline_m=baseline)


def _initial_poses() -> tuple[NDArray[np.int64], FloatArray]:
    """KITTI's image numbers (K,) and ``T_world_body`` (K, 4, 4)."""
    path = wheel_file("VO_camera_poses00.txt")
    table = number_table(path, 17, exactly=True)
    T = table[:, 1:].reshape(-1, 4, 4)
    # Six digits in the file leave the rotations skew by 1e-6, which 135 products would add up.
    return table[:, 0].astype(np.int64), _turned(pose(nearest_rotations(path, T[:, :3, :3]), T[:, :3, 3]))


def _turned(T_camera: FloatArray) -> FloatArray:
    """Poses of the camera in its first frame, as poses of a body with x forward in a world with z up."""
    return FORWARD_CAMERA @ T_camera @ inverse(FORWARD_CAMERA)


def _detections(images: NDArray[np.int64], sigma: float) -> tuple[Detections, ...]:
    table = number_table(wheel_file("VO_stereo_factors00.txt"), 8, exactly=True)
    order = np.lexsort((table[:, 1], table[:, 0]))
    table = table[order]
    bounds = np.append(
        np.searchsorted(table[:, 0], images), np.searchsorted(table[:, 0], images[-1], side="right")
    )
    R = sigma**2 * np.eye(3)
    return tuple(
        Detections(
            table[first:last, 2:5], np.tile(R, (last - first, 1, 1)), table[first:last, 1].astype(np.int64)
        )
        for first, last in pairwise(bounds)
    )
