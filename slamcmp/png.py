"""What a PNG's own bytes say: whether the picture is whole, and its size."""

from __future__ import annotations

START = b"\x89PNG\r\n\x1a\n"


def is_whole(data: bytes) -> bool:
    """Whether the chunks lead up to the end; what stands behind it does not matter."""
    at = len(START)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        at += 12 + length
        if kind == b"IEND":
            return at <= len(data)
    return False


def size(data: bytes) -> tuple[int, int]:
    """(width, height) that the header promises; (0, 0) where there is none."""
    if not data.startswith(START) or data[12:16] != b"IHDR":
        return 0, 0
    return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
