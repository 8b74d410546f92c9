"""Calibrations as other programs write them, in the words of :mod:`slamcmp.datasets.images.calibration_file`.

==============  ==========================================================================================
program         what it writes
==============  ==========================================================================================
Kalibr          YAML with ``cam0`` and perhaps ``cam1``; ``T_cn_cnm1`` maps points of cam0 to cam1, and
                ``T_cam_imu``, where it stands, points of the IMU, which is the body then, to the camera
ROS             ``camera_info``: YAML with ``image_width``, ``camera_matrix``, ``distortion_model``; or the
                message as it is printed, with ``K`` (``k``) and ``D`` (``d``)
OpenCV          its own YAML, ``!!opencv-matrix``, with ``camera_matrix`` or ``K`` and the like
COLMAP          ``cameras.txt``: ``ID MODEL WIDTH HEIGHT PARAMETERS``
==============  ==========================================================================================
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.datasets.folders import numbers, text_rows
from slamcmp.datasets.images.yaml_file import numbers_of, rigid_of, value_of
from slamcmp.errors import DataError
from slamcmp.geometry import inverse

Own = dict[str, Any]

_LENSES = {
    "radtan": "radial-tangential",
    "plumb_bob": "radial-tangential",
    "rational_polynomial": "radial-tangential",
    "radial-tangential": "radial-tangential",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "Distortion_Coefficients", "D", "d")
_PAIR_OF_OPENCV = {"M1", "D1", "M2", "D2"}
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_COLMAP = {
    # Where fx, fy, cx, cy and the distortion (k1, k2, p1, p2 and perhaps k3 to k6; of a fisheye k1 to k4)
    # stand among the parameters; None is 0.
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
    "OPENCV_FISHEYE": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "SIMPLE_RADIAL_FISHEYE": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL_FISHEYE": ((0, 0, 1, 2), (3, 4, None, None)),
}


def in_own_words(path: Path, data: dict[str, Any]) -> Own:
    """The mapping that our own file would hold; ``data`` itself where it is one.

    Raises:
        DataError: a model of camera or lens that is not known here, or a missing entry.
    """
    if "cam0" in data:
        return _kalibr(path, data)
    if _PAIR_OF_OPENCV.issubset(data):
        raise DataError(
            f"{path}: holds the lenses of a pair ({', '.join(sorted(_PAIR_OF_OPENCV))}) but not how the "
            "cameras stand to each other: write both into one file of our own (docs/recorded-images.md), "
            "with right.T_left_right the inverse of OpenCV's R, T"
        )
    if any(key in data for key in _MATRIX) and "camera" not in data:
        return _matrices(path, data)
    return data


def colmap(path: Path) -> Own:
    """The camera of COLMAP's ``cameras.txt``.

    Raises:
        DataError: no camera, several different ones, or a model that is not known here.
    """
    rows = text_rows(path, 5)
    if not rows:
        raise DataError(f"{path}: names no camera (ID MODEL WIDTH HEIGHT PARAMETERS)")
    where, fields = rows[0]
    if any(other[1:] != fields[1:] for _, other in rows):
        raise DataError(
            f"{path}: {len(rows)} cameras that differ; keep the line of the one that took these images"
        )
    model = fields[1]
    if model not in _COLMAP:
        raise DataError(f"{where}: camera model {model!r}; one of {', '.join(_COLMAP)} is needed")
    values = numbers(where, fields[2:])
    (width, height), parameters = values[:2], values[2:]
    at, lens = _COLMAP[model]
    if len(parameters) <= max([*at, *(i for i in lens if i is not None)]):
        raise DataError(f"{where}: {model} with {len(parameters)} parameters; there are some missing")
    # COLMAP's pixel (0, 0) is the corner of the first pixel, ours its centre.
    fx, fy, cx, cy = (parameters[i] for i in at)
    own: Own = {"camera": "mono", "image_size": [width, height]}
    own["intrinsics"] = [fx, fy, cx - 0.5, cy - 0.5]
    if lens:
        own["distortion"] = [0.0 if i is None else parameters[i] for i in lens]
    if model.endswith("FISHEYE"):
        own["lens"] = "equidistant"
    return own


def _kalibr(path: Path, data: dict[str, Any]) -> Own:
    own: Own = {"camera": "stereo" if "cam1" in data else "mono"}
    left = _kalibr_camera(path, data, "cam0")
    own["image_size"] = numbers_of(path, data, "cam0.resolution", 2)
    own |= left
    if "T_cam_imu" in data["cam0"]:
        own["T_body_camera"] = inverse(rigid_of(path, data, "cam0.T_cam_imu")).tolist()
    if "cam1" in data:
        right = _kalibr_camera(path, data, "cam1")
        sizes = [numbers_of(path, data, f"{name}.resolution", 2) for name in ("cam0", "cam1")]
        if sizes[0] != sizes[1]:
            raise DataError(f"{path}: cam0 has {sizes[0]} pixels and cam1 {sizes[1]}; one size is needed")
        own["right"] = {**right, "T_left_right": inverse(rigid_of(path, data, "cam1.T_cn_cnm1")).tolist()}
    return own


def _kalibr_camera(path: Path, data: dict[str, Any], name: str) -> Own:
    model = value_of(path, data, f"{name}.camera_model")
    if model != "pinhole":
        raise DataError(f"{path}: {name}.camera_model is {model!r}; pinhole is needed")
    own: Own = {"intrinsics": numbers_of(path, data, f"{name}.intrinsics", 4)}
    lens = value_of(path, data, f"{name}.distortion_model")
    if lens != "none":
        own["lens"] = _lens(path, f"{name}.distortion_model", lens)
        own["distortion"] = numbers_of(path, data, f"{name}.distortion_coeffs", 4)
    return own


def _matrices(path: Path, data: dict[str, Any]) -> Own:
    def found(names: tuple[str, ...], what: str) -> str:
        for name in names:
            if name in data:
                return name
        raise DataError(f"{path}: has no {what} ({', '.join(names)})")

    def values(name: str, *counts: int) -> list[float]:
        inner = f"{name}.data" if isinstance(data[name], dict) else name
        return numbers_of(path, data, inner, *counts)

    K = np.array(values(found(_MATRIX, "camera matrix"), 9)).reshape(3, 3)
    width, height = (values(found(names, "image size"), 1)[0] for names in (_WIDTH, _HEIGHT))
    own: Own = {"camera": "mono", "image_size": [int(width), int(height)]}
    own["intrinsics"] = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    if any(name in data for name in _DISTORTION):
        # None at all: an image without distortion, as camera_info says it.
        distortion = values(found(_DISTORTION, "distortion"), 0, 4, 5, 8)
        own |= {"distortion": distortion} if distortion else {}
    if data.get("distortion_model"):
        own["lens"] = _lens(path, "distortion_model", data["distortion_model"])
    elif data.get("fisheye_model"):
        own["lens"] = "equidistant"
    return own


def _lens(path: Path, key: str, name: Any) -> str:
    if not isinstance(name, str) or name not in _LENSES:
        raise DataError(f"{path}: {key} is {name!r}; one of {', '.join(_LENSES)} is needed")
    return _LENSES[name]
