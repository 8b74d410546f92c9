"""Read what a student handed in, without running any of it: a .py file, a folder, a zip or a notebook."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from slamcmp.grading.hand_in.archive import read_zip
from slamcmp.grading.hand_in.hand_in import FILE_BYTES, Collector, SubmissionError, size
from slamcmp.grading.hand_in.notebook import CellLine, read_notebook

__all__ = ["Submission", "SubmissionError", "load_submission"]

_PREFERRED_ENTRIES = ("submission.py", "solution.py", "main.py")


@dataclass(frozen=True)
class Submission:
    """Files of a submission in memory, checked but never executed."""

    name: str
    """Of the file or folder that was handed in."""
    kind: Literal["file", "folder", "zip", "notebook"]
    files: Mapping[str, bytes]
    """By path relative to the submission, with forward slashes."""
    entry: str
    """The file that is imported."""
    definitions_only: bool = False
    """Run only definitions and imports (a notebook without marked cells)."""
    cells: tuple[CellLine, ...] = ()
    """For a notebook: where each line of the entry comes from."""
    wanted: tuple[str, ...] = ()
    """Of a notebook without marked cells: the functions and classes asked for, which decide what is run."""
    left_out: tuple[str, ...] = ()
    """Hidden files and folders that were handed in with it and are not looked at."""

    @property
    def digest(self) -> str:
        """sha256 (hex) of everything that decides how it runs; equal content, equal digest."""
        hasher = hashlib.sha256(f"1\n{self.entry}\n{self.definitions_only}\n".encode())
        for path in sorted(self.files):
            content = self.files[path]
            hasher.update(f"{len(path.encode())} {path} {len(content)}\n".encode() + content)
        return hasher.hexdigest()

    def place(self, file: str, line: int) -> str:
        """``ekf.py, line 12`` or, for a notebook, ``cell 3, line 4``."""
        if file == self.entry and 1 <= line <= len(self.cells):
            cell, within = self.cells[line - 1]
            return f"cell {cell}, line {within}"
        return f"{file}, line {line}"


def load_submission(path: Path | str, *, entry: str | None = None) -> Submission:
    """Read a submission; ``entry`` is the file name that the assignment asks for.

    Without ``entry``, or where no file has that name, the only .py file at the top is taken, or
    ``submission.py``.

    Raises:
        SubmissionError: it cannot be graded; the message is meant for the student.
    """
    path = Path(path)
    try:
        mode = path.lstat().st_mode
    except OSError as error:
        raise SubmissionError(f"{path.name}: cannot be read ({error.strerror})") from error
    if stat.S_ISLNK(mode):
        raise SubmissionError(f"{path.name}: is a link; hand in the file itself")
    if stat.S_ISDIR(mode):
        return _several(path, "folder", _read_folder(path), entry)
    if not stat.S_ISREG(mode):
        raise SubmissionError(f"{path.name}: is no regular file")
    suffix = path.suffix.lower()
    if suffix == ".zip":
        return _several(path, "zip", read_zip(path), entry)
    if suffix == ".ipynb":
        return _notebook(path, entry)
    if suffix == ".py":
        collector = Collector()
        # Under the assignment's name, so that a renamed download still works.
        name = entry or path.name
        collector.add(name, _read_file(path))
        return Submission(path.name, "file", collector.files, name)
    raise SubmissionError(f"{path.name}: hand in a .py file, a folder, a .zip or a notebook (.ipynb)")


def _several(path: Path, kind: Literal["folder", "zip"], found: Collector, entry: str | None) -> Submission:
    chosen = _choose_entry(found.files, entry, path.name)
    return Submission(path.name, kind, found.files, chosen, left_out=tuple(found.left_out))


def _notebook(path: Path, entry: str | None) -> Submission:
    notebook = read_notebook(_read_file(path), path.name)
    name = entry or "notebook.py"
    files = {name: notebook.source.encode()}
    return Submission(path.name, "notebook", files, name, not notebook.marked, notebook.lines)


def _read_folder(root: Path) -> Collector:
    collector = Collector()

    def walk(folder: Path, prefix: str, depth: int) -> None:
        with os.scandir(folder) as entries:
            for entry in sorted(entries, key=lambda item: item.name):
                name = prefix + entry.name
                if collector.is_junk(name):
                    collector.leave_out(name)
                    continue
                if entry.is_symlink():
                    raise SubmissionError(f"{name}: is a link; hand in the file itself")
                if entry.is_dir(follow_symlinks=False):
                    if depth >= 8:
                        raise SubmissionError(f"{name}: folders nested too deeply")
                    walk(Path(entry.path), name + "/", depth + 1)
                elif entry.is_file(follow_symlinks=False):
                    collector.add(name, _read_file(Path(entry.path), name))
                else:
                    raise SubmissionError(f"{name}: is no regular file (a pipe, a socket or a device)")

    try:
        walk(root, "", 0)
    except OSError as error:
        raise SubmissionError(f"{root.name}: cannot be read ({error.strerror})") from error
    return collector.checked(root.name)


def _read_file(path: Path, name: str | None = None) -> bytes:
    name = name or path.name
    try:
        # The file may have become a link or a pipe since it was looked at.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise SubmissionError(f"{name}: is no regular file")
            content = file.read(FILE_BYTES + 1)
    except OSError as error:
        raise SubmissionError(f"{name}: cannot be read ({error.strerror})") from error
    if len(content) > FILE_BYTES:
        raise SubmissionError(f"{name}: is larger than {size(FILE_BYTES)}")
    return content


def _choose_entry(files: Mapping[str, bytes], wanted: str | None, name: str) -> str:
    top = [path for path in files if path.endswith(".py") and len(PurePosixPath(path).parts) == 1]
    for candidate in (wanted, *_PREFERRED_ENTRIES):
        if candidate in top:
            return str(candidate)
    if len(top) == 1:
        return top[0]
    asked = wanted or _PREFERRED_ENTRIES[0]
    if not top:
        raise SubmissionError(f"{name}: holds no Python file at its top; {asked} is expected there")
    raise SubmissionError(
        f"{name}: which file is to be graded? Name it {asked} (found {', '.join(top[:10])})"
    )
