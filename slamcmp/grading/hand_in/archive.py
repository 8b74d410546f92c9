"""Read a zip without writing anything of it, and refuse what zips are misused for."""

from __future__ import annotations

import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from slamcmp.grading.hand_in.hand_in import (
    FILE_BYTES,
    FILES_MAX,
    TOTAL_BYTES,
    Collector,
    SubmissionError,
    check_path,
    shown,
    size,
)
from slamcmp.support.messages import told

_ENTRIES_MAX = 20 * FILES_MAX
"""Counts junk as well, which a whole project folder has a lot of."""
_DEVICES = (stat.S_IFLNK, stat.S_IFIFO, stat.S_IFSOCK, stat.S_IFCHR, stat.S_IFBLK)
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_zip(path: Path) -> Collector:
    """The files of an archive by their paths; one folder around everything is taken off.

    Raises:
        SubmissionError: no zip, encrypted, damaged, too large unpacked, links or devices in it, or names
            that lead outside.
    """
    try:
        if path.stat().st_size > TOTAL_BYTES:
            raise SubmissionError(f"{path.name}: is larger than {size(TOTAL_BYTES)}")
        with zipfile.ZipFile(path) as archive:
            return _unpack(archive, path.name)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        # zipfile repeats names as long as a damaged file has them.
        raise SubmissionError(f"{path.name}: is no readable zip ({told(str(error), 300)})") from error
    except OSError as error:
        raise SubmissionError(f"{path.name}: cannot be read ({error})") from error


def _unpack(archive: zipfile.ZipFile, name: str) -> Collector:
    entries = archive.infolist()
    if len(entries) > _ENTRIES_MAX:
        raise SubmissionError(f"{name}: has {len(entries)} entries; {FILES_MAX} files are allowed")
    wanted = []
    collector = Collector()
    for entry in entries:
        # The original name: zipfile cuts it at a NUL, so that two readers would see two names.
        check_path(entry.orig_filename.rstrip("/") if entry.orig_filename != "/" else "/")
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if kind in _DEVICES:
            raise SubmissionError(
                f"{name}: {shown(entry.filename)} is a link or a device; only files, please"
            )
        if Collector.is_junk(entry.filename):
            collector.leave_out(entry.filename)
            continue
        if entry.is_dir():
            continue
        if entry.flag_bits & 0x1:
            raise SubmissionError(f"{name}: is encrypted; hand in an open one")
        if entry.compress_type not in _METHODS:
            raise SubmissionError(f"{name}: {shown(entry.filename)} is compressed in an unusual way")
        wanted.append(entry)
    if sum(entry.file_size for entry in wanted) > TOTAL_BYTES:
        raise SubmissionError(f"{name}: is larger than {size(TOTAL_BYTES)} when unpacked")
    inner = _common_folder([entry.filename for entry in wanted])
    for entry in wanted:
        with archive.open(entry) as file:
            # The size in the directory is a claim: never read past the cap.
            content = file.read(FILE_BYTES + 1)
        collector.add(entry.filename[len(inner) :], content)
    return collector.checked(name)


def _common_folder(names: list[str]) -> str:
    tops = {PurePosixPath(name).parts[0] for name in names}
    nested = all("/" in name for name in names)
    return f"{tops.pop()}/" if len(tops) == 1 and nested else ""
