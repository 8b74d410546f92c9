"""The images of a recording, read one at a time, and the check that a calibration is theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from slamcmp.datasets.images.rectification import Remap
from slamcmp.errors import DataError, MissingDataError
from slamcmp.image_files import (
    DepthImage,
    GrayImage,
    Size,
    UnusableImageError,
    read_image,
    usable_depth,
    usable_image,
)
from slamcmp.models.camera import Camera
from slamcmp.support.files.paths import is_file
from slamcmp.types import CameraFrame

_PROBES = 3
"""Images that must agree before a calibration is called wrong: one odd image is only a frame to skip."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one instant."""

    left: Path
    right: Path | None = None
    depth: Path | None = None

    def existing(self) -> list[Path]:
        """Those that are there."""
        return [path for path in (self.left, self.right, self.depth) if path is not None and is_file(path)]


@dataclass(frozen=True)
class DepthFormat:
    """What the numbers in a depth image mean."""

    units_per_m: float
    unknown: int | None = None
    """Marks a pixel without depth, beside 0."""


@dataclass(frozen=True)
class RecordedFrames(Sequence[CameraFrame]):
    """Frame k is read, rectified and judged when it is asked for; a bad file gives a frame without image."""

    files: tuple[FrameFiles, ...]
    size: Size
    """(width, height) that the calibration is for."""
    left_remap: Remap | None = None
    """None where the files are free of distortion already."""
    right_remap: Remap | None = None
    depth_format: DepthFormat | None = None
    depth_remap: Remap | None = None

    def __len__(self) -> int:
        return len(self.files)

    @overload
    def __getitem__(self, k: int) -> CameraFrame: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[CameraFrame]: ...
    def __getitem__(self, k: int | slice) -> CameraFrame | Sequence[CameraFrame]:
        if isinstance(k, slice):
            return replace(self, files=self.files[k])
        files = self.files[k]
        image, problem = usable_image(files.left, size=self.size)
        if image is None:
            return CameraFrame(None, problem=problem)
        right: GrayImage | None = None
        depth: DepthImage | None = None
        if files.right is not None:
            right, problem = usable_image(files.right, size=self.size)
            if right is None:
                return CameraFrame(None, problem=f"right image: {problem}")
        if files.depth is not None and self.depth_format is not None:
            depth, problem = usable_depth(
                files.depth,
                units_per_m=self.depth_format.units_per_m,
                unknown=self.depth_format.unknown,
                size=self.size,
            )
            if depth is None:
                return CameraFrame(None, problem=f"depth image: {problem}")
        return CameraFrame(
            _remapped(image, self.left_remap),
            _remapped(right, self.right_remap),
            # Between a near and a far pixel there is no surface: the nearest value is kept.
            _remapped(depth, self.depth_remap, nearest=True),
        )

    def subset(self, indices: Sequence[int]) -> RecordedFrames:
        """The frames at ``indices``."""
        return replace(self, files=tuple(self.files[k] for k in indices))


def require_size(files: Sequence[FrameFiles], size: Size, calibration: str) -> None:
    """Check the first images that can be read against the size that ``calibration`` (its name) is for.

    Raises:
        DataError: all of them have one other size, or no image can be read.
    """
    sizes = _sizes(files, _PROBES)
    if size not in sizes and len(set(sizes)) == 1:
        width, height = sizes[0]
        raise DataError(
            f"{calibration}: is for images of {size[0]}×{size[1]} pixels, but {files[0].left.parent} has "
            f"{width}×{height}; a calibration of these images is needed"
        )


def first_size(files: Sequence[FrameFiles]) -> Size:
    """(width, height) of the first image that can be read.

    Raises:
        DataError: no image can be read.
    """
    return _sizes(files, 1)[0]


def require_fit(camera: Camera, size: Size, calibration: str) -> None:
    """Check that an image of ``size`` may have been taken with these intrinsics.

    Raises:
        DataError: the principal point is not in the image's middle half, or a focal length is out of reason.
    """
    centre, extent = np.array([camera.cx_px, camera.cy_px]), np.array(size, dtype=float)
    focal = np.array([camera.fx_px, camera.fy_px])
    off_centre = (np.abs(centre - 0.5 * extent) > 0.25 * extent).any()
    # Between 11 and 170 degrees of view.
    if off_centre or (focal > 5.0 * extent.max()).any() or (focal < 0.045 * extent.max()).any():
        raise DataError(
            f"{calibration}: focal lengths {focal[0]:g}, {focal[1]:g} px and principal point ({centre[0]:g}, "
            f"{centre[1]:g}) px do not fit images of {size[0]}×{size[1]} pixels; was the calibration made "
            "at another resolution?"
        )


def _sizes(files: Sequence[FrameFiles], count: int) -> list[Size]:
    sizes: list[Size] = []
    for each in files:
        try:
            height, width = read_image(each.left).shape
        except (MissingDataError, UnusableImageError):
            continue
        sizes.append((width, height))
        if len(sizes) == count:
            break
    if not sizes:
        first = usable_image(files[0].left)[1] if files else "there is none"
        where = files[0].left if files else "no file"
        raise DataError(f"{where}: none of {len(files)} images can be read; of this one: {first}")
    return sizes


def _remapped(image: NDArray[Any] | None, remap: Remap | None, *, nearest: bool = False) -> Any:
    return image if image is None or remap is None else remap.apply(image, nearest=nearest)
