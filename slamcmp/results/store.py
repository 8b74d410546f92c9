"""The results folder: tables and manifest.

``results/NAME/`` holds ``trials.parquet``, ``frames.parquet``, ``landmarks.parquet`` and ``manifest.json``
for readers; ``runs/`` and ``streams/`` hold what a resumed run reuses, ``logs/`` what back ends printed.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import pandas as pd
import pyarrow
import pyarrow.parquet as pq

from slamcmp.errors import DataError, MissingDataError
from slamcmp.support.files.atomic import storage_error, write_atomically
from slamcmp.support.files.paths import is_dir, is_file
from slamcmp.support.messages import told

TABLES = ("trials", "frames", "landmarks")
MANIFEST = "manifest.json"
AGAIN = "run the experiment again: what finished is reused"
DIGESTS = "tables_sha256"
"""The key of the manifest under which the tables that belong to it are known by their content."""
OWN_DIGEST = "manifest_sha256"
"""The key under which the manifest is known by its own content."""

IMPORTED = "imported"
"""In the place of a back end's name: the poses are another program's."""


@dataclass(frozen=True)
class Results:
    """What an experiment found; the columns of its tables, with units, are listed in docs/formats.md."""

    folder: Path
    manifest: dict[str, Any]
    trials: pd.DataFrame
    """One row per trial and back end, failed ones included."""
    frames: pd.DataFrame
    """One row per frame and run."""
    landmarks: pd.DataFrame
    """One row per landmark and run."""

    def __repr__(self) -> str:
        from slamcmp.results.notebook import run_counts

        return f"<Results of {self.manifest.get('name')!r}: runs {run_counts(self)}; in {self.folder}>"

    def _repr_html_(self) -> str:
        """For notebooks: what ran, what is missing, key figures."""
        from slamcmp.results.notebook import results_html

        return results_html(self)


def save_results(results: Results) -> None:
    """Write the tables and the manifest with their hashes; nothing is replaced before all of it is written.

    Raises:
        StorageError: the folder cannot be written; what was in it is not touched.
        DataError: a column holds what Parquet cannot.
    """
    staging = results.folder / f".new.{os.getpid()}"
    digests = {}
    try:
        for name in TABLES:
            path = staging / f"{name}.parquet"
            try:
                write_atomically(path, functools.partial(_write_table, getattr(results, name)))
            except (pyarrow.ArrowException, ValueError, TypeError) as error:
                raise DataError(
                    f"{results.folder / path.name}: the table of {name} has a column that Parquet cannot "
                    f"hold ({error}); the runs themselves are kept in {results.folder / 'runs'}"
                ) from error
            with path.open("rb") as file:
                digests[name] = hashlib.file_digest(file, "sha256").hexdigest()
        # So that the manifest of one run and a table of another are never read as one.
        results.manifest[DIGESTS] = digests
        results.manifest.pop(OWN_DIGEST, None)
        plain = json.loads(json.dumps(finite(results.manifest), default=str, allow_nan=False))
        results.manifest[OWN_DIGEST] = plain[OWN_DIGEST] = manifest_digest(plain)
        text = json.dumps(plain, indent=2)
        write_atomically(staging / MANIFEST, lambda file: file.write(text.encode()))
        for name in (*(f"{table}.parquet" for table in TABLES), MANIFEST):
            try:
                (staging / name).replace(results.folder / name)
            except OSError as error:
                raise storage_error(results.folder / name, error) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _write_table(table: pd.DataFrame, file: IO[bytes]) -> None:
    table.to_parquet(file, index=False, compression="zstd", write_page_checksum=True)


def finite(value: Any) -> Any:
    """JSON has no infinity: as text, like YAML writes it."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return f"{value}" if isinstance(value, float) and not math.isfinite(value) else value


def manifest_digest(manifest: Mapping[str, Any]) -> str:
    """sha256 of a manifest but for its own hash: of its JSON with sorted keys and no white space."""
    content = {key: value for key, value in manifest.items() if key != OWN_DIGEST}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()


def load_results(folder: Path | str, without: Collection[str] = ()) -> Results:
    """Read the tables and the manifest of a results folder.

    Args:
        folder: where ``slamcmp run`` wrote them.
        without: columns of the frames' table that are not needed: of many runs they take much room.

    Raises:
        MissingDataError: the folder holds no results.
        DataError: a file in it is damaged.
    """
    folder = Path(folder)
    for name in (MANIFEST, *(f"{table}.parquet" for table in TABLES)):
        if not is_file(folder / name):
            raise MissingDataError(f"{folder}: no results here ({name} is missing); 'slamcmp run' makes them")
    manifest = _read_manifest(folder)
    tables = {
        name: _read_table(folder, name, manifest, without if name == "frames" else ()) for name in TABLES
    }
    return Results(folder, manifest, **tables)


def _read_manifest(folder: Path) -> dict[str, Any]:
    try:
        manifest: Any = json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{folder / MANIFEST}: cannot be read ({_told(error)}); {AGAIN}") from error
    mappings = (manifest, manifest.get("config"), manifest.get(DIGESTS)) if isinstance(manifest, dict) else ()
    if not mappings or not all(isinstance(each, dict) for each in mappings):
        raise DataError(
            f"{folder / MANIFEST}: is no manifest of this version: it must hold the mappings 'config' and "
            f"{DIGESTS!r}; {AGAIN}"
        )
    if manifest.get(OWN_DIGEST) != manifest_digest(manifest):
        raise DataError(
            f"{folder / MANIFEST}: is not as it was written (its {OWN_DIGEST!r} does not fit it): it was "
            f"changed, or is of an older version; {AGAIN}"
        )
    found: dict[str, Any] = manifest
    return found


def _read_table(
    folder: Path, name: str, manifest: Mapping[str, Any], without: Collection[str] = ()
) -> pd.DataFrame:
    path = folder / f"{name}.parquet"
    try:
        # One open file for both, so that what is read is what was checked, whoever replaces it meanwhile.
        with path.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != manifest[DIGESTS].get(name):
                raise DataError(
                    f"{path}: is not the table that {MANIFEST} describes: it was changed, or belongs to "
                    f"another experiment; {AGAIN}"
                )
            return _columns(file, without)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise DataError(f"{path}: cannot be read ({_told(error)}); {AGAIN}") from error


def _columns(file: IO[bytes], without: Collection[str]) -> pd.DataFrame:
    """A Parquet file but for some columns: one by one then, so that a large table fits once, not twice."""
    table = pq.ParquetFile(file, page_checksum_verification=True)
    if not without:
        whole: pd.DataFrame = table.read().to_pandas()
        return whole
    kept = [name for name in table.schema_arrow.names if name not in without]
    return pd.DataFrame({name: table.read([name]).to_pandas()[name] for name in kept}, copy=False)


def _told(error: Exception) -> str:
    return " ".join(told(str(error), 300).split())


def find_results(results: str) -> Path:
    """The folder ``results``, or else ``results/RESULTS``."""
    path = Path(results)
    within = Path("results") / results
    return within if is_dir(within) and not is_dir(path) else path
