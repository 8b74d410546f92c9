"""Tables as the page shows them: cells that are read, sorted and marked, without columns that say nothing."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.results.grid import value_text
from slamcmp.results.numbers import number_text
from slamcmp.results.words import parameters_in_words

LONG = 16
"""Rows from which on a table below a figure or beside the summary is folded."""
EMPTY = "–"


@dataclass(frozen=True)
class Cell:
    """A table cell: what is read, and what it is sorted by."""

    text: str
    order: str = ""
    numeric: bool = False
    title: str = ""
    status: str = ""
    note: str = ""
    """A smaller line below."""


@dataclass(frozen=True)
class PageTable:
    """Headings in words, and the rows below them."""

    headers: list[str]
    rows: list[list[Cell]]

    @property
    def folded(self) -> bool:
        """Whether it is so long that the page shows it on request only."""
        return len(self.rows) >= LONG


def cell(value: Any) -> Cell:
    """A value as a table shows it: numbers with three significant digits, missing ones as a dash."""
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return Cell(EMPTY, "", True)
    if isinstance(value, bool | np.bool_ | str):
        return Cell(str(value), str(value))
    if isinstance(value, int | np.integer):
        return Cell(str(value), str(value), True)
    if isinstance(value, float | np.floating):
        return Cell(number_text(float(value)), repr(float(value)), True)
    return Cell(value_text(value), str(value))


def swept_cell(value: Any) -> Cell:
    """A swept value as the configuration has it, not rounded."""
    known = cell(value)
    return known if known.text == EMPTY else replace(known, text=value_text(value))


def cell_rows(table: pd.DataFrame, swept: list[str]) -> list[list[Cell]]:
    """The cells of each row; values of swept parameters are not rounded."""
    return [
        [_of_column(name, value, swept) for name, value in row.items()] for row in table.to_dict("records")
    ]


def page_table(table: pd.DataFrame, swept: list[str]) -> PageTable:
    """The table with parameters in words, and without the columns that have nothing in any row."""
    words = parameters_in_words(swept)
    headers = [words.get(name, name) for name in map(str, table.columns)]
    return without_empty(PageTable(headers, cell_rows(table, swept)))


def without_empty(table: PageTable) -> PageTable:
    """Without the columns that have nothing in any row."""
    kept = [
        index
        for index in range(len(table.headers))
        if any(row[index].text not in ("", EMPTY) for row in table.rows)
    ]
    return PageTable([table.headers[i] for i in kept], [[row[i] for i in kept] for row in table.rows])


def _of_column(name: Any, value: Any, swept: list[str]) -> Cell:
    shown = swept_cell(value) if name in swept else cell(value)
    # "1 diverged" is bad news, "0 of 6" and nothing are not.
    if name == "failed" and re.match(r"[1-9]", shown.text):
        return replace(shown, status="bad")
    return shown
