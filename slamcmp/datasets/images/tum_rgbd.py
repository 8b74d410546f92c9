"""The RGB-D sequences of TUM (Sturm et al. 2012): a Kinect in the hand, poses from motion capture.

A sequence's folder holds ``rgb.txt``, ``depth.txt`` and ``groundtruth.txt`` (t x y z qx qy qz qw), or
``associations.txt`` with the pairs of images. Depth is registered to colour, 5000 units a metre. The poses
are the colour camera's (x right, y down, z forward) in a world with z up.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt

from slamcmp.datasets.folders import find_folder, numbers, require_file, text_rows
from slamcmp.datasets.images.camera_frames import DepthFormat, FrameFiles, RecordedFrames, require_size
from slamcmp.datasets.images.recording import Recording, image_source
from slamcmp.datasets.images.rectification import Lens, undistort
from slamcmp.datasets.pairing import nearest_in_time
from slamcmp.datasets.text import read_text
from slamcmp.datasets.time_stamps import TimeUnit, in_seconds
from slamcmp.datasets.trajectories import MAX_GAP_S, poses_at, read_tum_trajectory
from slamcmp.errors import DataError
from slamcmp.geometry import inverse
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera, RgbdCamera
from slamcmp.support.files.paths import is_file
from slamcmp.types import FloatArray

Calibration = Literal["auto", "freiburg1", "freiburg2", "freiburg3", "ros_default"]

ORIGIN = "https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download"
SIZE = (640, 480)
DEPTH = DepthFormat(5000.0)
TRUTH_SIGMA = 0.01
"""Of the motion capture over its whole area [m], and what half a degree is [rad] (Sturm et al. 2012)."""
MAX_DELAY_S = 0.02
"""Between the two images of a pair."""

INTRINSICS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, (0.0, 0.0, 0.0, 0.0, 0.0)),
    "ros_default": (525.0, 525.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0, 0.0)),
}
"""fx, fy, cx, cy [px] and the lens of the colour camera, as its authors published them."""


@image_source("tum_rgbd", paths=("folder",), speed_sigma_m_s=0.5, turn_sigma_deg_s=60.0)
def tum_rgbd(
    *,
    folder: str,
    camera: Literal["rgbd", "mono"] = "rgbd",
    calibration: Calibration = "auto",
    time_unit: TimeUnit = "auto",
    pair_within_s: Annotated[float, Gt(0)] = MAX_DELAY_S,
    max_gap_s: Annotated[float, Gt(0)] = MAX_GAP_S,
) -> Recording:
    """A TUM RGB-D sequence: colour and depth images from a camera in the hand, with poses.

    ``folder`` holds ``rgb.txt``, here or under ``SLAMCMP_DATA``. The ``calibration`` ``auto`` is that of the
    Kinect which the sequence's name tells. The body is at the colour camera with x forward, y left, z up;
    the world is the motion capture's, z up. Lens distortion is removed from both images.
    A colour image is paired with the depth image nearest in time, at most ``pair_within_s`` away; poses are
    interpolated between two that are at most ``max_gap_s`` apart. ``time_unit`` is that of all stamps.

    Raises:
        MissingDataError: no such folder or lists.
        DataError: a file does not hold what its format promises.
    """
    root = find_folder(folder, what="a TUM RGB-D sequence", origin=ORIGIN)
    with_depth = camera == "rgbd"
    t, files, read, warnings = (
        _pairs(root, time_unit, pair_within_s) if with_depth else _colour(root, time_unit)
    )
    told: list[str] = []
    chosen, doubt = (calibration, ()) if calibration != "auto" else _guessed(root)
    fx, fy, cx, cy, distortion = INTRINSICS[chosen]
    require_size(files, SIZE, f"calibration {chosen}")
    K, remap = undistort(Lens(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array(distortion)), SIZE)
    kind = RgbdCamera if with_depth else MonoCamera
    model = kind(fx_px=K[0, 0], fy_px=K[1, 1], cx_px=K[0, 2], cy_px=K[1, 2])

    truth = None
    poses = root / "groundtruth.txt"
    if is_file(poses):
        read.append(poses)
        stamps, T = read_tum_trajectory(poses, time_unit=time_unit, told=told)
        truth = poses_at(t, stamps, T, max_gap_s=max_gap_s) @ inverse(FORWARD_CAMERA)
    depth = DEPTH if with_depth else None
    images = RecordedFrames(files, SIZE, remap, depth_format=depth, depth_remap=remap)
    return Recording(
        f"tum_{root.resolve().name}",
        t,
        images,
        model,
        truth,
        files=tuple(read),
        warnings=(*warnings, *doubt, *told),
        truth_sigma=TRUTH_SIGMA,
    )


Listing = tuple[FloatArray, tuple[FrameFiles, ...], list[Path], tuple[str, ...]]


def _colour(root: Path, unit: TimeUnit) -> Listing:
    path = require_file(root / "rgb.txt", "the time stamps and names of the colour images")
    t, names = _list(path, unit)
    return t, tuple(FrameFiles(root / name) for name in names), [path], ()


def _pairs(root: Path, unit: TimeUnit, pair_within_s: float) -> Listing:
    """Colour images, each with the depth image nearest in time."""
    known = root / "associations.txt"
    if is_file(known):
        rows = text_rows(known, 4)
        if not rows:
            raise DataError(f"{known}: names no pair of images")
        t = _stamps(known, rows, unit)
        files = tuple(FrameFiles(root / fields[1], depth=root / fields[3]) for _, fields in rows)
        return t, files, [known], ()
    colour = require_file(root / "rgb.txt", "the time stamps and names of the colour images")
    depth = require_file(root / "depth.txt", "the time stamps and names of the depth images")
    t, names = _list(colour, unit)
    t_depth, depth_names = _list(depth, unit)
    nearest, delays = nearest_in_time(t, t_depth)
    paired = delays <= pair_within_s
    if not paired.any():
        raise DataError(
            f"{depth}: no depth image is within pair_within_s ({pair_within_s:g} s) of a colour image; "
            "the nearest "
            f"is {delays.min():.3g} s away: other clocks, or a wrong time_unit?"
        )
    files = tuple(
        FrameFiles(root / names[k], depth=root / depth_names[nearest[k]]) for k in np.flatnonzero(paired)
    )
    lost = int((~paired).sum())
    warnings = (
        (f"left out {lost} colour image(s) without a depth image within {pair_within_s:g} s (pair_within_s)",)
        if lost
        else ()
    )
    return t[paired], files, [colour, depth], warnings


def _list(path: Path, unit: TimeUnit) -> tuple[FloatArray, list[str]]:
    rows = text_rows(path, 2)
    if not rows:
        raise DataError(f"{path}: names no image")
    return _stamps(path, rows, unit), [fields[1] for _, fields in rows]


def _stamps(path: Path, rows: list[tuple[str, list[str]]], unit: TimeUnit) -> FloatArray:
    t = np.array([numbers(where, fields[:1])[0] for where, fields in rows])
    return in_seconds(path, t, unit, parameter="time_unit")


def _guessed(root: Path) -> tuple[Calibration, tuple[str, ...]]:
    """From the folder's name, or from the name of the original recording in the lists' comments."""
    texts = [root.resolve().name]
    texts += [read_text(p)[:200] for p in (root / "rgb.txt", root / "depth.txt") if is_file(p)]
    for text in texts:
        found = re.search(r"(?:freiburg|fr)([123])(?!\d)", text)
        if found:
            kinect: Calibration = {"1": "freiburg1", "2": "freiburg2", "3": "freiburg3"}[found[1]]  # type: ignore[assignment]
            return kinect, ()
    return "ros_default", (f"{root} does not tell its Kinect: calibration ros_default is taken",)
