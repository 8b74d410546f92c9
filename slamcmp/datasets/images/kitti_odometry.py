"""KITTI's odometry sequences (Geiger, Lenz and Urtasun 2012): a car, rectified grey images at 10 Hz.

A sequence's folder holds ``calib.txt``, ``times.txt``, ``image_0`` (left) and ``image_1`` (right); its poses
are in ``poses/NN.txt`` beside ``sequences``, or in ``poses.txt`` in the folder itself. Those poses are the
left camera's (x right, y down, z forward) in its first frame. They settle over the first images: those of 06
turn by 0.6° in heading against what the images show (docs/recorded-images.md), which ``start`` leaves out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np

from slamcmp.datasets.folders import (
    find_data_file,
    find_folder,
    number_table,
    numbers,
    require_file,
    text_rows,
)
from slamcmp.datasets.images.camera_frames import FrameFiles, RecordedFrames, first_size, require_fit
from slamcmp.datasets.images.recording import Recording, image_source
from slamcmp.datasets.time_stamps import TimeUnit, in_seconds
from slamcmp.datasets.trajectories import read_kitti_poses
from slamcmp.errors import DataError, MissingDataError
from slamcmp.geometry import inverse
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera, StereoCamera
from slamcmp.support.files.paths import is_dir, is_file
from slamcmp.types import FloatArray

ORIGIN = "https://www.cvlibs.net/datasets/kitti/eval_odometry.php (grey images, calibration, poses)"
TRUTH_SIGMA = 0.002
"""Of a pose, per axis [rad, m]: the car's unit resolves 0.1° (Geiger, Lenz and Urtasun 2012, section 2.1)."""
PERIOD_S = 0.1
"""Between frames, nominally."""


@image_source(
    "kitti_odometry",
    paths=("folder", "poses"),
    translation_sigma_m=0.01,
    translation_sigma_per_m=0.03,
    rotation_sigma_deg=0.1,
    speed_sigma_m_s=15.0,
    turn_sigma_deg_s=20.0,
)
def kitti_odometry(
    *,
    folder: str,
    camera: Literal["mono", "stereo"] = "mono",
    poses: str | None = None,
    time_unit: TimeUnit = "auto",
) -> Recording:
    """A KITTI odometry sequence: grey images of a car's drive, with poses.

    ``folder`` is the sequence's (``sequences/06``), here or under ``SLAMCMP_DATA``; ``poses`` a file of its
    poses, found by itself in the published layout. The body is at the left camera with x forward, y left,
    z up; the world is the body at the sequence's first image. Without ``times.txt``, whose stamps are in
    ``time_unit``, frames are 0.1 s apart.

    Raises:
        MissingDataError: no such folder, calibration or images.
        DataError: a file does not hold what its format promises.
    """
    root = find_folder(folder, what="a sequence of KITTI's odometry set", origin=ORIGIN)
    calibration = require_file(root / "calib.txt", "the projection matrices P0 and P1")
    left_folder = _image_folder(root, ("image_0", "image_l"))
    frames = _frame_numbers(left_folder)
    right_folder = _image_folder(root, ("image_1", "image_r")) if camera == "stereo" else None
    files = tuple(
        FrameFiles(
            left_folder / f"{frame:06d}.png",
            None if right_folder is None else right_folder / f"{frame:06d}.png",
        )
        for frame in frames
    )
    model = _camera(calibration, stereo=camera == "stereo")
    size = first_size(files)
    require_fit(model, size, str(calibration))
    read = [calibration]
    warnings: list[str] = []

    times = root / "times.txt"
    t: FloatArray = np.array(frames) * PERIOD_S
    if is_file(times):
        read.append(times)
        stamps = in_seconds(
            times, number_table(times, 1)[:, 0], time_unit, parameter="time_unit", told=warnings
        )
        t = _rows(times, stamps, frames)
    else:
        warnings.append(f"{root} has no times.txt: frames are taken to be {PERIOD_S} s apart")

    truth = None
    pose_file = _pose_file(root, poses)
    if pose_file is not None:
        read.append(pose_file)
        T_camera = _rows(pose_file, read_kitti_poses(pose_file), frames)
        truth = FORWARD_CAMERA @ T_camera @ inverse(FORWARD_CAMERA)
    name = f"kitti_{root.resolve().name}"
    return Recording(
        name,
        t,
        RecordedFrames(files, size),
        model,
        truth,
        files=tuple(read),
        warnings=tuple(warnings),
        truth_sigma=TRUTH_SIGMA,
    )


def _image_folder(root: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        if is_dir(root / name):
            return root / name
    raise MissingDataError(f"{root / names[0]}: there is no such folder of images; get it from {ORIGIN}")


def _frame_numbers(folder: Path) -> list[int]:
    """From the first image to the last; a missing one in between is a frame without image."""
    found = sorted(int(path.stem) for path in folder.glob("*.png") if re.fullmatch("[0-9]+", path.stem))
    if not found:
        raise MissingDataError(f"{folder}: holds no images such as 000000.png; get them from {ORIGIN}")
    return list(range(found[0], found[-1] + 1))


def _camera(calibration: Path, *, stereo: bool) -> MonoCamera | StereoCamera:
    """From ``P0: …`` and ``P1: …``, whose labels may be missing; P1's last column holds the baseline."""
    matrices: dict[str, FloatArray] = {}
    for index, (where, fields) in enumerate(text_rows(calibration, 12)):
        label = fields[0].rstrip(":") if fields[0].endswith(":") else f"P{index}"
        values = numbers(where, fields[1:] if fields[0].endswith(":") else fields)
        if len(values) == 12:
            matrices[label] = np.array(values).reshape(3, 4)
    for label in ("P0", "P1") if stereo else ("P0",):
        if label not in matrices:
            raise DataError(f"{calibration}: has no projection matrix {label} of 12 numbers")
    K = matrices["P0"]
    intrinsics = {"fx_px": K[0, 0], "fy_px": K[1, 1], "cx_px": K[0, 2], "cy_px": K[1, 2]}
    if not stereo:
        return MonoCamera(**intrinsics)
    # Both columns are seen from camera 0, which the left one need not be.
    baseline = (K[0, 3] / K[0, 0]) - matrices["P1"][0, 3] / matrices["P1"][0, 0]
    if not baseline > 0:
        raise DataError(f"{calibration}: P1 gives a baseline of {baseline:g} m; a positive one is needed")
    return StereoCamera(**intrinsics, baseline_m=baseline)


def _rows(path: Path, rows: FloatArray, frames: list[int]) -> FloatArray:
    if frames[-1] >= len(rows):
        raise DataError(
            f"{path}: {len(rows)} rows, but there is an image {frames[-1]:06d}; row n belongs to image n"
        )
    return rows[frames]


def _pose_file(root: Path, given: str | None) -> Path | None:
    if given is not None:
        return find_data_file(given)
    absolute = root.resolve()
    for path in (root / "poses.txt", absolute.parent.parent / "poses" / f"{absolute.name}.txt"):
        if is_file(path):
            return path
    return None
