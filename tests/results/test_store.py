"""Tables and manifest belong together: a table of another experiment, or a flipped bit, is refused."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.errors import DataError, MissingDataError, SlamcmpError, StorageError
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.store import MANIFEST, TABLES, load_results, manifest_digest, save_results

Write = Callable[..., Path]


@pytest.fixture
def folder(write_experiment: Write, tmp_path: Path) -> Path:
    """Results of one back end on one seed."""
    run_experiment(write_experiment(back_ends=["Hindsight"]), folder=tmp_path / "r", executor="serial")
    return tmp_path / "r"


def refused(folder: Path) -> str:
    with pytest.raises(DataError) as error:
        load_results(folder)
    assert error.value.exit_code == 2
    text = str(error.value)
    assert "\n" not in text
    assert len(text) < 1000
    assert "run the experiment again" in text
    return text


@pytest.mark.parametrize("table", TABLES)
def test_a_table_with_one_flipped_bit_is_refused_wherever_it_is(folder: Path, table: str) -> None:
    path = folder / f"{table}.parquet"
    content = path.read_bytes()
    for place in np.random.default_rng(1).integers(0, len(content), 40).tolist():
        spoilt = bytearray(content)
        spoilt[place] ^= 1 << (place % 8)
        path.write_bytes(spoilt)
        assert f"{table}.parquet" in refused(folder)
    path.write_bytes(content)
    assert len(load_results(folder).trials) == 1


@pytest.mark.parametrize("table", ["trials", "frames"])
def test_the_table_of_another_experiment_is_refused(
    folder: Path, table: str, write_experiment: Write, tmp_path: Path
) -> None:
    other = write_experiment("other", back_ends=["Hindsight"], seeds=[1])
    run_experiment(other, folder=tmp_path / "other", executor="serial")
    shutil.copy(tmp_path / "other" / f"{table}.parquet", folder)
    assert "belongs to another experiment" in refused(folder)


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"null", b"{", b"\xff\xfe", b"{}", b'{"config": []}', b'{"config": {}}', b"[" * 100_000],
)
def test_a_damaged_manifest_is_refused(folder: Path, content: bytes) -> None:
    (folder / MANIFEST).write_bytes(content)
    assert MANIFEST in refused(folder)


def test_a_manifest_that_knows_no_hash_of_a_table_is_refused(folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    del manifest["tables_sha256"]["frames"]
    manifest["manifest_sha256"] = manifest_digest(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))
    assert "frames.parquet" in refused(folder)


def test_a_manifest_with_one_changed_byte_is_refused_or_says_the_same(folder: Path) -> None:
    """White space says nothing; a letter of the question, a digit of the configuration or a warning does."""
    content = (folder / MANIFEST).read_bytes()
    told = json.loads(content)
    spoilt_and_read = 0
    for place in np.random.default_rng(2).integers(0, len(content), 150).tolist():
        spoilt = bytearray(content)
        spoilt[place] ^= 1 << (place % 7)
        (folder / MANIFEST).write_bytes(spoilt)
        try:
            assert load_results(folder).manifest == told
        except DataError:
            spoilt_and_read += 1
    assert spoilt_and_read > 100
    for name, change in {
        "question": lambda text: f"{text}x",
        "config": lambda c: {**c, "seeds": [9]},
    }.items():
        (folder / MANIFEST).write_text(json.dumps({**told, name: change(told[name])}))
        assert "is not as it was written" in refused(folder)
    (folder / MANIFEST).write_text(json.dumps({k: v for k, v in told.items() if k != "manifest_sha256"}))
    assert "older version" in refused(folder)
    # Formatted by another program it is still the same.
    (folder / MANIFEST).write_text(json.dumps(told, sort_keys=True))
    assert load_results(folder).manifest == told


def test_the_hash_of_a_manifest_as_documented(folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    told = manifest.pop("manifest_sha256")
    text = json.dumps(manifest, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert hashlib.sha256(text.encode()).hexdigest() == told


def test_a_missing_file_is_missing_data(folder: Path) -> None:
    (folder / "frames.parquet").unlink()
    with pytest.raises(MissingDataError, match=r"frames\.parquet is missing"):
        load_results(folder)


def test_pages_carry_checksums_for_other_readers(folder: Path) -> None:
    """A damaged page is noticed without the manifest too."""
    path = folder / "frames.parquet"
    content = bytearray(path.read_bytes())
    group = pq.read_metadata(path).row_group(0)
    column = max((group.column(i) for i in range(group.num_columns)), key=lambda c: c.total_compressed_size)
    start = column.dictionary_page_offset or column.data_page_offset
    found = 0
    for offset in range(column.total_compressed_size - 20, column.total_compressed_size):
        spoilt = bytearray(content)
        spoilt[start + offset] ^= 1
        path.write_bytes(spoilt)
        try:
            pd.read_parquet(path, page_checksum_verification=True)
        except OSError as error:
            found += "CRC" in str(error)
    assert found == 20


@pytest.mark.parametrize(
    "command", [["report"], ["plot"], ["seeds", "--metric", "online_ate", "--difference", "1"]]
)
def test_every_command_that_reads_results_refuses_them(folder: Path, command: list[str]) -> None:
    path = folder / "trials.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    ended = CliRunner().invoke(app, [command[0], str(folder), *command[1:]])
    assert isinstance(ended.exception, SlamcmpError)
    assert ended.exception.exit_code == 2
    assert "trials.parquet" in str(ended.exception)


def test_a_full_disk_half_way_leaves_the_old_results_readable(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = load_results(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    write = pd.DataFrame.to_parquet
    written = []

    def full(self: pd.DataFrame, file: Any, **options: Any) -> None:
        if len(written) == 2:
            raise OSError(28, "No space left on device")
        written.append(self)
        write(self, file, **options)

    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    changed = replace(results, trials=results.trials.assign(message="another"))
    with pytest.raises(StorageError, match="No space left on device"):
        save_results(changed)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    assert not list(folder.glob(".new*"))
    assert load_results(folder).trials["message"].tolist() == results.trials["message"].tolist()
