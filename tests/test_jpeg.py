"""What a JPEG's bytes say: whole or not, whatever stands behind it; damaged; which way up."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp import jpeg
from slamcmp.errors import DataError
from slamcmp.image_files import image_problem, read_image
from tests.frontend.photographs import FOLDER

PHOTOGRAPH = (FOLDER / "BalbianelloMedium-1.jpg").read_bytes()


def film(seed: int = 0, size: int = 40_000) -> bytes:
    """Bytes that hold every marker, as a motion photo's film does behind the picture."""
    noise = bytearray(np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8).tobytes())
    noise[100:104] = b"\xff\xda\xff\xd8"
    return bytes(noise)


@pytest.mark.parametrize("behind", [b"", b"\0" * 10, film(0), film(1), PHOTOGRAPH[:5000]])
def test_bytes_behind_the_picture_do_not_matter(tmp_path: Path, behind: bytes) -> None:
    path = tmp_path / "motion.jpg"
    path.write_bytes(PHOTOGRAPH + behind)
    np.testing.assert_array_equal(read_image(path), read_image(FOLDER / "BalbianelloMedium-1.jpg"))


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9, 0.9999])
def test_a_picture_that_stops_early_is_truncated(share: float) -> None:
    assert jpeg.is_whole(PHOTOGRAPH)
    assert not jpeg.is_whole(PHOTOGRAPH[: int(share * len(PHOTOGRAPH))])


@pytest.mark.parametrize("progressive", [0, 1])
def test_restarts_and_several_scans_are_one_picture(progressive: int) -> None:
    image = np.random.default_rng(2).integers(0, 256, (120, 160), dtype=np.uint8)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, 4]
    data = cv2.imencode(".jpg", image, options)[1].tobytes()
    assert jpeg.is_whole(data)
    assert not jpeg.is_whole(data[:-2])


def test_damage_between_intact_ends_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    refused = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        data = bytearray(PHOTOGRAPH)
        at = int(rng.integers(len(data) // 3, 2 * len(data) // 3))
        data[at : at + 400] = rng.integers(0, 256, 400, dtype=np.uint8).tobytes()
        path = tmp_path / f"{seed}.jpg"
        path.write_bytes(bytes(data))
        try:
            read_image(path)
        except DataError:
            refused += 1
    assert refused >= 7
    with pytest.raises(DataError, match=r"7\.jpg: the image file is (damaged|truncated)"):
        read_image(path)
    assert "Corrupt" not in capfd.readouterr().err


def test_other_words_on_the_standard_error_are_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    import os

    with jpeg.decoder_complaints(jpeg.START) as complaints:
        os.write(2, b"Corrupt JPEG data: premature end\nsomething else\n")
    assert complaints == ["Corrupt JPEG data: premature end"]
    assert capfd.readouterr().err == "something else\n"


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("number", [1, 3, 6, 8])
def test_the_orientation_is_read_from_exif(order: str, number: int) -> None:
    def of(value: int, size: int) -> bytes:
        return value.to_bytes(size, order)  # type: ignore[arg-type]

    entry = of(0x0112, 2) + of(3, 2) + of(1, 4) + of(number, 2) + b"\0\0"
    tiff = (b"II" if order == "little" else b"MM") + of(42, 2) + of(8, 4) + of(1, 2) + entry + of(0, 4)
    body = b"Exif\0\0" + tiff
    data = PHOTOGRAPH[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2) + body + PHOTOGRAPH[2:]
    assert jpeg.orientation(data) == number
    assert jpeg.is_whole(data)
    assert jpeg.orientation(PHOTOGRAPH) == 1


def test_images_too_small_or_too_large_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    assert "40×60 pixels where at least 47" in image_problem(rng.integers(0, 256, (60, 40), dtype=np.uint8))
    assert image_problem(rng.integers(0, 256, (47, 47), dtype=np.uint8)) == ""
    for width, height in ((1, 1), (640, 46)):
        tiny = tmp_path / f"{height}.png"
        assert cv2.imwrite(str(tiny), rng.integers(0, 256, (height, width), dtype=np.uint8))
        with pytest.raises(DataError, match=f"{width}×{height} pixels where at least 47 a side are needed"):
            read_image(tiny)
    huge = tmp_path / "huge.png"
    assert cv2.imwrite(str(huge), np.zeros((7000, 6000), np.uint8))
    with pytest.raises(DataError, match=r"6000×7000 pixels are more than 40 megapixels; make it smaller"):
        read_image(huge)
