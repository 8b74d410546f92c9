"""Read images and say what is wrong with those that cannot be used.

OpenCV is loaded with the first image: what has no images does without it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp import jpeg, png
from slamcmp.errors import DataError, MissingDataError

GrayImage = NDArray[np.uint8]
DepthImage = NDArray[np.float32]
Size = tuple[int, int]

_FLAT_SIGMA = 1.0
"""Grey levels; below this standard deviation an image holds nothing but sensor noise."""
SIDE_MIN_PX = 47
"""A smaller image has no place for a descriptor's patch and a corner's neighbours."""
PIXELS_MAX = 40_000_000
"""Corners need some sixty bytes a pixel."""


class UnusableImageError(DataError):
    """An image file that is no use; ``phrase`` says why without the file's name, to count such files by."""

    def __init__(self, path: Path, phrase: str, detail: str = "") -> None:
        super().__init__(f"{path}: {phrase}{detail}")
        self.phrase = phrase


def read_image(path: Path | str, *, size: Size | None = None) -> GrayImage:
    """Read a photograph as 8-bit grey values, (height, width); colour is converted.

    Args:
        path: any format that OpenCV reads.
        size: (width, height) in pixels that the calibration is for; None takes any.

    Raises:
        MissingDataError: there is no such file.
        UnusableImageError: not an image, truncated, too small for features, not 8 bits a channel, or of
            another size.
    """
    import cv2

    path = Path(path)
    image = _decoded(path)
    if image.dtype != np.uint8:
        raise UnusableImageError(
            path,
            f"{8 * image.dtype.itemsize} bits a channel where 8 are needed",
            "; is it a depth image? Else convert it with the range of values that matters",
        )
    if image.ndim == 3:
        channels = image.shape[2]
        if channels == 1:
            image = image[:, :, 0]
        else:
            image = cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY if channels == 4 else cv2.COLOR_BGR2GRAY)
    grey = np.ascontiguousarray(image, dtype=np.uint8)
    problem = _shape_problem(grey, size) or _too_small(grey)
    if problem:
        raise UnusableImageError(path, problem)
    return grey


def read_depth(
    path: Path | str, *, units_per_m: float, unknown: int | None = None, size: Size | None = None
) -> DepthImage:
    """Read a 16-bit depth image as metres along the optical axis, (height, width); 0 where not known.

    Args:
        path: a PNG with one channel, as RGB-D cameras' files are.
        units_per_m: value of a pixel one metre away: 1000 for millimetres.
        unknown: a value that marks pixels without depth, beside 0.
        size: (width, height) in pixels that the calibration is for; None takes any.

    Raises:
        MissingDataError: there is no such file.
        UnusableImageError: not an image, truncated, not one channel of 16 bits, or of another size.
    """
    path = Path(path)
    image = _decoded(path)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise UnusableImageError(
            path,
            f"{channels} channel(s) of {8 * image.dtype.itemsize} bits where a depth image has one of 16",
        )
    problem = _shape_problem(image, size)
    if problem:
        raise UnusableImageError(path, problem)
    known = image if unknown is None else np.where(image == unknown, 0, image)
    return (known * np.float32(1.0 / units_per_m)).astype(np.float32)


def usable_image(path: Path, *, size: Size | None = None) -> tuple[GrayImage | None, str]:
    """The image and "", or None and why there is none in one phrase; never an error."""
    try:
        image = read_image(path, size=size)
    except MissingDataError:
        return None, "the file is missing"
    except UnusableImageError as error:
        return None, error.phrase
    problem = image_problem(image)
    return (None, problem) if problem else (image, "")


def usable_depth(
    path: Path, *, units_per_m: float, unknown: int | None = None, size: Size | None = None
) -> tuple[DepthImage | None, str]:
    """The depth image [m] and "", or None and why there is none in one phrase; never an error."""
    try:
        depth = read_depth(path, units_per_m=units_per_m, unknown=unknown, size=size)
    except MissingDataError:
        return None, "the file is missing"
    except UnusableImageError as error:
        return None, error.phrase
    return (depth, "") if depth.any() else (None, "no pixel has a depth")


def image_problem(image: object, *, size: Size | None = None) -> str:
    """Why features cannot be taken from ``image``, in one phrase for a count; empty if they can.

    A sequence skips such a frame and counts the phrase: a camera that was covered is no reason to stop.
    """
    if not isinstance(image, np.ndarray) or image.size == 0:
        return "no image"
    if image.dtype != np.uint8:
        return f"{8 * image.dtype.itemsize} bits a channel where 8 are needed"
    if image.ndim != 2:
        return "colour where grey values are needed"
    problem = _shape_problem(image, size)
    if problem:
        return problem
    problem = _too_small(image)
    if problem:
        return problem
    import cv2

    # A fifth of the time that numpy takes, which converts every pixel to a float first.
    mean, sigma = (float(value[0, 0]) for value in cv2.meanStdDev(image))
    if sigma < _FLAT_SIGMA:
        return "all black" if mean < 8 else "no contrast"
    return ""


def _decoded(path: Path) -> NDArray[Any]:
    import cv2

    try:
        data = path.read_bytes()
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise MissingDataError(f"{path}: there is no such image") from None
    except OSError as error:
        raise MissingDataError(f"{path}: cannot be read ({error.strerror})") from error
    if _is_truncated(data):
        raise UnusableImageError(path, "the image file is truncated", f" ({len(data)} bytes, no end marker)")
    # Before it is decoded: a file of a megabyte may promise gigabytes.
    for promised in (jpeg.size(data), png.size(data)):
        _require_reasonable(path, promised)
    with jpeg.decoder_complaints(data) as complaints:
        try:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if data else None
        except cv2.error:
            image = None
    if complaints:
        raise UnusableImageError(path, "the image file is damaged", f" ({complaints[0]})")
    if image is None:
        raise UnusableImageError(
            path, "not an image that can be decoded, or damaged", f" ({len(data)} bytes)"
        )
    _require_reasonable(path, (image.shape[1], image.shape[0]))
    return np.asarray(image)


def _require_reasonable(path: Path, size: Size) -> None:
    if size[0] * size[1] > PIXELS_MAX:
        phrase = f"{size[0]}×{size[1]} pixels are more than {PIXELS_MAX // 10**6} megapixels"
        raise UnusableImageError(path, phrase, "; make it smaller first")


def _shape_problem(image: NDArray[Any], size: Size | None) -> str:
    height, width = image.shape
    if size is not None and (width, height) != size:
        return f"{width}×{height} pixels where {size[0]}×{size[1]} are needed"
    return ""


def _too_small(image: NDArray[Any]) -> str:
    height, width = image.shape
    if min(height, width) >= SIDE_MIN_PX:
        return ""
    return f"{width}×{height} pixels where at least {SIDE_MIN_PX} a side are needed"


def _is_truncated(data: bytes) -> bool:
    """Whether a JPEG or PNG stops before its end marker: some OpenCV versions then fill up with grey."""
    if data.startswith(jpeg.START):
        return not jpeg.is_whole(data)
    if data.startswith(png.START[:4]):
        return not png.is_whole(data)
    return False
