"""What a JPEG's own bytes say: whether the picture is whole, and which way up the camera held it."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

START = b"\xff\xd8"
_SCAN, _END, _APP1 = 0xDA, 0xD9, 0xE1
_ALONE = {0x01, *range(0xD0, 0xD9)}
"""Markers without a length: TEM, the restarts and the start itself."""
_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""Among the frames' markers: tables, and what is reserved."""
_NEXT = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
"""The first marker after coded data: there, FF is followed by 00, by another FF or by a restart."""
_ORIENTATION = 0x0112
_TIFF = (b"II*\0", b"MM\0*")
_COMPLAINTS = re.compile(
    rb"Corrupt JPEG|Premature end of JPEG|Invalid JPEG|bad Huffman code|Unsupported marker|TIFF_Error"
)


def is_whole(data: bytes) -> bool:
    """Whether the picture's segments lead up to its end marker; what phones append after it does not matter.

    Motion photos carry a film behind the picture, whose bytes may look like any marker.
    """
    at, scanned = 2, False
    while at + 4 <= len(data) or data[at : at + 2] == b"\xff\xd9":
        if data[at] != 0xFF:
            return False
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        if marker == _END:
            return scanned
        if marker in _ALONE:
            at += 2
            continue
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
        if marker == _SCAN:
            scanned = True
            found = _NEXT.search(data, at)
            if found is None:
                return False
            at = found.start()
    return False


def size(data: bytes) -> tuple[int, int]:
    """(width, height) that the frame's header promises; (0, 0) where there is none."""
    at = 2
    while data.startswith(START) and at + 9 <= len(data) and data[at] == 0xFF and data[at + 1] != _SCAN:
        marker = data[at + 1]
        if marker in _ALONE or marker == 0xFF:
            at += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            return int.from_bytes(data[at + 7 : at + 9]), int.from_bytes(data[at + 5 : at + 7])
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    return 0, 0


def orientation(data: bytes) -> int:
    """EXIF's number for how the picture is to be turned for the eye: 1 is as stored, 6 a quarter right."""
    at = 2
    while data.startswith(START) and at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _SCAN:
        length = int.from_bytes(data[at + 2 : at + 4])
        body = data[at + 4 : at + 2 + length]
        if data[at + 1] == _APP1 and body.startswith(b"Exif\0\0"):
            return _from_tiff(body[6:])
        at += 2 + length
    return 1


def _from_tiff(tiff: bytes) -> int:
    order = "little" if tiff[:2] == b"II" else "big"

    def number(at: int, size: int) -> int:
        return int.from_bytes(tiff[at : at + size], order)  # type: ignore[arg-type]

    first = number(4, 4)
    for entry in range(number(first, 2)):
        at = first + 2 + 12 * entry
        if number(at, 2) == _ORIENTATION:
            value = number(at + 8, 2)
            return value if 1 <= value <= 8 else 1
    return 1


@contextmanager
def decoder_complaints(data: bytes) -> Iterator[list[str]]:
    """What libjpeg, or OpenCV for libtiff, writes to the standard error while it decodes ``data``.

    They fill up damaged data with grey and go on; of other formats nothing is told. Anything else that was
    written there is passed on.
    """
    complaints: list[str] = []
    if not data.startswith((START, *_TIFF)):
        yield complaints
        return
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield complaints
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            for line in file.read().splitlines(keepends=True):
                if _COMPLAINTS.search(line):
                    complaints.append(line.decode(errors="replace").strip())
                else:
                    os.write(2, line)
