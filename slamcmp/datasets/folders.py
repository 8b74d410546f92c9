"""Where recorded data lies, and the text files in it."""

from __future__ import annotations

import contextlib
import os
import warnings
from pathlib import Path

import numpy as np

from slamcmp.errors import DataError, MissingDataError
from slamcmp.types import FloatArray

DATA_VARIABLE = "SLAMCMP_DATA"
"""Environment variable that names the folder with downloaded data sets."""


def find_folder(path: str, *, what: str, origin: str) -> Path:
    """``path`` where it is a folder, else the folder of that name under ``SLAMCMP_DATA``.

    Raises:
        MissingDataError: neither exists; the message says ``what`` belongs there and its ``origin``.
    """
    own = Path(path).expanduser()
    if own.is_dir():
        return own
    root = os.environ.get(DATA_VARIABLE)
    if root and (Path(root) / own).is_dir():
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
    own = Path(path).expanduser()
    root = os.environ.get(DATA_VARIABLE)
    for candidate in (own, Path(root) / own if root else own):
        if candidate.is_file():
            return candidate
    raise MissingDataError(f"{path}: there is no such file, nor under {DATA_VARIABLE} ({root or 'not set'})")


def require_file(path: Path, what: str) -> Path:
    """``path`` itself.

    Raises:
        MissingDataError: it is no file; the message says ``what`` it would hold.
    """
    if not path.is_file():
        raise MissingDataError(f"{path}: there is no such file; it holds {what}")
    return path


def text_rows(path: Path, columns: int, *, exactly: bool = False) -> list[tuple[str, list[str]]]:
    """(``file:line``, fields) of each line that is not empty nor a comment; commas and blanks separate.

    Raises:
        DataError: a line with fewer fields (``exactly``: another number), or a file that is not text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not a text file (byte {error.start})") from error
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split("#", 1)[0].replace(",", " ").split()
        if not fields:
            continue
        if len(fields) < columns or (exactly and len(fields) != columns):
            raise DataError(
                f"{path}:{number}: {len(fields)} fields where {'' if exactly else 'at least '}{columns} are "
                "needed; is the file truncated?"
            )
        rows.append((f"{path}:{number}", fields))
    return rows


def numbers(where: str, fields: list[str]) -> list[float]:
    """The fields as finite numbers.

    Raises:
        DataError: one is none; the message begins with ``where``.
    """
    values = []
    for text in fields:
        try:
            values.append(float(text))
        except ValueError:
            raise DataError(f"{where}: {text!r} is not a number") from None
    if not np.isfinite(values).all():
        raise DataError(f"{where}: numbers that are not finite")
    return values


def number_table(path: Path, columns: int, *, exactly: bool = False) -> FloatArray:
    """The first ``columns`` numbers of each line, (rows, columns).

    Raises:
        DataError: see :func:`text_rows` and :func:`numbers`; or there is no line.
    """
    table: FloatArray = np.empty((0, 0))
    # Ten times as fast where all is well; what is wrong with a file is found below.
    with warnings.catch_warnings(), contextlib.suppress(ValueError):
        warnings.simplefilter("ignore")
        table = np.loadtxt(path, ndmin=2, encoding="utf-8")
    fits = table.shape[1] == columns if exactly else table.shape[1] >= columns
    if len(table) and fits and np.isfinite(table).all():
        return table[:, :columns]
    rows = text_rows(path, columns, exactly=exactly)
    if not rows:
        raise DataError(f"{path}: holds no line of {columns} numbers")
    return np.array([numbers(where, fields[:columns]) for where, fields in rows])
