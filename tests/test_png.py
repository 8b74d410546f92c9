"""What a PNG's bytes say: whole or not, whatever stands behind it, and how large; and a damaged TIFF."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp import jpeg, png
from slamcmp.errors import DataError
from slamcmp.image_files import read_image

IMAGE = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
DATA = cv2.imencode(".png", IMAGE)[1].tobytes()


@pytest.mark.parametrize("behind", [b"", bytes(100), DATA, b"IEND" * 50])
def test_bytes_behind_the_picture_do_not_matter(tmp_path: Path, behind: bytes) -> None:
    (tmp_path / "a.png").write_bytes(DATA + behind)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), IMAGE)


@pytest.mark.parametrize("kept", [5, 24, len(DATA) // 2, len(DATA) - 4])
def test_a_picture_that_stops_early_is_truncated(tmp_path: Path, kept: int) -> None:
    (tmp_path / "a.png").write_bytes(DATA[:kept])
    with pytest.raises(DataError, match="the image file is truncated"):
        read_image(tmp_path / "a.png")


def test_damage_between_intact_ends_is_refused(tmp_path: Path) -> None:
    data = bytearray(DATA)
    for at in range(len(data) // 2, len(data) // 2 + 40):
        data[at] ^= 0x5A
    (tmp_path / "a.png").write_bytes(bytes(data))
    with pytest.raises(DataError, match="damaged"):
        read_image(tmp_path / "a.png")


def test_a_damaged_tiff_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    smooth = cv2.GaussianBlur(IMAGE, (0, 0), 3)
    data = bytearray(cv2.imencode(".tiff", smooth)[1].tobytes())
    (tmp_path / "a.tiff").write_bytes(bytes(data))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), smooth)
    for at in range(len(data) // 2, len(data) // 2 + 40):
        data[at] ^= 0x5A
    (tmp_path / "a.tiff").write_bytes(bytes(data))
    with pytest.raises(DataError, match="the image file is damaged"):
        read_image(tmp_path / "a.tiff")
    assert "TIFF_Error" not in capfd.readouterr().err


def chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4) + kind + body + zlib.crc32(kind + body).to_bytes(4)


def test_an_image_that_promises_gigabytes_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = (30_000).to_bytes(4) * 2
    head = chunk(b"IHDR", size + bytes([8, 0, 0, 0, 0]))
    bomb = png.START + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(bomb)
    photograph = cv2.imencode(".jpg", np.zeros((100, 200), np.uint8))[1].tobytes()
    assert jpeg.size(photograph) == (200, 100)
    assert png.size(DATA) == (80, 60)
    start = photograph.index(b"\xff\xc0") + 5
    (tmp_path / "bomb.jpg").write_bytes(
        photograph[:start] + (30_000).to_bytes(2) * 2 + photograph[start + 4 :]
    )

    def never(*_: object) -> None:
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", never)
    for name in ("bomb.png", "bomb.jpg"):
        with pytest.raises(DataError, match="30000×30000 pixels are more than 40 megapixels"):
            read_image(tmp_path / name)
