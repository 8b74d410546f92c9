"""A calibration file of one's own camera, for folders of images.

What Kalibr, ROS, OpenCV and COLMAP write is read as well
(:mod:`slamcmp.datasets.images.foreign_calibrations`).

YAML with these keys, in pixels and metres::

    camera: stereo                  # mono, stereo or rgbd
    image_size: [752, 480]          # width, height
    intrinsics: [fx, fy, cx, cy]
    distortion: [k1, k2, p1, p2]    # radial-tangential, k3 may follow, or k3 to k6; absent: none
    lens: equidistant               # a fisheye with distortion [k1, k2, k3, k4]; absent: radial-tangential
    T_body_camera: [...]            # 4×4; absent: x forward, y left, z up at the camera
    baseline_m: 0.12                # stereo, where the pair is rectified already; else:
    right:
      intrinsics: [fx, fy, cx, cy]
      distortion: [k1, k2, p1, p2]
      T_left_right: [...]           # 4×4, maps points of the right camera to the left one
    depth_units_per_m: 1000         # rgbd: value of a pixel one metre away
    depth_unknown: 65535            # rgbd: a value for pixels without depth, beside 0; may be absent
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.datasets.images.camera_frames import DepthFormat, require_fit
from slamcmp.datasets.images.foreign_calibrations import colmap, in_own_words
from slamcmp.datasets.images.rectification import Lens, Remap, Size, rectify, require_no_fold, undistort
from slamcmp.datasets.images.yaml_file import numbers_of, read_mapping, rigid_of, value_of
from slamcmp.errors import DataError
from slamcmp.geometry import inverse, pose
from slamcmp.image_files import PIXELS_MAX
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.registry import did_you_mean
from slamcmp.types import FloatArray

AnyCamera = MonoCamera | StereoCamera | RgbdCamera

_COMMON = {"camera", "image_size", "intrinsics", "lens", "distortion", "T_body_camera"}
_OWN = {"mono": set(), "stereo": {"baseline_m", "right"}, "rgbd": {"depth_units_per_m", "depth_unknown"}}
_RIGHT = {"intrinsics", "lens", "distortion", "T_left_right"}
_LENSES = ("radial-tangential", "equidistant")


_BASELINE_M = (0.002, 5.0)
"""Of a pair on a robot or a car: an endoscope's, and twice that of KITTI's car and more."""


@dataclass(frozen=True)
class Calibration:
    """What a calibration file means for reading the images."""

    camera: AnyCamera
    """Without distortion, rectified."""
    size: Size
    left: Remap | None
    right: Remap | None
    depth: DepthFormat | None


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file; its keys stand in the module's text.

    Raises:
        DataError: a key is missing, not known, or its value does not fit; the message names file and key.
    """
    data = colmap(path) if path.suffix == ".txt" else in_own_words(path, read_mapping(path))
    kind = value_of(path, data, "camera")
    if not isinstance(kind, str) or kind not in _OWN:
        raise DataError(f"{path}: camera is {kind!r}; mono, stereo or rgbd is needed")
    _require_known(path, data, _COMMON | _OWN[kind])
    size = _size(path, data)
    mounting = rigid_of(path, data, "T_body_camera") if "T_body_camera" in data else FORWARD_CAMERA
    lens = _lens(path, data)
    require_no_fold(lens, size, source=str(path))
    if kind == "stereo":
        calibration = _stereo(path, data, lens, size, mounting)
    else:
        K, remap = undistort(lens, size)
        if kind == "mono":
            mono = MonoCamera(**_intrinsics(K), T_body_camera=mounting)
            calibration = Calibration(mono, size, remap, None, None)
        else:
            rgbd = RgbdCamera(**_intrinsics(K), T_body_camera=mounting)
            calibration = Calibration(rgbd, size, remap, None, _depth(path, data))
    require_fit(calibration.camera, size, str(path))
    return calibration


