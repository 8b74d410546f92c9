"""Rows of settled trials, kept beside the tables: who gathers again reads no run of theirs.

``store/gathered-N.json`` names the trials of part N by a key of all that their rows are made of, and for each
its files with their hashes and where its rows lie in ``gathered-N.trials.parquet``, ``.frames.parquet`` and
``.landmarks.parquet``, whose own hashes stand there too. A part is written once, its JSON last; one that is
damaged is no part, and its runs are read again.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from slamcmp.results.store import TABLES
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.packed_files import FOLDER, packed_files

FORMAT = "slamcmp-gathered-1"
Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class AboutStream:
    """What a manifest sums up over the streams."""

    front_end: Mapping[str, int]
    warnings: Sequence[str]
    has_truth: bool
    failed: bool


@dataclass(frozen=True, slots=True)
class Settled:
    """A trial whose runs all came to an end that stays."""

    part: int
    spans: tuple[Span, ...]
    """Its rows in the three tables of its part."""
    files: Mapping[str, str]
    """sha256 of the files that they were made of, by their names in the results folder."""
    digest: str
    """Of its stream."""
    is_ok: bool
    """Whether all its runs ended well."""
    stream: AboutStream


class GatheredParts:
    """The parts of a results folder."""

    def __init__(self, root: Path) -> None:
        self._root, self._folder = root, root / FOLDER
        self._packed = packed_files(root)
        self._loose = {f"{name}/{each}" for name in ("runs", "streams") for each in _listed(root / name)}
        self._packed.names()
        self.trials: dict[str, Settled] = {}
        self._sha256: dict[int, Mapping[str, str]] = {}
        self._last = 0
        for name in sorted(_listed(self._folder)):
            if name.startswith("gathered-") and name.endswith(".json"):
                self._take_in(name)

    def find(self, key: str) -> Settled | None:
        """The trial of that key, if the files that its rows were made of are as they were."""
        found = self.trials.get(key)
        if found is None:
            return None
        for name, sha256 in found.files.items():
            if name in self._loose or self._packed.sha256(name) != sha256:
                return None
        return found

    def add(
        self,
        trials: Sequence[tuple[str, Sequence[str], str, bool, AboutStream]],
        tables: Mapping[str, pd.DataFrame],
        numbers: Sequence[int],
    ) -> None:
        """Keep the rows of trials; their files are packed first.

        Args:
            trials: key, files in the results folder, digest, whether all is well, about the stream; of each.
            tables: the rows of them and of others, those of a trial side by side.
            numbers: of the trials in the tables' column ``trial``.

        Raises:
            StorageError: the disk is full.
        """
        self.pack([name for _, files, _, _, _ in trials for name in files])
        self._last += 1
        own = {name: table[table["trial"].isin(numbers)] for name, table in tables.items()}
        spans = {name: _spans(table["trial"].to_numpy(), numbers) for name, table in own.items()}
        entries = {}
        for index, (key, files, digest, is_ok, stream) in enumerate(trials):
            known = {name: self._packed.sha256(name) for name in files}
            if all(known.values()):
                entries[key] = Settled(
                    self._last,
                    tuple(spans[name][index] for name in TABLES),
                    known,
                    digest,
                    is_ok,
                    stream,
                )
        written = {}
        for name, table in own.items():
            try:
                content = _parquet(table)
            except (pa.ArrowException, ValueError, TypeError):
                # A column that Parquet cannot hold: who saves the tables says so.
                return
            write_atomically(self._path(self._last, name), lambda file, text=content: file.write(text))  # type: ignore[misc]
            written[name] = hashlib.sha256(content).hexdigest()
        text = {
            "format": FORMAT,
            "tables": written,
            "trials": {key: asdict(each) for key, each in entries.items()},
        }
        path = self._folder / f"gathered-{self._last:06d}.json"
        write_atomically(path, lambda file: file.write(json.dumps(text).encode()))
        self.trials |= entries
        self._sha256[self._last] = written

    def pack(self, names: Sequence[str]) -> None:
        """Put files of the results folder together.

        Raises:
            StorageError: the disk is full.
        """
        self._packed.pack([name for name in names if name in self._loose])
        self._loose -= set(names)

    def rows(self, found: Sequence[tuple[int, Settled]]) -> tuple[dict[str, pd.DataFrame], list[int]]:
        """The rows of trials, each with its number now; and the numbers of those whose part is damaged."""
        by_part: dict[int, list[tuple[int, Settled]]] = {}
        for number, settled in found:
            by_part.setdefault(settled.part, []).append((number, settled))
        pieces: dict[str, list[pd.DataFrame]] = {name: [] for name in TABLES}
        lost: list[int] = []
        for part, own in sorted(by_part.items()):
            try:
                tables = {name: self._read(part, name) for name in TABLES}
            except (OSError, ValueError, pa.ArrowException):
                lost += [number for number, _ in own]
                continue
            for position, name in enumerate(TABLES):
                spans = [settled.spans[position] for _, settled in own]
                sizes = np.array([end - start for start, end in spans], dtype=np.int64)
                starts = np.array([start for start, _ in spans], dtype=np.int64)
                before = np.cumsum(sizes) - sizes
                rows = np.arange(int(sizes.sum())) + np.repeat(starts - before, sizes)
                table = tables[name]
                if not np.array_equal(rows, np.arange(len(table))):
                    table = table.iloc[rows].reset_index(drop=True)
                table["trial"] = np.repeat(np.array([number for number, _ in own], dtype=np.int64), sizes)
                pieces[name].append(table)
        return {name: pd.concat(each, ignore_index=True) for name, each in pieces.items() if each}, lost

    def _take_in(self, name: str) -> None:
        try:
            known = json.loads((self._folder / name).read_bytes())
            if known["format"] != FORMAT:
                return
            part = int(name.removeprefix("gathered-").removesuffix(".json"))
            self._last = max(self._last, part)
            self._sha256[part] = known["tables"]
            for key, each in known["trials"].items():
                spans = tuple((start, end) for start, end in each["spans"])
                stream = AboutStream(**each["stream"])
                self.trials[key] = Settled(part, spans, each["files"], each["digest"], each["is_ok"], stream)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return

    def _read(self, part: int, name: str) -> pd.DataFrame:
        content = self._path(part, name).read_bytes()
        if hashlib.sha256(content).hexdigest() != self._sha256[part].get(name):
            raise ValueError(f"part {part} is damaged")
        return pd.read_parquet(io.BytesIO(content))

    def _path(self, part: int, name: str) -> Path:
        return self._folder / f"gathered-{part:06d}.{name}.parquet"


def _spans(of_rows: Any, numbers: Sequence[int]) -> list[Span]:
    """Where the rows of each number begin and end; they stand side by side."""
    known, starts, sizes = np.unique(of_rows, return_index=True, return_counts=True)
    places = {
        number: (start, start + size)
        for number, start, size in zip(known.tolist(), starts.tolist(), sizes.tolist(), strict=True)
    }
    return [places.get(number, (0, 0)) for number in numbers]


def _parquet(table: pd.DataFrame) -> bytes:
    file = io.BytesIO()
    pq.write_table(pa.Table.from_pandas(table, preserve_index=False), file, compression="zstd")
    return file.getvalue()


def _listed(folder: Path) -> list[str]:
    with contextlib.suppress(OSError):
        return os.listdir(folder)
    return []
