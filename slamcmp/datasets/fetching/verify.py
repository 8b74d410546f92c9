"""Whether a data set on this machine is whole, and the one that was fetched."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

from slamcmp.datasets.fetching.data_set import DataSet
from slamcmp.errors import MissingDataError
from slamcmp.support.files.atomic import write_atomically

RECEIPTS = ".receipts"
"""Below the root: of each set fetched, the sha256 of its files."""


@dataclass(frozen=True)
class Verdict:
    """What was found of one set."""

    name: str
    folder: Path
    findings: list[str] = field(default_factory=list)
    """What is wrong, each in one line."""
    basis: str = ""
    """What could be compared."""


def verify(data_set: DataSet, root: Path | None) -> Verdict:
    """Compare a set with the checksums that are known, or with those of the day it was fetched.

    Raises:
        MissingDataError: the set is not on this machine.
    """
    folder = data_set.find(root)
    if folder is None:
        whole = root is not None and (root / data_set.folder).is_dir()
        if whole and root is not None and (kept := _receipt(data_set, root)):
            return Verdict(data_set.name, root / data_set.folder, _differences(kept, root / data_set.folder))
        raise MissingDataError(
            f"{data_set.name}: not found{'' if root is None else f' below {root}'}; slamcmp data fetch "
            f"{data_set.name}"
        )
    if data_set.in_wheel:
        return Verdict(
            data_set.name, folder, _differences(data_set.in_wheel, folder), "the checksums slamcmp knows"
        )
    known = None if root is None else _receipt(data_set, root)
    if known is None:
        return Verdict(
            data_set.name,
            folder,
            [],
            f"its layout only, {len(data_set.required)} kinds of files are there: no checksum is known to "
            f"slamcmp, "
            "and it was not fetched by slamcmp",
        )
    return Verdict(
        data_set.name, folder, _differences(known, folder), "the checksums of the day it was fetched"
    )


def write_receipt(data_set: DataSet, root: Path, folder: Path) -> None:
    """Note what was fetched, so that a later change is seen.

    Raises:
        StorageError: the disk is full.
    """
    receipt = {"name": data_set.name, "folder": data_set.folder, "sha256": _sums_below(folder)}
    text = json.dumps(receipt, indent=1).encode()
    write_atomically(root / RECEIPTS / f"{data_set.name}.json", lambda file: file.write(text))


def _sums_below(folder: Path) -> dict[str, str]:
    """Of each file below the folder its sha256, by relative name."""
    return {
        path.relative_to(folder).as_posix(): sha256_of(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def sha256_of(path: Path) -> str:
    """The sha256 of a file's bytes, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _receipt(data_set: DataSet, root: Path) -> dict[str, str] | None:
    try:
        kept = json.loads((root / RECEIPTS / f"{data_set.name}.json").read_text(encoding="utf-8"))["sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return kept if isinstance(kept, dict) else None


def _differences(known: dict[str, str], folder: Path) -> list[str]:
    findings = []
    for name, checksum in known.items():
        path = folder / name
        if not path.is_file():
            findings.append(f"{path} is missing")
        elif sha256_of(path) != checksum:
            findings.append(f"{path} has changed: its sha256 is not {checksum}")
    return findings
