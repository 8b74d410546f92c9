"""Keep a log that somebody else writes within bounds: its beginning and its end."""

from __future__ import annotations

from pathlib import Path

LIMIT_BYTES = 1_000_000
KEPT_BYTES = 250_000
"""At each end of a log that has grown too long."""


def trim(path: Path, limit: int = LIMIT_BYTES, kept: int = KEPT_BYTES) -> None:
    """Shorten a file that has grown beyond ``limit`` to ``kept`` bytes at each end.

    Its writer must append; what it writes at this very moment may be lost.
    """
    try:
        size = path.stat().st_size
        if size <= limit:
            return
        with path.open("r+b") as file:
            file.seek(size - kept)
            tail = file.read(kept)
            file.truncate(kept)
        with path.open("ab") as file:
            file.write(b"\n[... output was left out here ...]\n" + tail)
    except OSError:
        # Nobody's result depends on it.
        return
