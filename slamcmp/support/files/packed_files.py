"""Many small files of a folder, kept in few: appended, checked, and read like the files they were.

A results folder has ``runs/`` and ``streams/`` with a file or two a job. Where they become many they are put
together into ``store/*.pack``. A file that lies there by itself goes before one that is packed.

A pack is a row of records: a mark, the lengths of head and content, the CRC-32 of lengths and head, the head
(JSON: name and sha256 of the content), the content. It is only ever appended to, and files are removed after
what holds them has reached the disk: whoever is ended in between leaves both. What follows a damaged record
is found by its mark.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import mmap
import os
import struct
import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from slamcmp.support.files.atomic import storage_error

FOLDER = "store"
MARK = b"\x93slamcmp-pack-1\n"
LENGTHS, CHECK = struct.Struct("<IQ"), struct.Struct("<I")
"""Bytes of the head and of the content; CRC-32 of these and of the head."""
PACK_BYTES = 1 << 28
"""A pack that is longer is not appended to any more."""


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a content lies."""

    pack: str
    at: int
    size: int
    sha256: str


class PackedFiles:
    """The packs of a folder, as they are at each look."""

    def __init__(self, root: Path) -> None:
        self._root, self._folder = root, root / FOLDER
        self._places: dict[str, _Place] = {}
        self._read: dict[str, tuple[int, int, int]] = {}
        """Of each pack its inode, how far it was read, and where its last good record ends."""

    def names(self) -> Collection[str]:
        """Of all that is packed, relative to the folder."""
        self._look()
        return self._places.keys()

    def sha256(self, name: str) -> str:
        """Of a packed content, as it was when it was packed; empty where there is none of that name."""
        place = self._places.get(name)
        return "" if place is None else place.sha256

    def content(self, name: str) -> bytes | None:
        """What is packed under that name; None where nothing is, or is not what it was."""
        self._look()
        place = self._places.get(name)
        if place is None:
            return None
        try:
            with (self._folder / place.pack).open("rb") as file:
                file.seek(place.at)
                content = file.read(place.size)
        except OSError:
            return None
        return content if hashlib.sha256(content).hexdigest() == place.sha256 else None

    def pack(self, names: Iterable[str]) -> None:
        """Put files together and remove them; one that is gone is left out.

        Raises:
            StorageError: the disk is full; every file is where it was.
        """
        found: list[tuple[str, bytes]] = []
        for name in names:
            with contextlib.suppress(OSError):
                found.append((name, (self._root / name).read_bytes()))
        if not found:
            return
        self._append([(name, content, hashlib.sha256(content).hexdigest()) for name, content in found])
        for name, _ in found:
            with contextlib.suppress(OSError):
                (self._root / name).unlink()

    def forget(self, name: str) -> None:
        """Have nothing under that name any more."""
        self._look()
        if name in self._places:
            self._append([(name, b"", "")])

    def _append(self, records: list[tuple[str, bytes, str]]) -> None:
        self._look()
        last = max(self._read, default="")
        pack, end = last, self._read[last][2] if last else 0
        if not last or end > PACK_BYTES:
            pack, end = f"{int(Path(last).stem or 0) + 1:06d}.pack", 0
        path = self._folder / pack
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with path.open("r+b" if path.exists() else "w+b") as file:
                # What a writer that was ended left of a record.
                file.truncate(end)
                file.seek(end)
                try:
                    for name, content, sha256 in records:
                        head = json.dumps({"name": name, "sha256": sha256}).encode()
                        lengths = LENGTHS.pack(len(head), len(content))
                        check = CHECK.pack(zlib.crc32(lengths + head))
                        file.write(MARK + lengths + check + head + content)
                    file.flush()
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(end)
                    raise
        except OSError as error:
            raise storage_error(path, error) from error
        self._look()

    def _look(self) -> None:
        """Read the heads of what was appended since the last look; all anew where a pack is another one."""
        there: dict[str, os.stat_result] = {}
        with contextlib.suppress(OSError):
            for entry in os.scandir(self._folder):
                if entry.name.endswith(".pack"):
                    there[entry.name] = entry.stat()
        for pack, (inode, end, _) in self._read.items():
            if pack not in there or there[pack].st_ino != inode or there[pack].st_size < end:
                self._read, self._places = {}, {}
                break
        for pack in sorted(there):
            _, end, good = self._read.get(pack, (0, 0, 0))
            if there[pack].st_size > end:
                with contextlib.suppress(OSError), (self._folder / pack).open("rb") as file:
                    good = self._heads(pack, file, good)
                self._read[pack] = there[pack].st_ino, there[pack].st_size, good

    def _heads(self, pack: str, file: IO[bytes], start: int) -> int:
        """Take in the records from ``start`` on; where the last whole one ends."""
        good = at = start
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
            while (at := text.find(MARK, at)) >= 0:
                lengths = text[at + len(MARK) : at + len(MARK) + LENGTHS.size]
                begin = at + len(MARK) + LENGTHS.size + CHECK.size
                if begin > len(text):
                    break
                head_size, size = LENGTHS.unpack(lengths)
                head = text[begin : begin + head_size]
                end = begin + head_size + size
                (check,) = CHECK.unpack_from(text, begin - CHECK.size)
                if zlib.crc32(lengths + head) != check or end > len(text):
                    at += 1
                    continue
                known = json.loads(head)
                if known["sha256"]:
                    place = _Place(pack, begin + head_size, size, known["sha256"])
                    self._places[known["name"]] = place
                else:
                    self._places.pop(known["name"], None)
                good = at = end
        return good


@functools.lru_cache(maxsize=8)
def packed_files(root: Path) -> PackedFiles:
    """The packs of a folder; the same object for each who asks in this process."""
    return PackedFiles(root)


def content(path: Path) -> bytes:
    """Of a file ``ROOT/FOLDER/NAME``, whether it lies there or is packed.

    Raises:
        OSError: there is neither.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        found = packed_files(path.parent.parent).content(f"{path.parent.name}/{path.name}")
        if found is None:
            raise
        return found


def is_there(path: Path) -> bool:
    """Whether there is such a file, packed or not."""
    return path.is_file() or f"{path.parent.name}/{path.name}" in packed_files(path.parent.parent).names()


def remove(path: Path) -> None:
    """Remove a file, wherever it is.

    Raises:
        OSError: it cannot be removed.
    """
    path.unlink(missing_ok=True)
    packed_files(path.parent.parent).forget(f"{path.parent.name}/{path.name}")


def names_in(folder: Path) -> set[str]:
    """What lies in ``ROOT/FOLDER`` or is packed: one look, where a look for each of many takes a minute."""
    found: set[str] = set()
    with contextlib.suppress(OSError):
        found = set(os.listdir(folder))
    before = f"{folder.name}/"
    packed = packed_files(folder.parent).names()
    return found | {name.removeprefix(before) for name in packed if name.startswith(before)}
