"""A class's folder of submissions: who handed in what, and what a grade of it depends on."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.hand_in.hand_in import Collector, SubmissionError
from slamcmp.grading.hand_in.submission import load_submission


@dataclass(frozen=True)
class Submitted:
    """One entry of the class's folder."""

    student: str
    path: Path
    folder: str
    """Name of the student's folder in the results."""


def find_submissions(folder: Path) -> list[Submitted]:
    """The entries of the folder in the order of their names; a student is called as the file without suffix.

    Raises:
        MissingDataError: there is no such folder.
        UsageError: it is empty.
    """
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise MissingDataError(f"{folder}: cannot be read ({error.strerror})") from error
    names = [name for name in names if not name.startswith(".") and not Collector.is_junk(name)]
    if not names:
        raise UsageError(
            f"{folder}: holds no submissions; one file, zip, notebook or folder a student is expected"
        )
    stems = [_stem(folder / name) for name in names]
    counts = Counter(stems)
    found = []
    for name, stem in zip(names, stems, strict=True):
        student = stem if counts[stem] == 1 else _text(name)
        found.append(Submitted(student, folder / name, _folder_name(student, name)))
    return found


def digest_of_folder(folder: Path) -> str:
    """sha256 (hex) of names and contents of all files but what Python leaves behind.

    Raises:
        MissingDataError: there is no such folder.
    """
    if not folder.is_dir():
        raise MissingDataError(f"there is no assignment folder {folder}")
    hasher = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not Collector.is_junk(name):
            hasher.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return hasher.hexdigest()


def digest_of_submission(path: Path, entry: str | None) -> str:
    """Of all that decides the grade: of a submission that is refused, the reason."""
    try:
        return load_submission(path, entry=entry).digest
    except SubmissionError as error:
        return f"refused: {error}"
    except Exception as error:
        # The grading itself will meet it again, in a process of its own.
        return f"unreadable: {type(error).__name__}: {error}"


def _stem(path: Path) -> str:
    known = path.suffix.lower() in (".py", ".zip", ".ipynb")
    return _text(path.stem if known and not path.is_dir() else path.name)


def _text(name: str) -> str:
    """A file name as text that can be written: bytes that are no UTF-8 as backslashes."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def _folder_name(student: str, name: str) -> str:
    """The student's name where it is a harmless one, else what is harmless of it and a digest."""
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", student):
        return student
    harmless = re.sub(r"[^A-Za-z0-9._-]+", "_", student).strip("._-")[:60]
    return f"{harmless or 'student'}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"
