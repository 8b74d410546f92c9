"""A class's folder of submissions: who handed in what, and what a grade of it depends on."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import unicodedata
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


@dataclass(frozen=True)
class ClassFolder:
    """What lies in the class's folder."""

    submitted: tuple[Submitted, ...]
    left_out: tuple[str, ...]
    """Names of hidden entries and of what operating systems leave behind: not graded."""


def find_submissions(folder: Path, token: bytes = b"") -> ClassFolder:
    """The entries of the folder in the order of their names; a student is called as the file without suffix.

    Where that is no name of one entry alone, as with ``ada.py`` beside ``ada.zip``, the suffix stays.

    Args:
        folder: one file, zip, notebook or folder a student.
        token: kept by the staff; without it nobody can tell the name of a student's folder in the results.

    Raises:
        MissingDataError: there is no such folder.
        UsageError: it is empty, or two entries cannot be told apart.
    """
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise MissingDataError(f"{folder}: cannot be read ({error.strerror})") from error
    left_out = [name for name in names if name.startswith(".") or Collector.is_junk(name)]
    names = [name for name in names if name not in left_out]
    if not names:
        hidden = f" (left out: {', '.join(map(_text, left_out))})" if left_out else ""
        raise UsageError(
            f"{folder}: holds no submissions; one file, zip, notebook or folder a student is expected{hidden}"
        )
    students = _students(folder, names)
    found = tuple(
        Submitted(student, folder / name, _folder_name(student, name, token))
        for name, student in zip(names, students, strict=True)
    )
    return ClassFolder(found, tuple(map(_text, left_out)))


def _students(folder: Path, names: list[str]) -> list[str]:
    """A student for each entry, told apart also by who reads over case and accents.

    Raises:
        UsageError: two entries cannot be told apart.
    """
    students = [_stem(folder / name) for name in names]
    # A name with its suffix may be another's without: until nothing changes.
    while shared := {key for key, count in Counter(map(_key, students)).items() if count > 1}:
        whole = [
            _text(name) if _key(student) in shared else student
            for name, student in zip(names, students, strict=True)
        ]
        if whole == students:
            alike = [
                _text(name) for name, student in zip(names, students, strict=True) if _key(student) in shared
            ]
            raise UsageError(
                f"{folder}: {', '.join(alike)} differ only in case or in how their letters are encoded: are "
                "they one student's? Rename or remove one of them"
            )
        students = whole
    return students


def _key(name: str) -> str:
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


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
    """A file name as text that can be written and shown: what is no UTF-8 or no letter as backslashes."""
    text = os.fsencode(name).decode("utf-8", "backslashreplace")
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text
    )


def _folder_name(student: str, name: str, token: bytes) -> str:
    """What is harmless of the student's name, and a digest that nobody without the token can tell."""
    harmless = re.sub(r"[^A-Za-z0-9._-]+", "_", student).strip("._-")[:60]
    return f"{harmless or 'student'}-{hmac.digest(token, os.fsencode(name), 'sha256').hex()[:20]}"
