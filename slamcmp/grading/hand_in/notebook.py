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

    Lines that are no Python (``%magic``, ``!command``) become comments, so that line numbers stay.

    Raises:
        SubmissionError: no notebook, or one without code.
    """
    try:
        cells = json.loads(content)["cells"]
        code = [
            (number, _text(cell["source"]), _TAG in _tags(cell))
            for number, cell in enumerate(cells[:_CELLS_MAX], start=1)
            if cell["cell_type"] == "code"
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise SubmissionError(f"{name}: is no notebook of format 4 ({type(error).__name__})") from error
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
    lines = text.split("\n")
    if text.lstrip().startswith("%%"):
        return [f"# {line}" for line in lines]
    return [
        f"{_indent(line)}pass  # {line.strip()}" if line.lstrip().startswith(("%", "!")) else line
        for line in lines
    ]


def _indent(line: str) -> str:
    return line[: len(line) - len(line.lstrip())]
