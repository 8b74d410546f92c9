"""A sweep of two or three paths as maps: a panel for each value of the first, cells over the other two."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import point_name, swept_columns, value_text
from slamcmp.results.store import Results
from slamcmp.results.words import parameter_words


@dataclass(frozen=True)
class Cells:
    """Which swept paths make the panels, the rows and the columns, and their values in the sweep's order."""

    panel: str | None
    """The first of three paths; None: there are two, and one panel."""
    down: str
    across: str
    panel_values: tuple[Any, ...]
    down_values: tuple[Any, ...]
    across_values: tuple[Any, ...]

    def each(self) -> Iterator[tuple[int, int, int, dict[str, Any]]]:
        """Panel, row and column of each cell, with its grid point."""
        for i, first in enumerate(self.panel_values):
            for j, second in enumerate(self.down_values):
                for k, third in enumerate(self.across_values):
                    point = {self.down: second, self.across: third}
                    yield i, j, k, point if self.panel is None else {self.panel: first, **point}

    def panel_title(self, i: int) -> str:
        """``lap steps = 40``; empty where there is one panel."""
        return "" if self.panel is None else f"{point_name({self.panel: self.panel_values[i]})}"


def cells(results: Results) -> Cells:
    """The cells of these results.

    Raises:
        NotDrawable: not two or three paths were swept.
    """
    trials = results.trials
    paths = [path for path in swept_columns(trials) if trials[path].nunique(dropna=False) > 1]
    if len(paths) not in (2, 3):
        here = {0: "none was", 1: "one was"}.get(len(paths), f"{len(paths)} were")
        raise NotDrawable(f"a map needs two or three swept parameters, and {here}")
    values = {path: tuple(trials[path].drop_duplicates()) for path in paths}
    panel = paths[0] if len(paths) == 3 else None
    down, across = paths[-2:]
    return Cells(panel, down, across, values[panel] if panel else (None,), values[down], values[across])


def panels(of: Cells, title: str, *, cell: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure with a panel for each value of the first path; ``cell``: a cell's width and height [inch]."""
    count, rows, columns = len(of.panel_values), len(of.down_values), len(of.across_values)
    figure = style.new_figure(max(6.5, count * columns * cell[0] + 1.2), rows * cell[1] + 1.5, title)
    axes = list(figure.subplots(1, count, squeeze=False)[0])
    for i, each in enumerate(axes):
        each.set_title(of.panel_title(i))
        each.set_xlim(-0.5, columns - 0.5)
        each.set_ylim(rows - 0.5, -0.5)
        each.set_xticks(range(columns), [value_text(value) for value in of.across_values])
        each.set_yticks(
            range(rows), [value_text(value) for value in of.down_values] if i == 0 else [""] * rows
        )
        each.set_xlabel(parameter_words(of.across))
        each.tick_params(length=0)
        each.grid(visible=False)
    axes[0].set_ylabel(parameter_words(of.down))
    return figure, axes
