"""Values from the YAML files that calibrations come in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slamcmp.datasets.text import read_text
from slamcmp.datasets.trajectories import nearest_rotations
from slamcmp.errors import DataError
from slamcmp.geometry import pose
from slamcmp.types import FloatArray


def read_mapping(path: Path) -> dict[str, Any]:
    """The content of a YAML file; OpenCV's first line ``%YAML:1.0``, which is not YAML, may stand there.

    Raises:
        DataError: not YAML, or not a mapping.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        text = read_text(path)
        if text.startswith("%YAML"):
            text = "\n" + text.partition("\n")[2]
        # A printed ROS message ends with the line that would begin the next one.
        text = text.rstrip().removesuffix("\n---")
        loader = YAML(typ="safe", pure=True)
        loader.constructor.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)
        data = loader.load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        # Not only what the library calls its own: a number of 5000 digits, a date of month 13.
        raise DataError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise DataError(f"{path}: not a mapping (key: value)")
    return data


def value_of(path: Path, data: dict[str, Any], key: str) -> Any:
    """The value at ``key``, a dotted path.

    Raises:
        DataError: there is none.
    """
    value: Any = data
    for part in key.split("."):
        if not isinstance(value, dict) or part not in value:
            raise DataError(f"{path}: has no {key}")
        value = value[part]
    return value


def numbers_of(path: Path, data: dict[str, Any], key: str, *counts: int) -> list[float]:
    """The list of finite numbers at ``key``, as long as one of ``counts``; lists of lists are joined.

    Raises:
        DataError: there is no such list.
    """
    value = value_of(path, data, key)
    wanted = " or ".join(map(str, counts))
    try:
        flat = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise DataError(f"{path}: {key} is {value!r}; a list of {wanted} numbers is needed") from None
    if flat.size not in counts or not np.isfinite(flat).all():
        raise DataError(f"{path}: {key} has {flat.size} values; {wanted} finite numbers are needed")
    found: list[float] = flat.tolist()
    return found


def rigid_of(path: Path, data: dict[str, Any], key: str) -> FloatArray:
    """The rigid transform (4, 4) at ``key``, its rotation freed of rounding.

    Raises:
        DataError: it is none; a matrix that was transposed shows in its last row.
    """
    T = np.array(numbers_of(path, data, key, 16)).reshape(4, 4)
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise DataError(
            f"{path}: the last row of {key} is {T[3].tolist()} where 0, 0, 0, 1 is needed; is the matrix "
            "transposed?"
        )
    return pose(nearest_rotations(path, T[:3, :3]), T[:3, 3])


def _opencv_matrix(constructor: Any, node: Any) -> Any:
    """``!!opencv-matrix`` is a mapping with ``rows``, ``cols``, ``dt`` and ``data``."""
    return constructor.construct_mapping(node, deep=True)
