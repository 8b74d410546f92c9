"""The one way in which text files are read: their encoding, their lines, and their numbers as C reads them.

A byte order mark is no part of the text; what is not UTF-8 is taken for Latin-1, in which old comments are
written; lines end as on any system. Fields are separated by ASCII blanks only. Numbers are decimal, in ASCII
digits: ``1_0``, digits of other scripts, hexadecimal ones, ``inf`` and ``nan`` are no measurements.
"""

from __future__ import annotations

import re
from pathlib import Path

from slamcmp.errors import DataError, MissingDataError

_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))
_LINE_END = re.compile(r"\r\n|\r|\n")
_BLANKS = re.compile(r"[ \t\v\f]+")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,4000}")
_SHOWN = 60
"""Characters of a wrong field that a message repeats."""

ID_BITS = 64
"""Ids are signed whole numbers of so many bits."""


LARGEST = 1e100
"""Of any measurement or weight; what is derived from larger ones overflows far from where they stand."""


def read_text(path: Path) -> str:
    """The file's text without its byte order mark.

    Raises:
        MissingDataError: it cannot be read.
        DataError: it holds bytes of zero, as text does not, or a broken UTF-16.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise MissingDataError(f"{path}: cannot be read ({error.strerror})") from error
    encoding = ""
    for mark, name in _MARKS:
        if raw.startswith(mark):
            raw, encoding = raw[len(mark) :], name
            break
    if encoding.startswith("utf-16"):
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError as error:
            raise DataError(f"{path}: not a text file (byte {error.start})") from error
    else:
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    if "\0" in text:
        raise DataError(f"{path}: not a text file (byte {text.index(chr(0))} is zero)")
    return text


def text_lines(path: Path) -> list[str]:
    """The lines of the file, whatever ends them.

    Raises:
        DataError: see :func:`read_text`.
    """
    lines = _LINE_END.split(read_text(path))
    return lines[:-1] if not lines[-1] else lines


def ends_in_a_line(path: Path) -> bool:
    """Whether the last line is ended; a file that was cut short ends in the middle of one."""
    return read_text(path)[-1:] in ("", "\n", "\r")


def fields_of(line: str) -> list[str]:
    """What stands between ASCII blanks."""
    return [field for field in _BLANKS.split(line) if field]


def number(where: str, text: str) -> float:
    """A decimal number.

    Raises:
        DataError: it is none, or larger than anything measured; the message begins with ``where``.
    """
    if _NUMBER.fullmatch(text) is None:
        raise DataError(f"{where}: {shown(text)} is not a finite number")
    value = float(text)
    if abs(value) > LARGEST:
        raise DataError(f"{where}: {shown(text)} is not a finite number: it is too large for a measurement")
    return value


def whole(where: str, text: str) -> int:
    """An id: a whole number of 64 bits, with its sign.

    Raises:
        DataError: it is none; the message begins with ``where``.
    """
    if _WHOLE.fullmatch(text) is None:
        raise DataError(f"{where}: {shown(text)} is not an id; a whole number is needed")
    value = int(text)
    half = 1 << (ID_BITS - 1)
    if not -half <= value < half:
        raise DataError(
            f"{where}: {shown(text)} is not an id; one of {ID_BITS} bits is needed (−2^63 … 2^63 − 1)"
        )
    return value


def shown(text: str) -> str:
    """A field for a message, cut where it is long."""
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "…")
