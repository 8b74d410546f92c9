"""The EuRoC flights (Burri et al. 2016): a stereo pair on a small helicopter, poses at the IMU.

The layout is ``mav0/cam0``, ``mav0/cam1`` (``sensor.yaml``, ``data.csv``, ``data/``) and
``mav0/state_groundtruth_estimate0/data.csv`` (ns, position, quaternion w x y z of the body, …). Stamps are in
nanoseconds; ``T_BS`` maps points of a sensor to the body, which is the IMU.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from slamcmp.datasets.folders import find_folder, number_table, require_file, text_rows
from slamcmp.datasets.images.camera_frames import FrameFiles, RecordedFrames, require_fit, require_size
from slamcmp.datasets.images.recording import Recording, image_source
from slamcmp.datasets.images.rectification import Lens, Size, rectify, require_no_fold, undistort
from slamcmp.datasets.images.yaml_file import numbers_of, read_mapping, rigid_of, value_of
from slamcmp.datasets.pairing import nearest_in_time
from slamcmp.datasets.text import whole
from slamcmp.datasets.trajectories import MAX_GAP_S, ordered, poses_at, poses_from
from slamcmp.errors import DataError, MissingDataError
from slamcmp.geometry import inverse, pose
from slamcmp.models.camera import MonoCamera, StereoCamera
from slamcmp.support.files.paths import is_dir, is_file
from slamcmp.types import FloatArray

ORIGIN = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset/ (the ASL format)"
TRUTH_SIGMA = 0.002
"""Of the tracked poses, per axis [rad, m]: millimetres, of markers some decimetres apart."""
MAX_DELAY_S = 0.002
"""Between the two images of a pair; the cameras are triggered together."""


@image_source("euroc", paths=("folder",), speed_sigma_m_s=1.0, turn_sigma_deg_s=60.0)
def euroc(
    *,
    folder: str,
    camera: Literal["stereo", "mono"] = "stereo",
    pair_within_s: Annotated[float, Gt(0)] = MAX_DELAY_S,
    max_gap_s: Annotated[float, Gt(0)] = MAX_GAP_S,
) -> Recording:
    """A EuRoC flight: a stereo pair on a small helicopter, with poses.

    ``folder`` holds ``mav0``, here or under ``SLAMCMP_DATA``. The body is the IMU (x up, z forward as it is
    mounted); the world is the motion capture's, z up. Images are freed of distortion and rectified. The
    two of a pair are at most ``pair_within_s`` apart; poses are interpolated between two that are at most
    ``max_gap_s`` apart.

    Raises:
        MissingDataError: no such folder, calibration or list of images.
        DataError: a file does not hold what its format promises.
    """
    root = find_folder(folder, what="a EuRoC flight", origin=ORIGIN)
    if root.name != "mav0" and not is_dir(root / "mav0"):
        raise MissingDataError(f"{root}: has no folder mav0; get the flight from {ORIGIN}")
    mav = root if root.name == "mav0" else root / "mav0"
    left = _Camera.read(mav / "cam0")
    read = [*left.files]
    warnings: tuple[str, ...] = ()
    model: MonoCamera | StereoCamera
    if camera == "mono":
        files = tuple(FrameFiles(path) for path in left.images)
        stamps = left.stamps
        require_size(files, left.size, str(left.files[0]))
        K, remap = undistort(left.lens, left.size)
        model = MonoCamera(**_intrinsics(K), T_body_camera=left.T_body_camera)
        images = RecordedFrames(files, left.size, remap)
    else:
        right = _Camera.read(mav / "cam1")
        if right.size != left.size:
            raise DataError(f"{mav}: cam0 has {left.size} pixels and cam1 {right.size}; one size is needed")
        read += right.files
        stamps, files, warnings = _pairs(left, right, pair_within_s)
        require_size(files, left.size, str(left.files[0]))
        T_right_left = inverse(right.T_body_camera) @ left.T_body_camera
        pair = rectify(left.lens, right.lens, T_right_left, left.size, source=f"{mav}: T_BS of cam0 and cam1")
        mounting = left.T_body_camera @ pose(pair.R_left_new, np.zeros(3))
        model = StereoCamera(**_intrinsics(pair.K), baseline_m=pair.baseline_m, T_body_camera=mounting)
        images = RecordedFrames(files, left.size, pair.left, pair.right)
    require_fit(model, left.size, str(left.files[0]))

    # Nanoseconds since 1970 do not fit a float: the difference is taken in integers.
    origin = int(stamps[0])
    t: FloatArray = 1e-9 * (stamps - origin).astype(np.float64)
    truth = None
    poses = mav / "state_groundtruth_estimate0" / "data.csv"
    if is_file(poses):
        read.append(poses)
        truth = poses_at(t, *_truth(poses, origin), max_gap_s=max_gap_s)
    name = f"euroc_{mav.resolve().parent.name}"
    return Recording(
        name, t, images, model, truth, files=tuple(read), warnings=warnings, truth_sigma=TRUTH_SIGMA
    )


@dataclass(frozen=True)
class _Camera:
    lens: Lens
    size: Size
    T_body_camera: FloatArray
    stamps: NDArray[np.int64]
    """(K,) [ns]."""
    images: tuple[Path, ...]
    files: tuple[Path, Path]
    """The calibration and the list of images."""

    @classmethod
    def read(cls, folder: Path) -> _Camera:
        sheet = require_file(folder / "sensor.yaml", "the camera's calibration")
        listing = require_file(folder / "data.csv", "the time stamps and names of the images")
        data = read_mapping(sheet)
        for key, known in (
            ("camera_model", ("pinhole",)),
            ("distortion_model", ("radial-tangential", "equidistant")),
        ):
            if value_of(sheet, data, key) not in known:
                raise DataError(f"{sheet}: {key} is {data[key]!r}; {' or '.join(known)} is needed")
        width, height = numbers_of(sheet, data, "resolution", 2)
        fx, fy, cx, cy = numbers_of(sheet, data, "intrinsics", 4)
        lens = Lens(
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
            np.array(numbers_of(sheet, data, "distortion_coefficients", 4, 5)),
            data["distortion_model"] == "equidistant",
        )
        require_no_fold(lens, (int(width), int(height)), source=str(sheet))
        rows = text_rows(listing, 2)
        if not rows:
            raise DataError(f"{listing}: names no image")
        return cls(
            lens,
            (int(width), int(height)),
            rigid_of(sheet, data, "T_BS.data"),
            np.array([_nanoseconds(where, fields[0]) for where, fields in rows]),
            # A name may hold blanks.
            tuple(folder / "data" / " ".join(fields[1:]) for _, fields in rows),
            (sheet, listing),
        )


def _nanoseconds(where: str, text: str) -> int:
    try:
        return whole(where, text)
    except DataError:
        raise DataError(f"{where}: time stamp {text!r}; whole nanoseconds are needed") from None


def _intrinsics(K: FloatArray) -> dict[str, Any]:
    return {"fx_px": K[0, 0], "fy_px": K[1, 1], "cx_px": K[0, 2], "cy_px": K[1, 2]}


def _pairs(
    left: _Camera, right: _Camera, pair_within_s: float
) -> tuple[NDArray[np.int64], tuple[FrameFiles, ...], tuple[str, ...]]:
    """Left images, each with the right image of its instant."""
    partner, delays = nearest_in_time(left.stamps, right.stamps)
    paired = np.flatnonzero(delays <= 1e9 * pair_within_s)
    if not paired.size:
        raise DataError(
            f"{right.files[1]}: no image is within pair_within_s ({pair_within_s:g} s) of one of "
            f"{left.files[1]}; "
            f"the nearest is {1e-9 * delays.min():.3g} s away"
        )
    files = tuple(FrameFiles(left.images[k], right.images[partner[k]]) for k in paired)
    lost = left.stamps.size - paired.size
    warnings = (
        (f"left out {lost} left image(s) without a right one within {pair_within_s:g} s (pair_within_s)",)
        if lost
        else ()
    )
    return left.stamps[paired], files, warnings


def _truth(path: Path, origin: int) -> tuple[FloatArray, FloatArray]:
    table = number_table(path, 8)
    stamps = np.array([_nanoseconds(where, fields[0]) for where, fields in text_rows(path, 8)])
    quaternions = table[:, [5, 6, 7, 4]]
    return ordered(
        path, 1e-9 * (stamps - origin).astype(np.float64), poses_from(path, table[:, 1:4], quaternions)
    )