def _size(path: Path, data: dict[str, Any]) -> Size:
    width, height = numbers_of(path, data, "image_size", 2)
    if not (width >= 1 and height >= 1 and width * height <= PIXELS_MAX) or width % 1 or height % 1:
        raise DataError(
            f"{path}: image_size is {width:g} by {height:g}; whole pixels, {PIXELS_MAX // 10**6} million at "
            "most, are needed"
        )
    return int(width), int(height)


def _stereo(path: Path, data: dict[str, Any], lens: Lens, size: Size, mounting: FloatArray) -> Calibration:
    if ("right" in data) == ("baseline_m" in data):
        raise DataError(
            f"{path}: give baseline_m for a pair that is rectified, right for one that is not; one of them"
        )
    if "baseline_m" in data:
        if lens.distorts:
            raise DataError(f"{path}: a pair with distortion is not rectified; give right, not baseline_m")
        baseline = _plausible_baseline(path, _positive(path, "baseline_m", data["baseline_m"]))
        camera = StereoCamera(**_intrinsics(lens.K), baseline_m=baseline, T_body_camera=mounting)
        return Calibration(camera, size, None, None, None)
    _require_known(path, data["right"], _RIGHT, "right.")
    T_left_right = rigid_of(path, data, "right.T_left_right")
    right = _lens(path, data, "right.")
    require_no_fold(right, size, source=f"{path}: right")
    pair = rectify(lens, right, inverse(T_left_right), size, source=f"{path}: right.T_left_right")
    _plausible_baseline(path, pair.baseline_m)
    turned = mounting @ pose(pair.R_left_new, np.zeros(3))
    camera = StereoCamera(**_intrinsics(pair.K), baseline_m=pair.baseline_m, T_body_camera=turned)
    return Calibration(camera, size, pair.left, pair.right, None)


def _plausible_baseline(path: Path, baseline_m: float) -> float:
    if not _BASELINE_M[0] <= baseline_m <= _BASELINE_M[1]:
        raise DataError(
            f"{path}: the cameras of the pair are {baseline_m:g} m apart; are these millimetres? Metres are "
            "needed"
        )
    return baseline_m


def _depth(path: Path, data: dict[str, Any]) -> DepthFormat:
    units = _positive(path, "depth_units_per_m", value_of(path, data, "depth_units_per_m"))
    unknown = data.get("depth_unknown")
    return DepthFormat(units, None if unknown is None else int(_positive(path, "depth_unknown", unknown)))


def _intrinsics(K: FloatArray) -> dict[str, float]:
    return {"fx_px": K[0, 0], "fy_px": K[1, 1], "cx_px": K[0, 2], "cy_px": K[1, 2]}


def _lens(path: Path, data: dict[str, Any], prefix: str = "") -> Lens:
    fx, fy, cx, cy = numbers_of(path, data, f"{prefix}intrinsics", 4)
    for value in (fx, fy):
        _positive(path, f"{prefix}intrinsics", value)
    inner = data["right"] if prefix else data
    distortion = (
        numbers_of(path, data, f"{prefix}distortion", 4, 5, 8) if "distortion" in inner else [0.0] * 4
    )
    kind = inner.get("lens", _LENSES[0])
    if kind not in _LENSES:
        raise DataError(f"{path}: {prefix}lens is {kind!r}; {' or '.join(_LENSES)} is needed")
    equidistant = kind == _LENSES[1]
    if equidistant and len(distortion) != 4:
        raise DataError(f"{path}: {prefix}distortion of an equidistant lens has 4 numbers, k1 to k4")
    return Lens(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(distortion), equidistant)


def _positive(path: Path, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise DataError(f"{path}: {key} is {value!r}; a positive number is needed")
    return float(value)


def _require_known(path: Path, data: Any, known: set[str], prefix: str = "") -> None:
    if not isinstance(data, dict):
        raise DataError(f"{path}: {prefix.rstrip('.')} is not a mapping (key: value)")
    for key in data:
        if key not in known:
            raise DataError(f"{path}: unknown key {prefix}{key}{did_you_mean(str(key), known)}")
