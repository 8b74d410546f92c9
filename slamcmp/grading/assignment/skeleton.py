"""A small whole assignment to start from: the one that docs/writing-assignments.md explains."""

from __future__ import annotations

import os
import re
from pathlib import Path

from slamcmp.errors import UsageError

FILES = Path(__file__).parent / "skeleton_files"
EXAMPLE = "fusion"
"""What the file to hand in is called in the skeleton."""
PLACES = {"solution.py": "solution/solution.py"}
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def write_skeleton(name: str, folder: Path) -> list[Path]:
    """Write a new assignment called ``name`` to ``folder/name``.

    Returns:
        Its files.

    Raises:
        UsageError: the name could not be imported, or the folder is there already.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r}: small letters, digits and _ are needed, as for a module, e.g. wheel_odometry"
        )
    target = folder / name
    if os.path.lexists(target):
        raise UsageError(f"{target} is there already; name another folder")
    written = []
    try:
        for source in sorted(FILES.glob("*.txt")):
            place = source.name.removesuffix(".txt")
            file = target / PLACES.get(place, place)
            file.parent.mkdir(parents=True, exist_ok=True)
            text = re.sub(rf"\b{EXAMPLE}\b", name, source.read_text(encoding="utf-8"))
            file.write_text(text, encoding="utf-8")
            written.append(file)
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from error
    return written
