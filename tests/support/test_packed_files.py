"""Packs: what was packed is read as it was, whenever a writer was ended and whatever became of the pack."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from slamcmp.errors import StorageError
from slamcmp.support.files import packed_files
from slamcmp.support.files.packed_files import (
    FOLDER,
    MARK,
    PackedFiles,
    content,
    is_there,
    names_in,
    remove,
)
from slamcmp.support.files.packed_files import (
    packed_files as packs_of,
)


def write(root: Path, count: int = 5, start: int = 0) -> dict[str, bytes]:
    made = {f"runs/{i}.npz": bytes([i % 256]) * (i * 7 + 1) + MARK[:5] for i in range(start, start + count)}
    (root / "runs").mkdir(exist_ok=True, parents=True)
    for name, text in made.items():
        (root / name).write_bytes(text)
    return made


def pack_file(root: Path) -> Path:
    (found,) = (root / FOLDER).glob("*.pack")
    return found


def test_packed_files_are_read_where_they_were(tmp_path: Path) -> None:
    made = write(tmp_path)
    PackedFiles(tmp_path).pack([*made, "runs/gone.npz"])
    assert os.listdir(tmp_path / "runs") == []
    for name, text in made.items():
        assert content(tmp_path / name) == text
        assert is_there(tmp_path / name)
    assert names_in(tmp_path / "runs") == {Path(name).name for name in made}
    with pytest.raises(FileNotFoundError):
        content(tmp_path / "runs" / "gone.npz")
    # What another process packs meanwhile is seen, and a file that lies there goes before.
    more = write(tmp_path, 3, start=5)
    PackedFiles(tmp_path).pack(more)
    (tmp_path / "runs" / "0.npz").write_bytes(b"newer")
    assert content(tmp_path / "runs" / "7.npz") == more["runs/7.npz"]
    assert content(tmp_path / "runs" / "0.npz") == b"newer"
    remove(tmp_path / "runs" / "0.npz")
    assert not is_there(tmp_path / "runs" / "0.npz")
    assert "runs/0.npz" not in PackedFiles(tmp_path).names()


def test_a_writer_that_is_ended_anywhere_loses_nothing(tmp_path: Path) -> None:
    """Cut at every length, a pack holds its whole records, and is appended to from there."""
    first = write(tmp_path)
    PackedFiles(tmp_path).pack(first)
    whole_before = pack_file(tmp_path).stat().st_size
    second = write(tmp_path, 2, start=20)
    PackedFiles(tmp_path).pack(second)
    text = pack_file(tmp_path).read_bytes()
    third = write(tmp_path, 1, start=40)
    for end in range(whole_before, len(text), 3):
        root = tmp_path / f"cut{end}"
        (root / FOLDER).mkdir(parents=True)
        (root / FOLDER / "000001.pack").write_bytes(text[:end])
        packs = PackedFiles(root)
        assert set(first) <= set(packs.names()) < {*first, *second}
        assert all(packs.content(name) == first[name] for name in first)
        write(root, 1, start=40)
        packs.pack(third)
        again = PackedFiles(root)
        assert set(again.names()) == {*packs.names(), *third}
        assert again.content("runs/40.npz") == third["runs/40.npz"]
        shutil.rmtree(root)


def test_a_spoilt_byte_costs_one_record(tmp_path: Path) -> None:
    made = write(tmp_path, 4)
    PackedFiles(tmp_path).pack(made)
    path = pack_file(tmp_path)
    text = path.read_bytes()
    for at in range(0, len(text), 5):
        path.write_bytes(text[:at] + bytes([text[at] ^ 0xFF]) + text[at + 1 :])
        packs = PackedFiles(tmp_path)
        right = [packs.content(name) == text_of for name, text_of in made.items()]
        wrong = [name for name in made if packs.content(name) not in (None, made[name])]
        assert sum(right) >= 3
        assert not wrong


def test_a_folder_that_is_gone_or_made_anew_is_no_old_one(tmp_path: Path) -> None:
    made = write(tmp_path)
    packs = packs_of(tmp_path)
    packs.pack(made)
    shutil.rmtree(tmp_path / FOLDER)
    assert not packs.names()
    other = write(tmp_path, 2, start=70)
    packs_of(tmp_path).pack(other)
    assert set(packs.names()) == set(other)


def test_a_full_disk_leaves_every_file_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = write(tmp_path)
    packs = PackedFiles(tmp_path)
    packs.pack(["runs/0.npz"])

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(packed_files.os, "fsync", full)
    with pytest.raises(StorageError, match="No space left"):
        packs.pack(made)
    monkeypatch.undo()
    assert len(os.listdir(tmp_path / "runs")) == 4
    assert set(PackedFiles(tmp_path).names()) == {"runs/0.npz"}
    packs.pack(made)
    assert set(PackedFiles(tmp_path).names()) == set(made)
