"""What an error says, in a form that every file, table and terminal can hold."""

from __future__ import annotations

import traceback

LIMIT = 2000
"""Bytes of UTF-8 that a message may have; what a file or an exception holds can be of any length."""
NOT_THEIRS = ("site-packages", "slamcmp/loaded_code.py")
"""In the names of files that no author looks for: the second stands between an import and the module."""


def told(text: str, limit: int = LIMIT) -> str:
    """``text`` as valid UTF-8 of at most ``limit`` bytes, with a word about what was left out."""
    whole = text.encode("utf-8", "backslashreplace").replace(b"\0", b"\\x00")
    if len(whole) <= limit:
        return whole.decode()
    note = f" … ({len(whole)} bytes in all)"
    return whole[: limit - len(note.encode())].decode("utf-8", "ignore") + note


def printable(text: str) -> str:
    """Text without control characters, which could rewrite a terminal; line ends and tabs stay."""
    return "".join(letter if letter.isprintable() or letter in "\n\t" else "\ufffd" for letter in text)


def describe(error: BaseException) -> str:
    """``ValueError: message (my_file.py:12, update)``: the deepest line outside installed libraries."""
    entries = traceback.extract_tb(error.__traceback__)
    own = [entry for entry in entries if not any(part in entry.filename for part in NOT_THEIRS)]
    place = (own or list(entries))[-1:]
    where = "".join(f" ({entry.filename.rsplit('/', 1)[-1]}:{entry.lineno}, {entry.name})" for entry in place)
    where = told(where, LIMIT // 4)
    try:
        text = str(error)
    except Exception as another:
        # An author's __str__ may have faults of its own.
        text = f"(its text raises {type(another).__name__})"
    return told(f"{type(error).__name__}: {text}", LIMIT - len(where.encode())) + where
