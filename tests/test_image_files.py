"""Bad images: one clear error, or one phrase to count the skipped frame by."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp.errors import DataError, MissingDataError
from slamcmp.image_files import image_problem, read_depth, read_image
from tests.frontend.photographs import FOLDER, photograph


def _write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def test_grey_values_survive_a_file(tmp_path: Path) -> None:
    image = photograph(1)
    np.testing.assert_array_equal(read_image(_write(tmp_path / "grey.png", image), size=(640, 427)), image)


def test_colour_becomes_grey_with_the_usual_weights(tmp_path: Path) -> None:
    blue_green_red = np.zeros((50, 60, 3), dtype=np.uint8)
    blue_green_red[:] = 40, 120, 200
    grey = read_image(_write(tmp_path / "colour.png", blue_green_red))
    # ITU-R 601: 0.114 · 40 + 0.587 · 120 + 0.299 · 200 = 134.8.
    assert (grey == 135).all()
    with_alpha = np.dstack([blue_green_red, np.full((50, 60), 77, np.uint8)])
    assert (read_image(_write(tmp_path / "alpha.png", with_alpha)) == 135).all()


def test_a_missing_file_is_missing_data(tmp_path: Path) -> None:
    with pytest.raises(MissingDataError, match=r"absent\.png: there is no such image"):
        read_image(tmp_path / "absent.png")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.99, 0.5, 0.02])
def test_a_truncated_file_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    data = _write(tmp_path / f"whole{suffix}", photograph(1)).read_bytes()
    part = tmp_path / f"part{suffix}"
    part.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataError, match="truncated"):
        read_image(part)


@pytest.mark.parametrize("content", [b"", b"not an image at all", b"BM\x00\x00"])
def test_what_is_no_image_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "image.bmp"
    path.write_bytes(content)
    with pytest.raises(DataError, match="not an image"):
        read_image(path)


def test_sixteen_bits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="16 bits a channel where 8 are needed"):
        read_image(_write(tmp_path / "depth.png", np.full((20, 30), 5000, dtype=np.uint16)))


def test_another_size_than_the_calibrations_is_refused() -> None:
    with pytest.raises(DataError, match="640×427 pixels where 640×480 are needed"):
        read_image(FOLDER / "BalbianelloMedium-1.jpg", size=(640, 480))


@pytest.mark.parametrize(
    ("image", "problem"),
    [
        (photograph(1), ""),
        (None, "no image"),
        (np.empty((0, 0), np.uint8), "no image"),
        (np.zeros((427, 640), np.uint8), "all black"),
        (np.full((427, 640), 140, np.uint8), "no contrast"),
        (np.zeros((427, 640, 3), np.uint8), "colour where grey values are needed"),
        (np.zeros((427, 640), np.uint16), "16 bits a channel where 8 are needed"),
        (np.zeros((10, 20), np.uint8), "20×10 pixels where 640×427 are needed"),
    ],
)
def test_the_reason_to_skip_a_frame(image: object, problem: str) -> None:
    assert image_problem(image, size=(640, 427)) == problem


def test_depth_becomes_metres_and_what_is_unknown_becomes_zero(tmp_path: Path) -> None:
    stored = np.array([[0, 5000, 12500], [65535, 1, 40000]], dtype=np.uint16)
    path = _write(tmp_path / "depth.png", stored)
    np.testing.assert_allclose(
        read_depth(path, units_per_m=5000, unknown=65535, size=(3, 2)),
        [[0, 1.0, 2.5], [0, 0.0002, 8.0]],
        rtol=1e-6,
    )
    assert read_depth(path, units_per_m=1000)[1, 0] == pytest.approx(65.535)


def test_grey_values_are_no_depth(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"1 channel\(s\) of 8 bits where a depth image has one of 16"):
        read_depth(_write(tmp_path / "grey.png", photograph(1)), units_per_m=1000)
    path = _write(tmp_path / "depth.png", np.full((20, 30), 5000, dtype=np.uint16))
    with pytest.raises(DataError, match="30×20 pixels where 31×20"):
        read_depth(path, units_per_m=1000, size=(31, 20))


def test_opencv_is_loaded_with_the_first_image_only() -> None:
    code = "import slamcmp.image_files, sys; sys.exit('cv2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
