"""What is known of a published data set, and where it lies on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from slamcmp.datasets.folders import DATA_VARIABLE
from slamcmp.datasets.wheel import wheel_folder
from slamcmp.support.files.paths import is_dir

NOT_KNOWN = "not known to slamcmp"
"""Said of a size or a checksum instead of a guess."""
_DEPTH = 4
"""Folders that a set may lie below the root of its archive."""


@dataclass(frozen=True)
class Archive:
    """One file at its official address."""

    url: str
    sha256: str | None = None
    """None: not known."""
    size: int | None = None
    """In bytes; None: not known."""
    called: str = ""
    """Its file's name, where the address does not end in it."""

    @property
    def file_name(self) -> str:
        """What the downloaded file is called."""
        return self.called or urlsplit(self.url).path.rsplit("/", 1)[-1]


@dataclass(frozen=True)
class DataSet:
    """A published data set: an entry of the catalogue."""

    name: str
    title: str
    licence: str
    """Its terms in a sentence; where none are stated, that."""
    citation: str
    page: str
    """Official address, for people."""
    folder: str
    """Where it belongs below ``SLAMCMP_DATA``; with ``in_wheel``, empty."""
    required: tuple[str, ...]
    """Patterns of files, below the set's folder, without one of which it is not whole."""
    archives: tuple[Archive, ...] = ()
    """None: it cannot be downloaded without a person (a login, a form)."""
    how: str = ""
    """What a person has to download where ``archives`` is empty."""
    size: str = NOT_KNOWN
    use: str = ""
    """The source that reads it, as one writes it in an experiment; empty where there is none."""
    notes: tuple[str, ...] = ()
    in_wheel: dict[str, str] = field(default_factory=dict)
    """File by file the sha256 of what gtsam's wheel carries."""

    def find(self, root: Path | None) -> Path | None:
        """Its folder below ``root`` (or root itself, as an archive unpacks there), or in the wheel."""
        if self.in_wheel:
            folder = wheel_folder()
            return folder if folder is not None and self.is_whole(folder) else None
        if root is None:
            return None
        own = Path(self.folder)
        for candidate in (root / own, root / own.name):
            if self.is_whole(candidate):
                return candidate
        return None

    def is_whole(self, folder: Path) -> bool:
        """Whether the folder has all that is required."""
        return is_dir(folder) and not self.missing(folder)

    def missing(self, folder: Path) -> list[str]:
        """The patterns that no file in the folder fits."""
        return [pattern for pattern in self.required if next(folder.glob(pattern), None) is None]

    def locate(self, folder: Path) -> Path | None:
        """The folder in the archive's layout at or below ``folder``, the nearest first."""
        return next((each for each in _below(folder, _DEPTH) if self.is_whole(each)), None)


def _below(folder: Path, depth: int) -> Iterator[Path]:
    level = [folder]
    for _ in range(depth + 1):
        yield from level
        level = [
            child
            for each in level
            for child in sorted(each.iterdir())
            if child.is_dir() and not child.is_symlink() and not child.name.startswith(".")
        ]


def data_root() -> Path | None:
    """The folder that ``SLAMCMP_DATA`` names; None where it names none."""
    named = os.environ.get(DATA_VARIABLE)
    return Path(named).expanduser() if named else None
