"""What is known about the streams of a results folder, by their digests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from slamcmp.results.runs.run_file import StoredTruth, load_truth


def known_streams(folder: Path) -> dict[str, StoredTruth]:
    """Of each stream that was made, by its digest; without those that cannot be read."""
    return {known.digest: known for known in _stored(folder) if known.digest}


def _stored(folder: Path) -> Iterator[StoredTruth]:
    for path in sorted((folder / "streams").glob("*.truth.npz")):
        known = load_truth(path)
        if known is not None:
            yield known
