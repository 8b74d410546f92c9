"""Turn a notebook into one source file whose lines are known by cell."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

from slamcmp.grading.hand_in.hand_in import SubmissionError

_TAG = "submit"
_MARK = re.compile(r"#\s*%%\s*submit\b")
_CELLS_MAX = 1000
_PYTHON_MAGICS = ("time", "timeit", "capture", "prun", "python", "python3", "pypy")
"""Cell magics behind which stands Python."""
_NO_PYTHON = re.compile(
    r"""\s*(
        [%!?]                           # %matplotlib inline, !pip install, ?np.eye
        | [\w.]+\?{1,2}\s*$             # np.eye?
        | [\w.,\ ]+=\s*(%[a-zA-Z]|!)    # files = !ls, t = %timeit -o f()
    )""",
    re.VERBOSE,
)

CellLine = tuple[int, int]
"""Number of the cell, counted from 1 over all cells, and of the line in it."""


@dataclass(frozen=True)
class Notebook:
    """The code of a notebook."""

    source: str
    lines: tuple[CellLine, ...]
    """Where each line of ``source`` comes from."""
    marked: bool
    """Whether the student marked cells; then exactly these were taken, else all of them."""


def read_notebook(content: bytes, name: str) -> Notebook:
    """The cells tagged ``submit`` or starting with ``# %% submit``; where there are none, all code cells.

    Lines that are no Python (``%magic``, ``!command``, ``eye?``) become comments, so that line numbers stay.
    Formats 4 and 3 are read.

    Raises:
        SubmissionError: no notebook, or one without code.
    """
    try:
        notebook = json.loads(content)
        # Format 3 has its cells on sheets, and calls a source the input.
        sheets = notebook["worksheets"] if "cells" not in notebook else [notebook]
        cells = [cell for sheet in sheets for cell in sheet["cells"]]
        code = [
            (number, _text(cell["source"] if "source" in cell else cell["input"]), _TAG in _tags(cell))
            for number, cell in enumerate(cells[:_CELLS_MAX], start=1)
            if cell["cell_type"] == "code"
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise SubmissionError(f"{name}: is no notebook of format 4 or 3 ({type(error).__name__})") from error
    chosen = [(number, text) for number, text, tagged in code if tagged or _MARK.match(text.lstrip())]
    marked = bool(chosen)
    if not marked:
        chosen = [(number, text) for number, text, _ in code]
    source: list[str] = []
    lines: list[CellLine] = []
    for number, text in chosen:
        for within, line in enumerate(_plain(text), start=1):
            source.append(line)
            lines.append((number, within))
    if not any(line.strip() for line in source):
        raise SubmissionError(
            f"{name}: has no code; mark cells with the tag {_TAG!r} or start them '# %% submit'"
        )
    joined = "\n".join(source) + "\n"
    if "\0" in joined:
        raise SubmissionError(f"{name}: holds binary data in its code")
    return Notebook(joined, tuple(lines), marked)


def _tags(cell: Any) -> list[Any]:
    tags = cell.get("metadata", {}).get("tags", [])
    return tags if isinstance(tags, list) else []


def _text(source: Any) -> str:
    text = source if isinstance(source, str) else "".join(source)
    # A lone surrogate is legal in JSON and in no source file.
    return text.encode("utf-8", errors="replace").decode("utf-8")


def _plain(text: str) -> list[str]:
    """The lines of a cell with what is no Python as comments."""
    lines = text.split("\n")
    first = next((number for number, line in enumerate(lines) if line.strip()), 0)
    if lines[first].startswith("%%"):
        if lines[first][2:].split(" ")[0] not in _PYTHON_MAGICS:
            return [f"# {line}" for line in lines]
        lines[first] = f"# {lines[first]}"
    plain, state = [], _State()
    for line in lines:
        if state.between_statements and _NO_PYTHON.match(line):
            line = f"{_indent(line)}pass  # {line.strip()}"
        state.read(line)
        plain.append(line)
    return plain


class _State:
    """Whether a line begins a statement: it does not within brackets, a long text, or after a backslash.

    The source is not parsed here: one made to hurt its reader would hurt us.
    """

    def __init__(self) -> None:
        self._quote = ""
        self._brackets = 0
        self._goes_on = False

    @property
    def between_statements(self) -> bool:
        return not (self._quote or self._brackets or self._goes_on)

    def read(self, line: str) -> None:
        at = 0
        self._goes_on = False
        while at < len(line):
            if self._quote:
                at = self._through_text(line, at)
            elif line[at] == "#":
                break
            elif line[at] in "\"'":
                self._quote = line[at] * 3 if line[at : at + 3] == line[at] * 3 else line[at]
                at += len(self._quote)
            else:
                self._brackets = max(0, self._brackets + (line[at] in "([{") - (line[at] in ")]}"))
                self._goes_on = line[at:] == "\\"
                at += 1
        if len(self._quote) == 1:
            # A short text ends with its line, unless that ends in a backslash.
            self._quote = self._quote if line.endswith("\\") else ""

    def _through_text(self, line: str, at: int) -> int:
        if line[at] == "\\":
            return at + 2
        if line.startswith(self._quote, at):
            at += len(self._quote)
            self._quote = ""
            return at
        return at + 1


def _indent(line: str) -> str:
    return line[: len(line) - len(line.lstrip())]
