"""Archives into a folder, and never anywhere else.

Names that lead out of the folder (absolute, ``..``, a drive), links and devices are refused before anything
is written: an archive comes from a stranger.
"""

from __future__ import annotations

import lzma
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO

from slamcmp.errors import DataError

_DAMAGE = (
    *(zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError),
    *(EOFError, NotImplementedError, RuntimeError, ValueError),
)


def unpack(archive: Path, folder: Path) -> None:
    """The files of a zip or tar archive below ``folder``; any other file is put there as it is.

    Raises:
        DataError: a member would lie outside of the folder, or is no plain file; or the archive is damaged.
        OSError: the disk is full.
    """
    try:
        if zipfile.is_zipfile(archive):
            with zipfile.ZipFile(archive) as opened:
                _unpack_zip(archive, opened, folder)
        elif _wants_archive(archive):
            with tarfile.open(archive) as opened_tar:
                _unpack_tar(archive, opened_tar, folder)
        else:
            shutil.copyfile(archive, folder / archive.name)
    except _DAMAGE as error:
        # Of a login page in place of the archive as well.
        raise DataError(
            f"{archive}: no archive that can be read ({type(error).__name__}); was it cut off, or "
            f"is it "
            "a web page that asks for a login?"
        ) from error


def _wants_archive(path: Path) -> bool:
    return path.suffix in {".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".txz", ".tbz2"}


def _unpack_zip(archive: Path, opened: zipfile.ZipFile, folder: Path) -> None:
    members = opened.infolist()
    places = [_place(archive, member.filename, folder) for member in members]
    for member in members:
        if (member.external_attr >> 16) & 0o170000 == 0o120000:
            raise DataError(f"{archive}: refused, its member {member.filename!r} is a link")
    for member, place in zip(members, places, strict=True):
        if member.is_dir():
            place.mkdir(parents=True, exist_ok=True)
        else:
            with opened.open(member) as file:
                _write(file, place)


def _unpack_tar(archive: Path, opened: tarfile.TarFile, folder: Path) -> None:
    for member, place in list(_tar_members(archive, opened, folder)):
        if member.isdir():
            place.mkdir(parents=True, exist_ok=True)
        else:
            file = opened.extractfile(member)
            assert file is not None
            with file:
                _write(file, place)


def _tar_members(
    archive: Path, opened: tarfile.TarFile, folder: Path
) -> Iterator[tuple[tarfile.TarInfo, Path]]:
    for member in opened.getmembers():
        place = _place(archive, member.name, folder)
        if not (member.isreg() or member.isdir()):
            raise DataError(f"{archive}: refused, its member {member.name!r} is a link or a device")
        yield member, place


def _place(archive: Path, name: str, folder: Path) -> Path:
    """Where a member belongs.

    Raises:
        DataError: outside of the folder.
    """
    # On Windows a backslash separates too, and C: is a place of its own.
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if ".." in parts or name.startswith(("/", "\\")) or PureWindowsPath(name).drive or "\0" in name:
        raise DataError(f"{archive}: refused, its member {name!r} would lie outside of the folder")
    return folder.joinpath(*parts)


def _write(file: IO[bytes], place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    with place.open("wb") as out:
        shutil.copyfileobj(file, out, 1 << 20)
