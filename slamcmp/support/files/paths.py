"""Names of files as users write them: whatever a name is, the answer is yes or no.

Python raises for names that are too long, folders that nobody may enter, and home folders of nobody.
"""

from __future__ import annotations

import contextlib
from pathlib import Path


def is_file(path: Path) -> bool:
    """Whether there is a file that can be looked at."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_file()
    return False


def is_dir(path: Path) -> bool:
    """Whether there is a folder that can be looked at."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_dir()
    return False


def expanded(path: str | Path) -> Path:
    """The path with ``~`` and ``~name`` as their home folders, where there are such."""
    with contextlib.suppress(RuntimeError):
        return Path(path).expanduser()
    return Path(path)
