"""The 7-Scenes sequences (Shotton et al. 2013): a Kinect in the hand, poses by KinectFusion.

A sequence's folder holds ``frame-NNNNNN.color.png`` (or .jpg), ``.depth.png`` (millimetres, 65535 where not
known) and ``.pose.txt`` (4×4, camera to world). The published intrinsics and the poses are those of the depth
camera; its images are *not* registered to colour. Here they are scaled to the colour camera's focal length,
as if both looked from one point: with it a tracked corner of redkitchen is found again to within 1.4 px
(median), with the depth camera's to within 4.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from slamcmp.datasets.folders import find_folder, number_table
from slamcmp.datasets.images.camera_frames import (
    DepthFormat,
    FrameFiles,
    RecordedFrames,
    require_fit,
    require_size,
)
from slamcmp.datasets.images.recording import Recording, image_source
from slamcmp.datasets.images.rectification import refocus
from slamcmp.datasets.trajectories import nearest_rotations
from slamcmp.errors import DataError, MissingDataError
from slamcmp.geometry import inverse, pose
from slamcmp.models.camera import FORWARD_CAMERA, RgbdCamera
from slamcmp.support.files.paths import is_file
from slamcmp.types import FloatArray

ORIGIN = "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/"
SIZE = (640, 480)
DEPTH = DepthFormat(1000.0, unknown=65535)
FRAMES_PER_S = 30.0
"""Nominal; the set has no time stamps."""
INTRINSICS = (585.0, 585.0, 320.0, 240.0)
"""fx, fy, cx, cy [px] of the depth camera, as its authors published them."""
TRUTH_SIGMA = 0.01
"""Of KinectFusion's poses, a centimetre and half a degree: the depth images that made them know no better."""
COLOUR_FOCAL_PX = 525.0
"""Of the Kinect's colour camera, as its driver has it; the set tells none."""


@image_source("seven_scenes", paths=("folder",), speed_sigma_m_s=0.5, turn_sigma_deg_s=60.0)
def seven_scenes(*, folder: str) -> Recording:
    """A 7-Scenes sequence: colour and depth images from a camera in the hand, with poses.

    ``folder`` holds ``frame-000000.color.png`` and so on, here or under ``SLAMCMP_DATA``. The body is at the
    camera with x forward, y left, z up; the world is the set's with its axes turned alike, so that z is
    roughly up. Depth images are scaled to the colour camera's focal length. Frames are 1/30 s apart for each
    number between them.

    Raises:
        MissingDataError: no such folder, or no images in it.
        DataError: a file does not hold what its format promises.
    """
    root = find_folder(folder, what="a 7-Scenes sequence", origin=ORIGIN)
    frames = _frames(root)
    files = tuple(FrameFiles(path, depth=root / f"frame-{digits}.depth.png") for digits, path in frames)
    read = [root / f"frame-{digits}.pose.txt" for digits, _ in frames]
    truth = np.stack([_pose(path) for path in read])
    own = root / "camera-intrinsics.txt"
    fx, fy, cx, cy = INTRINSICS
    if is_file(own):
        K = number_table(own, 3, exactly=True)
        if K.shape != (3, 3):
            raise DataError(f"{own}: {len(K)} rows where a 3×3 matrix is needed")
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        read.append(own)
    model = RgbdCamera(fx_px=COLOUR_FOCAL_PX, fy_px=COLOUR_FOCAL_PX, cx_px=cx, cy_px=cy)
    K_depth = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    require_size(files, SIZE, "7-Scenes")
    require_fit(model, SIZE, str(own))
    return Recording(
        f"seven_scenes_{root.resolve().name}",
        np.array([int(digits) for digits, _ in frames]) / FRAMES_PER_S,
        RecordedFrames(files, SIZE, depth_format=DEPTH, depth_remap=refocus(K_depth, model.K, SIZE)),
        model,
        FORWARD_CAMERA @ truth @ inverse(FORWARD_CAMERA),
        files=tuple(path for path in read if is_file(path)),
        warnings=(
            "depth is registered to colour by focal length only: a landmark's depth may be that of a point "
            "some pixels away",
        ),
        truth_sigma=TRUTH_SIGMA,
    )


def _frames(root: Path) -> list[tuple[str, Path]]:
    """(digits, colour image) in the order of the numbers."""
    names = [
        match
        for path in root.iterdir()
        if (match := re.fullmatch(r"frame-([0-9]+)\.(color|depth|pose)\.(png|jpg|txt)", path.name))
    ]
    suffixes = {match[3] for match in names if match[2] == "color"}
    if not suffixes:
        raise MissingDataError(
            f"{root}: holds no images such as frame-000000.color.png; get them from {ORIGIN}"
        )
    if len(suffixes) > 1:
        raise DataError(
            f"{root}: holds colour images as {' and as '.join(sorted(suffixes))}; which ones count is not "
            "told: keep one format"
        )
    # A frame of which any file is there counts: what is missing of it is then said of the frame.
    (suffix,) = suffixes
    frames = sorted({match[1] for match in names}, key=int)
    return [(digits, root / f"frame-{digits}.color.{suffix}") for digits in frames]


def _pose(path: Path) -> FloatArray:
    """``T_world_camera``, (4, 4); NaN where tracking was lost, which the set's files show in several ways."""
    try:
        T = number_table(path, 4, exactly=True)
        if T.shape != (4, 4):
            raise DataError(f"{path}: {len(T)} rows where 4 are needed")
        return pose(nearest_rotations(path, T[:3, :3]), T[:3, 3])
    except (DataError, MissingDataError):
        return np.full((4, 4), np.nan)
