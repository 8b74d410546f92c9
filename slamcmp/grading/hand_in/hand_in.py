"""What a submission may consist of, whichever way it comes."""

from __future__ import annotations

import codecs
import io
import re
import tokenize
from pathlib import PurePosixPath
from typing import Self

from slamcmp.errors import UsageError
from slamcmp.support.messages import printable

FILES_MAX = 200
FILE_BYTES = 2 << 20
TOTAL_BYTES = 10 << 20
_PATH_MAX = 200
_JUNK = {"__MACOSX", "__pycache__", "venv", "Thumbs.db", "desktop.ini"}


class SubmissionError(UsageError):
    """The submission cannot be graded; the message says why and may be shown to the student.

    It may quote names that the student has chosen: nothing in it can rewrite a terminal.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class Collector:
    """Gathers files and refuses what is too much, no text, or named to land elsewhere."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.left_out: list[str] = []
        """Names of hidden files and folders that were met."""
        self._total = 0

    @staticmethod
    def is_junk(path: str) -> bool:
        """What is hidden, and what editors and operating systems leave behind: left out, and told."""
        return any(_junk(part) for part in PurePosixPath(path).parts)

    def leave_out(self, path: str) -> None:
        """Remember what was left out, a hidden folder with all in it as one."""
        parts = PurePosixPath(path).parts
        first = next(number for number, part in enumerate(parts) if _junk(part))
        name = "/".join(parts[: first + 1])[:_PATH_MAX]
        if name not in self.left_out and len(self.left_out) < FILES_MAX:
            self.left_out.append(name)

    def add(self, path: str, content: bytes) -> None:
        """Take in a file.

        Raises:
            SubmissionError: see the class.
        """
        check_path(path)
        if path in self.files:
            raise SubmissionError(f"{shown(path)}: stands twice in the submission")
        if len(content) > FILE_BYTES:
            raise SubmissionError(f"{path}: is larger than {size(FILE_BYTES)}")
        self._total += len(content)
        if self._total > TOTAL_BYTES:
            raise SubmissionError(f"the submission is larger than {size(TOTAL_BYTES)} in all")
        if len(self.files) >= FILES_MAX:
            raise SubmissionError(f"the submission has more than {FILES_MAX} files")
        if path.endswith(".py"):
            content = as_utf8(path, content)
        self.files[path] = content

    def checked(self, name: str) -> Self:
        """Itself.

        Raises:
            SubmissionError: there are no files.
        """
        if not self.files:
            hidden = f" but for what is hidden ({', '.join(self.left_out[:5])})" if self.left_out else ""
            raise SubmissionError(f"{name}: is empty{hidden}")
        return self


def _junk(part: str) -> bool:
    return part in _JUNK or (part.startswith(".") and part.strip(".") != "")


def check_path(path: str) -> None:
    """Refuse names that would leave the submission's folder or cannot be a file.

    Raises:
        SubmissionError: with the name.
    """
    parts = PurePosixPath(path).parts
    escapes = path.startswith("/") or ".." in parts or "\\" in path or re.match(r"[A-Za-z]:", path)
    if escapes:
        raise SubmissionError(f"{shown(path)}: names a place outside of the submission")
    if not parts or not path.isprintable() or len(path) > _PATH_MAX or any(len(part) > 100 for part in parts):
        raise SubmissionError(f"{shown(path)}: is no usable file name")


def as_utf8(path: str, content: bytes) -> bytes:
    """A Python file in UTF-8: it may come in UTF-16 or UTF-8 with a mark, or in what its coding line names.

    Raises:
        SubmissionError: it is no text, with the place.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _decoded(path, content, "utf-16").encode()
    if b"\0" in content:
        raise SubmissionError(f"{path}: is no Python source, it holds binary data")
    try:
        encoding, _ = tokenize.detect_encoding(io.BytesIO(content).readline)
    except SyntaxError as error:
        # No coding line and no UTF-8 in the first two lines, or a coding line that names nothing known.
        _decoded(path, content, "utf-8-sig")
        raise SubmissionError(f"{path}: {error.msg}; save the file as UTF-8") from error
    text = _decoded(path, content, encoding)
    if encoding in ("utf-8", "utf-8-sig"):
        return text.encode()
    first, second, rest = [*text.split("\n", 2), "", ""][:3]
    declared = re.compile(r"(coding[:=]\s*)[-\w.]+")
    return "\n".join([declared.sub(r"\1utf-8", first), declared.sub(r"\1utf-8", second), rest]).encode()


def _decoded(path: str, content: bytes, encoding: str) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        name = "UTF-8" if encoding.startswith("utf-8") else encoding
        what = f"{path}, line {line}: is not {name} text; save the file as UTF-8"
        raise SubmissionError(what) from error


def shown(path: str) -> str:
    """A name that may be hostile, fit to be printed."""
    return repr(path[:_PATH_MAX])


def size(count: int) -> str:
    """Bytes in words."""
    return f"{count >> 20} MB"
