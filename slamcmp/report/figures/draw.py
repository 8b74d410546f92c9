"""Draw the registered figures of a results folder and write them as files."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.figure import Figure

from slamcmp.errors import UsageError
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable, drawn_part, part_text
from slamcmp.report.figures.look import Look
from slamcmp.results.grid import at_point, middle_point, point_name
from slamcmp.results.partial import comparable, missing_runs
from slamcmp.results.store import Results
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.messages import describe

ORDER = (
    "map",
    "errors",
    "consistency",
    "observability",
    "kl_from_batch",
    "time",
    "budget",
    "sweep",
    "images",
)
"""How a report reads; figures that are not named here follow in alphabetical order."""
OVER_TRIALS = frozenset(
    {"association", "attribution", "budget", "consistency", "dial", "kl_from_batch", "observability", "sweep"}
    | {"time"}
)
"""Figures of many trials, which their titles do not name; the others show one, and name it."""
OVER_FRAMES = frozenset({"association", "consistency", "observability", "time"})
"""Of these, those with curves over the frames of many runs."""
PAGE = Look()
DPI = 150
LETTERS_PER_INCH = 11
"""Of a bold title."""


class FigureFiles(list[Path]):
    """The files written; ``skipped`` maps each figure that was not drawn to the reason."""

    def __init__(self, paths: Sequence[Path] = (), skipped: dict[str, str] | None = None) -> None:
        super().__init__(paths)
        self.skipped = skipped or {}


@dataclass(frozen=True)
class Drawn:
    """One figure, or the reason why there is none."""

    name: str
    title: str
    caption: str
    figure: Figure | None
    reason: str = ""
    table: pd.DataFrame | None = None
    """The figure's numbers, where it has a table of them."""
    panels: tuple[Figure, ...] = ()
    """The same in small parts, for a page that sets them beside one another as it has room."""


def draw_figures(
    results: Results,
    names: Sequence[str] | None,
    folder: Path,
    formats: Sequence[str] = ("png", "svg"),
    look: Look = PAGE,
) -> FigureFiles:
    """Write the named figures (None: all) to ``folder`` as NAME.FORMAT; the same results give the same bytes.

    One panel is NAME_panelN.FORMAT. A figure whose inputs are missing is not written; the returned list's
    ``skipped`` says why.

    Raises:
        UsageError: a name is not a registered figure.
        StorageError: the disk is full or the folder cannot be written.
    """
    folder = Path(folder)
    files = FigureFiles()
    for drawn in each_figure(results, names, look):
        if drawn.figure is None:
            files.skipped[drawn.name] = drawn.reason
            continue
        part = "" if look.panel is None else f"_panel{look.panel}"
        for file_format in formats:
            path = folder / f"{drawn.name}{part}.{file_format}"
            try:
                content = figure_bytes(drawn.figure, file_format, look)
            except Exception as error:
                files.skipped[drawn.name] = fault_text(error)
                continue
            write_atomically(path, lambda file, content=content: file.write(content))  # type: ignore[misc]
            files.append(path)
    return files


def draw_figure(results: Results, name: str) -> Figure:
    """One figure, as an object to show or change.

    Raises:
        UsageError: there is no such figure, or these results do not hold what it shows.
    """
    (drawn,) = each_figure(results, [name])
    if drawn.figure is None:
        raise UsageError(f"figure {name!r} cannot be drawn: {drawn.reason}")
    return drawn.figure


def each_figure(results: Results, names: Sequence[str] | None = None, look: Look = PAGE) -> Iterator[Drawn]:
    """Draw one figure after the other, in reading order; without names all but those of trait ``on_request``.

    Raises:
        UsageError: a name is not a registered figure.
    """
    if names is None:
        known = [name for name in figures.names() if not figures.get(name).traits.get("on_request", False)]
        names = [name for name in ORDER if name in known] + [name for name in known if name not in ORDER]
    missing, results = missing_runs(results), comparable(results)
    part = results if results.trials.empty else drawn_part(results)
    for plugin in [figures.get(name) for name in names]:
        title, caption = plugin.traits.get("title", plugin.name), plugin.traits.get("caption", plugin.summary)
        with matplotlib.rc_context({**style.RC, **look.rc}):
            try:
                if results.trials.empty:
                    raise NotDrawable("no trial has a run of every back end")
                caption = plugin.traits.get("caption_of", lambda _, said=caption: said)(results)
                figure = plugin.target(part)
                if plugin.name in OVER_TRIALS:
                    _say(figure, _trials_text(results, figure))
                if plugin.name in OVER_FRAMES and part is not results:
                    _say(figure, part_text(part, results))
                if missing is not None:
                    _say(figure, missing.short())
                look.fit(figure)
                make_table = plugin.traits.get("table")
                table = None if make_table is None else make_table(part)
                make_panels = plugin.traits.get("panels")
                panels = () if make_panels is None else tuple(make_panels(part))
                drawn = Drawn(plugin.name, title, caption, figure, table=table, panels=panels)
            except (NotDrawable, UsageError) as reason:
                drawn = Drawn(plugin.name, title, caption, None, str(reason))
            except Exception as error:
                # One figure's mistake must cost neither the others nor the tables.
                drawn = Drawn(plugin.name, title, caption, None, fault_text(error))
        yield drawn


def _trials_text(results: Results, figure: Figure) -> str:
    """``over 20 trials (seeds 0 to 19)``: those of the grid point that the figure names, else all."""
    point = middle_point(results)
    named = point_name(point)
    trials = at_point(results.trials, point) if named and named in figure.get_suptitle() else results.trials
    count, seeds = int(trials["trial"].nunique()), sorted({int(seed) for seed in trials["seed"].dropna()})
    if not seeds:
        return f"over {count} trial{'s' if count > 1 else ''}"
    span = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {', '.join(map(str, seeds))}"
    if len(seeds) > 3:
        whole = seeds == list(range(seeds[0], seeds[-1] + 1))
        span = f"seeds {seeds[0]} to {seeds[-1]}" if whole else f"{len(seeds)} seeds from {seeds[0]} on"
    return f"over {count} trial{'s' if count > 1 else ''} ({span})"


def _say(figure: Figure, what: str) -> None:
    """Below the title, where whoever sees the figure alone sees it too."""
    lines = textwrap.wrap(what, int(LETTERS_PER_INCH * figure.get_figwidth()))
    figure.suptitle("\n".join([figure.get_suptitle(), *lines]), x=0.01, ha="left", fontweight="bold")


def fault_text(error: Exception) -> str:
    """Why a figure that has its inputs is not there."""
    return f"drawing it failed: {describe(error)}"


def figure_bytes(figure: Figure, file_format: str, look: Look = PAGE) -> bytes:
    """The figure as PNG, JPEG (150 dpi) or SVG, without the date and with fixed identifiers."""
    # The writers name the time of writing differently, and it belongs in no reproducible file.
    names: dict[str, dict[str, Any]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    metadata = names.get(file_format, {}) if file_format != "jpg" else None
    buffer = io.BytesIO()
    with matplotlib.rc_context({**style.RC, **look.rc}):
        figure.savefig(buffer, format=file_format, dpi=DPI, metadata=metadata)
    return buffer.getvalue()
