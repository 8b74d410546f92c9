"""What is known about the streams of a results folder, by their digests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from slamcmp.results.runs.run_file import StoredTruth, load_truth
from slamcmp.support.files.packed_files import names_in


def known_streams(folder: Path) -> dict[str, StoredTruth]:
    """Of each stream that was made, by its digest; without those that cannot be read."""
    return {known.digest: known for known in _stored(folder) if known.digest}


def _stored(folder: Path) -> Iterator[StoredTruth]:
    for name in sorted(names_in(folder / "streams")):
        known = load_truth(folder / "streams" / name) if name.endswith(".truth.npz") else None
        if known is not None:
            yield known
