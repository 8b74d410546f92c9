"""A data set onto this machine: download it, or take a mirror's files; unpack; see that it is whole.

A folder stands under its own name only when all of it is there: it is unpacked beside and renamed.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slamcmp.datasets.fetching.data_set import Archive, DataSet
from slamcmp.datasets.fetching.download import SCHEMES, Limits, Progress, UnreachableError, download
from slamcmp.datasets.fetching.unpack import unpack
from slamcmp.datasets.fetching.verify import sha256_of, write_receipt
from slamcmp.errors import DataError, MissingDataError, StorageError, UsageError
from slamcmp.support.files.paths import is_dir, is_file

DOWNLOADS = ".downloads"
"""Below the root: archives on their way."""


@dataclass(frozen=True)
class Fetched:
    """Where a set lies now."""

    folder: Path
    new: bool
    """False: it was there before."""


def fetch(
    data_set: DataSet,
    root: Path,
    *,
    origin: str | None = None,
    tell: Callable[[str], None] = print,
    progress: Progress | None = None,
    limits: Limits | None = None,
) -> Fetched:
    """The set in its folder below ``root``.

    ``origin`` is a mirror: an address below which the archives lie, or a folder with the archives, or with
    the set itself as its archive unpacks.

    Raises:
        MissingDataError: it cannot be had from here; the message says what to download from where.
        DataError: a wrong checksum, a damaged or hostile archive, or one of another set.
        StorageError: the disk is full, or the folder cannot be written.
        UsageError: a mirror that is neither folder nor address, or a folder in the way.
    """
    found = data_set.find(root)
    if found is not None:
        return Fetched(found, new=False)
    if data_set.in_wheel:
        raise MissingDataError(
            f"{data_set.name}: comes with gtsam's wheel, which is not installed: pip install gtsam"
        )
    target = root / data_set.folder
    if target.exists():
        lacking = data_set.missing(target) if is_dir(target) else ["a folder"]
        raise UsageError(
            f"{data_set.name}: {target} is there and lacks {lacking[0]}; move it away, or name another root "
            "with --to"
        )
    mirror = _mirror_folder(origin)
    if mirror is None and origin is None and not data_set.archives:
        raise MissingDataError(f"{data_set.name}: {what_to_do(data_set)}")
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=root, prefix=".unpacking-") as staged:
            staging = Path(staged)
            ready = None if mirror is None else data_set.locate(mirror)
            if ready is not None:
                tell(f"{data_set.name}: copying {ready}")
                shutil.copytree(ready, staging / "copy")
                archives: list[Path] = []
            else:
                archives = _archives(data_set, root, mirror, origin, tell, progress, limits)
                for archive in archives:
                    tell(f"{data_set.name}: unpacking {archive.name}")
                    unpack(archive, staging)
            _put_in_place(data_set, staging, target, archives)
        write_receipt(data_set, root, target)
    except DataError:
        # What is another thing (a login page) is not taken for the archive next time.
        shutil.rmtree(root / DOWNLOADS / data_set.name, ignore_errors=True)
        raise
    except OSError as error:
        raise StorageError(
            f"{data_set.name}: cannot write below {root}: {error.strerror or error}"
        ) from error
    shutil.rmtree(root / DOWNLOADS / data_set.name, ignore_errors=True)
    return Fetched(target, new=True)


def what_to_do(data_set: DataSet) -> str:
    """What a person downloads from where, in one line."""
    if data_set.archives:
        what = (
            f"download {', '.join(archive.url for archive in data_set.archives)} (about it: {data_set.page})"
        )
    else:
        what = data_set.how or f"download it from {data_set.page}"
    return f"{what} into a folder, then: slamcmp data fetch {data_set.name} --from FOLDER"


def _mirror_folder(origin: str | None) -> Path | None:
    """The folder that ``--from`` names; None where it is an address.

    Raises:
        MissingDataError: there is no such folder.
        UsageError: an address of another kind.
    """
    if origin is None:
        return None
    scheme, separator, _ = origin.partition("://")
    if separator:
        if scheme not in SCHEMES:
            raise UsageError(f"--from {origin}: a folder, or an address of {', '.join(SCHEMES)}")
        return None
    folder = Path(origin).expanduser()
    if not is_dir(folder):
        raise MissingDataError(f"--from {origin}: there is no such folder")
    return folder


def _archives(
    data_set: DataSet,
    root: Path,
    mirror: Path | None,
    origin: str | None,
    tell: Callable[[str], None],
    progress: Progress | None,
    limits: Limits | None,
) -> list[Path]:
    """Each archive as a file, checked where its checksum is known."""
    if mirror is not None:
        return [_of_mirror(data_set, archive, mirror) for archive in data_set.archives] or _nothing_in(
            data_set, mirror
        )
    if not data_set.archives:
        raise MissingDataError(f"{data_set.name}: {what_to_do(data_set)}")
    files = []
    for archive in data_set.archives:
        url = archive.url if origin is None else f"{origin.rstrip('/')}/{archive.file_name}"
        tell(f"{data_set.name}: downloading {url}")
        try:
            files.append(
                download(
                    url,
                    root / DOWNLOADS / data_set.name,
                    archive.file_name,
                    sha256=archive.sha256,
                    progress=progress,
                    limits=limits,
                )
            )
        except UnreachableError as error:
            raise MissingDataError(
                f"{data_set.name}: {error}; where there is a connection, {what_to_do(data_set)}"
            ) from error
    return files


def _of_mirror(data_set: DataSet, archive: Archive, mirror: Path) -> Path:
    path = mirror / archive.file_name
    if not is_file(path):
        _nothing_in(data_set, mirror)
    if archive.sha256 is not None and sha256_of(path) != archive.sha256:
        raise DataError(
            f"{path}: does not have the checksum {archive.sha256} (sha256): a damaged or another file"
        )
    return path


def _nothing_in(data_set: DataSet, mirror: Path) -> list[Path]:
    names = " and ".join(archive.file_name for archive in data_set.archives)
    either = f"{names}, or a" if names else "a"
    raise MissingDataError(
        f"{data_set.name}: {mirror} holds neither {names or 'its files'} nor a folder with "
        f"{', '.join(data_set.required[:3])}; needed is {either} folder in the layout of {data_set.page}"
    )


def _put_in_place(data_set: DataSet, staging: Path, target: Path, archives: list[Path]) -> None:
    ready = data_set.locate(staging)
    if ready is None:
        which = ", ".join(archive.name for archive in archives)
        raise DataError(
            f"{data_set.name}: {which} unpacks to no folder with all of {', '.join(data_set.required)}; is "
            f"it "
            "this set's archive?"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(ready, target)
