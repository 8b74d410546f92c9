"""Which runs of two results folders belong together: the same grid point, sample, back end and stream."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from slamcmp.results.compare.differences import Differences, setting
from slamcmp.results.grid import grid_points, labels, point_name, swept_columns, value_text
from slamcmp.results.partial import NOT_RUN
from slamcmp.results.store import Results

LISTED = 6
"""Seeds up to which each is named."""


@dataclass(frozen=True)
class Refusal:
    """Runs that cannot be paired."""

    label: str
    at: dict[str, Any]
    seeds: tuple[str, ...]
    reason: str

    def sentence(self) -> str:
        """``EKF, seeds 0, 1: …``."""
        where = ", ".join(filter(None, [self.label, point_name(self.at), seeds_text(self.seeds)]))
        return f"{where}: {self.reason}"


class Pairing:
    """Which runs belong together, and what was refused on the way."""

    def __init__(self, base: Results, other: Results, names: Mapping[str, str], found: Differences) -> None:
        self._base, self._other, self._names, self._found = base, other, names, found
        self.refused: list[Refusal] = []
        self.paired = 0
        both = (base.trials, other.trials)
        self._paths = list(dict.fromkeys(path for each in both for path in swept_columns(each)))
        self._rows = [self._by_place(each) for each in (base, other)]

    def places(self, back_ends: Sequence[str] | None) -> Iterator[tuple[dict[str, Any], str]]:
        """Grid points and labels of the base; what only one of the two has is refused."""
        wanted = list(back_ends or labels(self._base))
        for label in wanted:
            theirs = self._names.get(label, label)
            if theirs not in labels(self._other):
                hint = f"; --pair '{label}=NAME' names its partner"
                self.refused.append(Refusal(label, {}, (), f"only in {folder_name(self._base)}{hint}"))
        if back_ends is None:
            partners = {self._names.get(label, label) for label in labels(self._base)}
            for label in labels(self._other):
                if label not in partners:
                    self.refused.append(Refusal(label, {}, (), f"only in {folder_name(self._other)}"))
        for point in grid_points(self._base.trials):
            for label in wanted:
                if self._names.get(label, label) in labels(self._other):
                    yield point, label

    def pairs(self, point: dict[str, Any], label: str) -> list[tuple[str, pd.Series, pd.Series]]:
        """Seed and both rows of each pair, finished or not."""
        place = self._place(point, self._base)
        mine = self._rows[0].get((place, label), {})
        theirs = self._rows[1].get((place, self._names.get(label, label)), {})
        found, lonely = [], []
        streams: list[tuple[str, str, str]] = []
        references: list[tuple[str, str, str]] = []
        for key, row in mine.items():
            partner = theirs.get(key)
            if partner is None:
                lonely.append(key)
            elif row["digest"] != partner["digest"] or not row["digest"]:
                streams.append((key, str(row["digest"]), str(partner["digest"])))
            elif str(row["reference"]) != str(partner["reference"]):
                references.append((key, str(row["reference"]), str(partner["reference"])))
            else:
                found.append((key, row, partner))
        self._refuse(point, label, lonely, [key for key in theirs if key not in mine], streams, references)
        self.paired += len(found)
        return found

    def _refuse(
        self,
        point: dict[str, Any],
        label: str,
        only_base: Sequence[str],
        only_other: Sequence[str],
        streams: Sequence[tuple[str, str, str]],
        references: Sequence[tuple[str, str, str]],
    ) -> None:
        for keys, results in ((only_base, self._base), (only_other, self._other)):
            if keys:
                reason = f"run in {folder_name(results)} only"
                self.refused.append(Refusal(label, point, tuple(keys), reason))
        if streams:
            shown = " and ".join(each[:12] or "none" for each in streams[0][1:])
            reason = f"different streams (digests {shown}){self._why_streams_differ()}"
            self.refused.append(Refusal(label, point, tuple(key for key, *_ in streams), reason))
        if references:
            _, one, two = references[0]
            reason = f"scored against {one!r} in the one and {two!r} in the other"
            self.refused.append(Refusal(label, point, tuple(key for key, *_ in references), reason))

    def _why_streams_differ(self) -> str:
        """What a stream is made of and differs."""
        parts = [each for each in self._found.configuration if each.key.startswith(("source", "front_end"))]
        parts = parts or [each for each in self._found.code if each.key == "stream"]
        parts = parts or list(self._found.versions)
        named = ", ".join(f"{each.key} {each.base} → {each.other}" for each in parts[:3])
        return f": {named}" if named else ""

    def _by_place(self, results: Results) -> dict[tuple[Any, str], dict[str, pd.Series]]:
        found: dict[tuple[Any, str], dict[str, pd.Series]] = {}
        for _, row in results.trials.iterrows():
            if row["status"] not in NOT_RUN:
                key = (self._place(row, results), str(row["label"]))
                found.setdefault(key, {})[_sample(row)] = row
        return found

    def _place(self, values: Mapping[str, Any] | pd.Series, results: Results) -> tuple[str, ...]:
        """A grid point in both sweeps: what one folder sweeps, the other may have set."""
        return tuple(
            value_text(values[path] if path in values else setting(results.manifest, path))
            for path in self._paths
        )


def _sample(row: pd.Series) -> str:
    if "recording" in row and isinstance(row["recording"], str) and row["recording"]:
        return row["recording"]
    return "" if pd.isna(row["seed"]) else str(int(row["seed"]))


def seeds_text(seeds: Sequence[str]) -> str:
    """``seeds 0, 1``, or how many where they are many; empty for a log that has none."""
    named = [seed for seed in seeds if seed]
    if not named:
        return ""
    if len(named) > LISTED:
        return f"{len(named)} seeds"
    return f"seed{'s' if len(named) > 1 else ''} {', '.join(named)}"


def folder_name(results: Results) -> str:
    """As tables and messages call it."""
    return str(results.folder)
