"""Folders of images from one's own camera, with a calibration file."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from slamcmp import jpeg
from slamcmp.datasets.folders import find_folder, numbers, require_file, text_rows
from slamcmp.datasets.images.calibration_file import read_calibration
from slamcmp.datasets.images.camera_frames import FrameFiles, RecordedFrames, require_size
from slamcmp.datasets.images.recording import Recording, image_source
from slamcmp.datasets.time_stamps import TimeUnit
from slamcmp.datasets.trajectories import MAX_GAP_S, read_poses_at
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.models.camera import RgbdCamera, StereoCamera
from slamcmp.support.files.paths import is_dir, is_file
from slamcmp.types import FloatArray

Positive = Annotated[float, Gt(0)]

SUFFIXES = {".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff"}


@image_source("image_folder", paths=("folder",), odometry="constant_position")
def image_folder(
    *,
    folder: str,
    calibration: str = "calibration.yaml",
    images: str = ".",
    right: str = "right",
    depth: str = "depth",
    times: str | None = None,
    time_unit_s: Positive = 1.0,
    rate_hz: Positive | None = None,
    truth: str | None = None,
    recorded_odometry: str | None = None,
    pose_time_unit: TimeUnit = "auto",
    max_gap_s: Positive = MAX_GAP_S,
) -> Recording:
    """A folder of images with a calibration file: mono, stereo or RGB-D.

    All other paths are seen from ``folder``, which is here or under ``SLAMCMP_DATA``. ``images`` holds those
    of the left or only camera, ``right`` and ``depth`` the others with the same names (but for the suffix).
    Give either ``times``, a file with one stamp of ``time_unit_s`` a line in the images' order, or with stamp
    and image name; or ``rate_hz``. ``truth`` and ``recorded_odometry`` are files with lines
    ``t x y z qx qy qz qw`` of the body, stamps in ``pose_time_unit``, interpolated at the images' times
    between poses at most ``max_gap_s`` apart. The calibration's keys are told in
    :mod:`slamcmp.datasets.images.calibration_file`.

    Raises:
        MissingDataError: a folder or file is not there.
        DataError: a file does not hold what its format promises, or the calibration is for other images.
        UsageError: both or none of ``times`` and ``rate_hz``.
    """
    root = find_folder(folder, what="a folder of images with a calibration file", origin="your own camera")
    sheet = require_file(root / calibration, "the camera's calibration")
    calibrated = read_calibration(sheet)
    camera = calibrated.camera
    read = [sheet]
    if (times is None) == (rate_hz is None):
        raise UsageError("image_folder: give times (a file with time stamps) or rate_hz, one of them")
    left = _images(root / images)
    t: FloatArray
    if times is None:
        t = np.arange(len(left)) / (rate_hz or 1.0)
    else:
        stamps = require_file(root / times, "the time stamps of the images")
        read.append(stamps)
        t, left = _stamped(stamps, left, root / images)
        t = t * time_unit_s
    rights = _partners(left, root / right) if isinstance(camera, StereoCamera) else [None] * len(left)
    depths = _partners(left, root / depth) if isinstance(camera, RgbdCamera) else [None] * len(left)
    files = tuple(FrameFiles(*each) for each in zip(left, rights, depths, strict=True))
    require_size(files, calibrated.size, str(sheet))

    trajectories: list[FloatArray | None] = [None, None]
    told: list[str] = []
    for index, name in enumerate((truth, recorded_odometry)):
        if name is not None:
            path = require_file(root / name, "poses of the body, lines t x y z qx qy qz qw")
            read.append(path)
            trajectories[index] = read_poses_at(
                path,
                t,
                time_unit=pose_time_unit,
                max_gap_s=max_gap_s,
                parameters=("pose_time_unit", "max_gap_s"),
                told=told,
            )
    told += _turned_for_the_eye(left)
    return Recording(
        root.resolve().name,
        t,
        RecordedFrames(
            files,
            calibrated.size,
            calibrated.left,
            calibrated.right,
            calibrated.depth,
            calibrated.left if calibrated.depth else None,
        ),
        camera,
        truth=trajectories[0],
        odometry=trajectories[1],
        files=tuple(read),
        warnings=tuple(told),
    )


def _images(folder: Path) -> list[Path]:
    if not is_dir(folder):
        raise MissingDataError(f"{folder}: there is no such folder of images")
    # Names that begin with a dot are the file system's own; macOS leaves a ._x.png beside each x.png.
    found = [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    if not found:
        raise MissingDataError(f"{folder}: holds no images ({', '.join(sorted(SUFFIXES))})")
    found.sort(key=_natural)
    for one, two in pairwise(found):
        if one.stem == two.stem:
            raise DataError(
                f"{folder}: {one.name} and {two.name} are two formats of one image; which one counts is not "
                "told: keep one format"
            )
    return found


def _natural(path: Path) -> tuple[list[tuple[bool, int, str]], str]:
    """Numbers in a name count as numbers: img2 before img10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.stem)
    # Only these digits: a superscript two is one of Python's too, and no number.
    numbered = [p[0] in "0123456789" for p in parts]
    return [(not n, int(p) if n else 0, p) for p, n in zip(parts, numbered, strict=True)], path.name


def _turned_for_the_eye(images: list[Path]) -> list[str]:
    first = next((path for path in images if is_file(path)), None)
    if first is None or jpeg.orientation(first.read_bytes()) == 1:
        return []
    return [
        f"{first.parent}: EXIF says that {first.name} is to be turned for the eye; pixels are taken as they "
        "are stored, and the calibration must be one of pixels as stored"
    ]


def _stamped(path: Path, images: list[Path], folder: Path) -> tuple[FloatArray, list[Path]]:
    """The stamps, and the images: those the file names, else the folder's in the order of their names."""
    rows = text_rows(path, 1)
    t = np.array([numbers(where, fields[:1])[0] for where, fields in rows])
    # A name may hold blanks.
    named = [" ".join(fields[1:]) for _, fields in rows]
    if rows and all(named):
        return t, [folder / name for name in named]
    if any(named) or len(rows) != len(images):
        raise DataError(
            f"{path}: {len(rows)} time stamps for {len(images)} images in {folder}; give one for each image, "
            "or lines of stamp and image name"
        )
    return t, images


def _partners(left: list[Path], folder: Path) -> list[Path]:
    by_stem = {path.stem: path for path in _images(folder)}
    return [by_stem.get(path.stem, folder / path.name) for path in left]
