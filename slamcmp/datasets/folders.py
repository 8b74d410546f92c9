"""Where recorded data lies, and the text files in it."""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from pathlib import Path

import numpy as np

from slamcmp.datasets.text import fields_of, number, read_text, text_lines
from slamcmp.errors import DataError, MissingDataError
from slamcmp.support.files.paths import expanded, is_dir, is_file
from slamcmp.types import FloatArray

DATA_VARIABLE = "SLAMCMP_DATA"
"""Environment variable that names the folder with downloaded data sets."""


def find_folder(path: str, *, what: str, origin: str) -> Path:
    """``path`` where it is a folder, else the folder of that name under ``SLAMCMP_DATA``.

    Raises:
        MissingDataError: neither exists; the message says ``what`` belongs there and its ``origin``.
    """
    own = expanded(path)
    if is_dir(own):
        return own
    root = os.environ.get(DATA_VARIABLE)
    if root and is_dir(Path(root) / own):
        return Path(root) / own
    if own.is_absolute():
        where = ""
    elif root:
        where = f" in {Path.cwd()} or {root} ({DATA_VARIABLE})"
    else:
        where = f" in {Path.cwd()}, and {DATA_VARIABLE} names no folder with data sets"
    raise MissingDataError(f"{path}: there is no such folder{where}; {what} is needed: {origin}")


def find_data_file(path: str) -> Path:
    """``path`` where it is a file, else the file of that name under ``SLAMCMP_DATA``.

    Raises:
        MissingDataError: neither exists.
    """
    own = expanded(path)
    root = os.environ.get(DATA_VARIABLE)
    for candidate in (own, Path(root) / own if root else own):
        if is_file(candidate):
            return candidate
    raise MissingDataError(f"{path}: there is no such file, nor under {DATA_VARIABLE} ({root or 'not set'})")


def require_file(path: Path, what: str) -> Path:
    """``path`` itself.

    Raises:
        MissingDataError: it is no file; the message says ``what`` it would hold.
    """
    if not is_file(path):
        raise MissingDataError(f"{path}: there is no such file; it holds {what}")
    return path


def text_rows(path: Path, columns: int, *, exactly: bool = False) -> list[tuple[str, list[str]]]:
    """(``file:line``, fields) of each line that is not empty nor a comment; commas and blanks separate.

    Raises:
        DataError: a line with fewer fields (``exactly``: another number), or a file that is not text.
    """
    rows = []
    for number_of_line, line in enumerate(text_lines(path), start=1):
        fields = fields_of(line.split("#", 1)[0].replace(",", " "))
        if not fields:
            continue
        if len(fields) < columns or (exactly and len(fields) != columns):
            raise DataError(
                f"{path}:{number_of_line}: {len(fields)} fields where "
                f"{'' if exactly else 'at least '}{columns} "
                "are needed; is the file truncated?"
            )
        rows.append((f"{path}:{number_of_line}", fields))
    return rows


def numbers(where: str, fields: list[str]) -> list[float]:
    """The fields as finite numbers.

    Raises:
        DataError: one is none; the message begins with ``where``.
    """
    return [number(where, text) for text in fields]


def number_table(path: Path, columns: int, *, exactly: bool = False) -> FloatArray:
    """The first ``columns`` numbers of each line, (rows, columns).

    Raises:
        DataError: see :func:`text_rows` and :func:`numbers`; or there is no line.
    """
    table: FloatArray = np.empty((0, 0))
    # Ten times as fast where all is well; what is wrong with a file is found below.
    with warnings.catch_warnings(), contextlib.suppress(ValueError):
        warnings.simplefilter("ignore")
        text = read_text(path)
        # Of text in ASCII it takes the same numbers for numbers, but for inf and nan.
        if text.isascii():
            table = np.loadtxt(io.StringIO(text, newline=None), ndmin=2)
    fits = table.shape[1] == columns if exactly else table.shape[1] >= columns
    if len(table) and fits and np.isfinite(table).all():
        return table[:, :columns]
    rows = text_rows(path, columns, exactly=exactly)
    if not rows:
        raise DataError(f"{path}: holds no line of {columns} numbers")
    return np.array([numbers(where, fields[:columns]) for where, fields in rows])
