"""What a submission may consist of, whichever way it comes."""

from __future__ import annotations

import codecs
import io
import re
import tokenize
from collections.abc import Mapping
from pathlib import PurePosixPath

from slamcmp.errors import UsageError

FILES_MAX = 200
FILE_BYTES = 2 << 20
TOTAL_BYTES = 10 << 20
_PATH_MAX = 200
_IGNORED_FOLDERS = {
    "__MACOSX",
    "__pycache__",
    ".git",
    ".ipynb_checkpoints",
    ".venv",
    "venv",
    ".idea",
    ".vscode",
}
_IGNORED_FILES = {".DS_Store", "Thumbs.db", "desktop.ini", ".gitignore"}


class SubmissionError(UsageError):
    """The submission cannot be graded; the message says why and may be shown to the student."""


class Collector:
    """Gathers files and refuses what is too much, no text, or named to land elsewhere."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self._total = 0

    @staticmethod
    def is_junk(path: str) -> bool:
        """What editors and operating systems leave behind: skipped without a word."""
        parts = PurePosixPath(path).parts
        return bool(_IGNORED_FOLDERS & set(parts)) or (bool(parts) and parts[-1] in _IGNORED_FILES)

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

    def checked(self, name: str) -> Mapping[str, bytes]:
        """The files.

        Raises:
            SubmissionError: there are none.
        """
        if not self.files:
            raise SubmissionError(f"{name}: is empty")
        return self.files


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
