"""The results folder: tables and manifest.

``results/NAME/`` holds ``trials.parquet``, ``frames.parquet``, ``landmarks.parquet`` and ``manifest.json``
for readers; ``runs/`` and ``streams/`` hold what a resumed run reuses, ``logs/`` what back ends printed.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow

from slamcmp.errors import DataError, MissingDataError
from slamcmp.support.atomic import write_atomically

TABLES = ("trials", "frames", "landmarks")
MANIFEST = "manifest.json"


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
    """Write the tables, then the manifest; each file is replaced as a whole.

    Raises:
        StorageError: the folder cannot be written; finished runs in it are not touched.
        DataError: a column holds what Parquet cannot.
    """
    for name in TABLES:
        table: pd.DataFrame = getattr(results, name)
        path = results.folder / f"{name}.parquet"
        try:
            write_atomically(
                path,
                lambda file, table=table: table.to_parquet(file, index=False, compression="zstd"),  # type: ignore[misc]
            )
        except (pyarrow.ArrowException, ValueError, TypeError) as error:
            raise DataError(
                f"{path}: the table of {name} has a column that Parquet cannot hold ({error}); the runs "
                f"themselves are kept in {results.folder / 'runs'}"
            ) from error
    text = json.dumps(finite(results.manifest), indent=2, default=str, allow_nan=False)
    write_atomically(results.folder / MANIFEST, lambda file: file.write(text.encode()))


def finite(value: Any) -> Any:
    """JSON has no infinity: as text, like YAML writes it."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return f"{value}" if isinstance(value, float) and not math.isfinite(value) else value


def load_results(folder: Path | str) -> Results:
    """Read the tables and the manifest of a results folder.

    Raises:
        MissingDataError: the folder holds no results.
        DataError: a file in it is damaged.
    """
    folder = Path(folder)
    for name in (MANIFEST, *(f"{table}.parquet" for table in TABLES)):
        if not (folder / name).is_file():
            raise MissingDataError(f"{folder}: no results here ({name} is missing); 'slamcmp run' makes them")
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
        tables = {name: pd.read_parquet(folder / f"{name}.parquet") for name in TABLES}
    except (OSError, ValueError) as error:
        raise DataError(f"{folder}: the results are damaged ({error}); run the experiment again") from error
    return Results(folder, manifest, **tables)


def find_results(results: str) -> Path:
    """The folder ``results``, or else ``results/RESULTS``."""
    path = Path(results)
    return path if path.is_dir() or not (Path("results") / results).is_dir() else Path("results") / results
