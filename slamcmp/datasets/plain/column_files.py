"""Tables with units in their headers: CSV and Parquet files of one's own log.

A column is called by its quantity and its unit, ``t_ms``, ``bearing_deg``, ``sigma_range_m``, or with the
unit in brackets, ``t [ms]``, ``bearing (deg)``, ``v [m/s]``; what is read is in seconds, metres and radians.
The columns that mean something, and their units, stand in :data:`QUANTITIES` and :data:`UNITS`; others are
left out, and that is told.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import numpy as np

from slamcmp.datasets.text import number, text_lines, whole
from slamcmp.errors import DataError, MissingDataError
from slamcmp.registry import near_miss
from slamcmp.support.files.paths import is_file
from slamcmp.types import FloatArray

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": pi / 180},
    "speed": {"m_s": 1.0, "mm_s": 1e-3, "km_h": 1 / 3.6},
    "turn": {"rad_s": 1.0, "deg_s": pi / 180},
    "count": {"ticks": 1.0},
    "length, squared": {"m2": 1.0},
    "length times angle": {"m_rad": 1.0},
    "angle, squared": {"rad2": 1.0},
}
"""By kind of quantity: each unit and what it is in seconds, metres and radians."""

QUANTITIES: dict[str, str] = {
    "t": "time",
    **dict.fromkeys(("x", "y", "dx", "dy", "range"), "length"),
    **dict.fromkeys(("theta", "dtheta", "bearing"), "angle"),
    **{"v": "speed", "omega": "turn", "left": "count", "right": "count"},
    **dict.fromkeys(("sigma_x", "sigma_y", "sigma_range"), "length"),
    **dict.fromkeys(("sigma_theta", "sigma_bearing"), "angle"),
    **dict.fromkeys(("cov_xx", "cov_xy", "cov_yy"), "length, squared"),
    **dict.fromkeys(("cov_xtheta", "cov_ytheta"), "length times angle"),
    "cov_thetatheta": "angle, squared",
}
BRACKETED = re.compile(r"(\w+)\s*(?:\[([^\]]*)\]|\(([^)]*)\))")
"""A quantity and its unit, as ``v [m/s]`` or ``v (m/s)``."""
WRITTEN = {"°": "deg", "²": "2", "^2": "2", "µ": "u", "μ": "u", "/": "_", "*": "_", "·": "_", " ": "_"}
"""Parts of written units, and what stands for them in :data:`UNITS`."""
ID = "id"
"""A landmark's name: a whole number, empty where the sensor has none."""


@dataclass
class Table:
    """The columns of a file, in seconds, metres and radians."""

    path: Path
    columns: dict[str, FloatArray]
    """By quantity, each (rows,)."""
    ids: list[int | None] | None
    """Of column ``id``; None for a file without it."""
    lines: list[int]
    """Of each row the line in the file (of Parquet, the number of the row)."""
    warnings: list[str] = field(default_factory=list)

    def where(self, row: int) -> str:
        """file:line."""
        return f"{self.path}:{self.lines[row]}"

    def has(self, *names: str) -> bool:
        """Whether it has all these columns."""
        return all(name in self.columns for name in names)


def read_table(path: Path) -> Table:
    """A CSV file (commas, semicolons or tabs; its first line that is no comment is the header) or Parquet.

    Raises:
        MissingDataError: there is no such file.
        DataError: a column without unit, a line with another number of fields, what is no number, or no row.
    """
    if not is_file(path):
        raise MissingDataError(f"{path}: there is no such file")
    header, rows, lines = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    known = {
        f"{name}_{unit}": (name, factor)
        for name, kind in QUANTITIES.items()
        for unit, factor in UNITS[kind].items()
    }
    table = Table(path, {}, None, lines)
    for place, title in enumerate(header):
        texts = [row[place] for row in rows]
        title = _joined(title)
        if title == ID:
            table.ids = [None if text == "" else whole(table.where(k), text) for k, text in enumerate(texts)]
        elif title in known:
            name, factor = known[title]
            if name in table.columns:
                raise DataError(f"{path}: two columns of {name}, the second is {title}")
            table.columns[name] = factor * np.array(
                [number(table.where(k), text) for k, text in enumerate(texts)]
            )
        elif title in QUANTITIES:
            units = ", ".join(f"{title}_{unit}" for unit in UNITS[QUANTITIES[title]])
            raise DataError(f"{path}: column {title!r} has no unit; one of {units} is needed")
        else:
            table.warnings.append(
                f"{path.name}: column {header[place]!r} is not used{near_miss(title, [*known, ID])}"
            )
    return table


def _joined(title: str) -> str:
    """``v [m/s]`` as ``v_m_s``; others as they are."""
    found = BRACKETED.fullmatch(title)
    if found is None:
        return title
    unit = (found[2] or found[3] or "").strip()
    for written, part in WRITTEN.items():
        unit = unit.replace(written, part)
    return f"{found[1]}_{unit}" if unit else found[1]


Raw = tuple[list[str], list[list[str]], list[int]]


def _csv(path: Path) -> Raw:
    header: list[str] | None = None
    rows, lines = [], []
    for line, text in enumerate(text_lines(path), start=1):
        text = text.split("#", 1)[0].strip()
        if not text:
            continue
        fields = [part.strip() for part in re.split(r"[,;\t]", text)]
        if header is None:
            header = fields
            continue
        if len(fields) != len(header):
            raise DataError(
                f"{path}:{line}: {len(fields)} fields where the header has {len(header)} "
                f"({', '.join(header)}); is "
                "the file truncated?"
            )
        rows.append(fields)
        lines.append(line)
    if header is None or not rows:
        raise DataError(f"{path}: holds no row under a header such as t_s,v_m_s,omega_rad_s")
    return header, rows, lines


def _parquet(path: Path) -> Raw:
    import pandas as pd

    try:
        frame = pd.read_parquet(path)
    except Exception as error:
        # Whatever the Parquet library meets in a damaged file.
        raise DataError(f"{path}: not a Parquet file ({type(error).__name__})") from error
    if frame.empty:
        raise DataError(f"{path}: holds no row")
    texts = [
        ["" if pd.isna(value) else _text(value) for value in frame[title].tolist()] for title in frame.columns
    ]
    return (
        [str(title) for title in frame.columns],
        [list(row) for row in zip(*texts, strict=True)],
        list(range(1, len(frame) + 1)),
    )


def _text(value: object) -> str:
    """A whole number that Parquet kept as a float, because others are missing, is one all the same."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
