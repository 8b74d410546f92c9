"""A data set of two files that servers on this machine deliver."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import replace
from pathlib import Path

from slamcmp.datasets.fetching.data_set import Archive, DataSet

CONTENT = {"Toy_Set/a.txt": b"one\n" * 100_000, "Toy_Set/deep/b.txt": b"two\n"}


def zipped(content: dict[str, bytes] = CONTENT) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return buffer.getvalue()


BYTES = zipped()
SHA256 = hashlib.sha256(BYTES).hexdigest()


def toy(url: str, **changed) -> DataSet:
    return replace(
        DataSet(
            name="toy",
            title="A toy",
            licence="for toys only",
            citation="nobody, Toys, 2020",
            page="https://toys.example",
            folder="toys/Toy_Set",
            required=("a.txt", "deep/*.txt"),
            archives=(Archive(f"{url}/toy.zip", sha256=SHA256),),
        ),
        **changed,
    )


def everything(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
