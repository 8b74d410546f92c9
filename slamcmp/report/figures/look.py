"""How figures look elsewhere than in the report: in a paper's column, on a slide.

A figure is drawn as ever and then made to fit: to the width that is asked for, panels of one row below each
other where they would be too narrow, titles broken into lines, legends with fewer columns. Text stays text:
Type 42 fonts in PDF, ``<text>`` in SVG.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import Any

from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from slamcmp.errors import UsageError
from slamcmp.registry import did_you_mean

INCH = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0, "pt": 1 / 72.27}
"""Units of a width; LaTeX's points, of which the width of a column is known."""
NARROWEST = 2.4
"""Inches below which a panel of a row goes into a row of its own, at the paper's size of text."""
SLIDE_WIDTH = 13.333
"""Inches of a slide of 16:9."""


@dataclass(frozen=True)
class Look:
    """What was asked for; nothing of it changes what is shown."""

    style: str = "page"
    """``page`` (as in the report), ``paper`` or ``slide``."""
    width_inch: float | None = None
    font: str | None = None
    panel: int | None = None
    """Only this panel, from 1 on; None: all."""

    @property
    def rc(self) -> Any:
        """Settings of matplotlib, over those of the report: a mapping."""
        found: dict[str, Any] = {}
        if self.style != "page":
            # Letters as letters: journals ask for it, and a reader can search them.
            found |= {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}
        if self.style == "paper":
            found |= _sizes(8.0) | {"lines.linewidth": 1.0, "axes.linewidth": 0.6, "lines.markersize": 4.0}
        if self.style == "slide":
            found |= _sizes(18.0) | {"lines.linewidth": 2.4, "axes.linewidth": 1.2, "lines.markersize": 9.0}
        if self.font is not None:
            found |= {"font.family": [self.font, "DejaVu Sans"]}
        return found

    def fit(self, figure: Figure) -> None:
        """Make the figure so wide, with nothing clipped.

        Raises:
            UsageError: it has no such panel.
        """
        if self == Look():
            return
        if self.panel is not None:
            _keep_panel(figure, self.panel)
        width, height = figure.get_size_inches()
        # Their figures are drawn at 9.5 points; a slide's larger letters need a larger figure.
        target = self.width_inch or (SLIDE_WIDTH if self.style == "slide" else width)
        smallest = NARROWEST * (18.0 / 8.0 if self.style == "slide" else 1.0)
        columns, rows = _reflow(figure, target, smallest)
        if columns is None and any(axes.get_aspect() != "auto" for axes in figure.axes):
            # Maps and images keep their shape; what is added is for letters, which do not shrink.
            height = height * target / width + 0.9
        elif columns is None:
            height *= max(target / width, 0.75 if target < width else 1.0)
        else:
            height = rows * min(0.75 * target / columns, 2.6 * smallest) + 0.09 * target + 0.4
        figure.set_size_inches(target, height)
        _shrink_fixed_texts(figure)
        for _ in range(6):
            if _broken_to_fit(figure):
                break


def parse_width(text: str) -> float:
    """``88mm``, ``8.8cm``, ``3.5in``, ``252pt`` in inches.

    Raises:
        UsageError: no number with a unit, or no width of a figure.
    """
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(\w+)\s*", text)
    if match is None or match[2] not in INCH:
        raise UsageError(
            f"--width {text!r}: expected a number with its unit, one of {', '.join(INCH)}, e.g. 88mm"
        )
    inches = float(match[1]) * INCH[match[2]]
    if not 1.0 <= inches <= 60.0:
        raise UsageError(f"--width {text!r}: {inches:.3g} inches; figures are from 1 to 60 inches wide")
    return inches


def check_font(name: str) -> str:
    """The name itself, where this machine has the font.

    Raises:
        UsageError: it has not.
    """
    known = sorted({*font_manager.get_font_names(), "serif", "sans-serif", "monospace"})
    if name not in known:
        near = did_you_mean(name, known)
        # Machines have hundreds.
        raise UsageError(
            f"--font {name!r}: this machine has no such font{near[:200]}{' …' if len(near) > 200 else ''}"
        )
    return name


def _sizes(points: float) -> dict[str, Any]:
    return {
        "font.size": points,
        "axes.titlesize": points,
        "axes.labelsize": points,
        "xtick.labelsize": 0.9 * points,
        "ytick.labelsize": 0.9 * points,
        "legend.fontsize": 0.9 * points,
        "figure.titlesize": 1.1 * points,
    }


def _panels(figure: Figure) -> list[Axes]:
    """Axes that have a place in a grid, without colour bars and the like."""
    return [each for each in figure.axes if each.get_subplotspec() is not None and each.axison]


def _keep_panel(figure: Figure, number: int) -> None:
    panels = _panels(figure)
    if not 1 <= number <= len(panels):
        raise UsageError(f"--panel {number}: this figure has panels 1 to {len(panels)}")
    kept = panels[number - 1]
    width, height = figure.get_size_inches()
    spec = kept.get_subplotspec()
    assert spec is not None
    geometry = spec.get_gridspec()
    for axes in figure.axes:
        if axes is not kept:
            figure.delaxes(axes)
    _label_again(kept, panels)
    kept.set_subplotspec(figure.add_gridspec(1, 1)[0])
    figure.set_size_inches(
        max(width / geometry.ncols, 0.45 * width), max(height / geometry.nrows + 0.6, 0.35 * height)
    )


def _reflow(figure: Figure, target: float, smallest: float) -> tuple[int | None, int]:
    """Panels of a row below one another where they get too narrow; columns and rows, or None as they were."""
    panels = _panels(figure)
    specs = [axes.get_subplotspec() for axes in panels]
    grids = {id(spec.get_gridspec()) for spec in specs if spec is not None}
    first = specs[0].get_gridspec() if specs and specs[0] is not None else None
    if len(grids) != 1 or first is None or first.nrows != 1 or len(panels) != first.ncols:
        return None, 1
    columns = max(1, min(len(panels), int(target / smallest)))
    if columns == len(panels):
        return columns, 1
    rows = -(-len(panels) // columns)
    grid = figure.add_gridspec(rows, columns)
    for place, axes in enumerate(panels):
        _label_again(axes, panels)
        axes.set_subplotspec(grid[place // columns, place % columns])
    return columns, rows


def _label_again(axes: Axes, panels: list[Axes]) -> None:
    """What a neighbour in its row or column said for it, it says itself."""
    axes.tick_params(labelleft=True, labelbottom=True)
    for name, shared in (("xlabel", axes.get_shared_x_axes()), ("ylabel", axes.get_shared_y_axes())):
        if not getattr(axes, f"get_{name}")():
            texts = [getattr(each, f"get_{name}")() for each in panels if shared.joined(axes, each)]
            getattr(axes, f"set_{name}")(next(filter(None, texts), ""))


def _shrink_fixed_texts(figure: Figure) -> None:
    """Sizes that a figure's author fixed, never above those of the look."""
    import matplotlib

    size = float(matplotlib.rcParams["font.size"])
    if size < 9.5:
        for text in figure.findobj(Text):
            if float(text.get_fontsize()) > 1.1 * size:
                text.set_fontsize(1.1 * size)


def _broken_to_fit(figure: Figure) -> bool:
    """Break titles that are wider than their place, and legends with too many columns; whether all fits."""
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    figure.draw_without_rendering()
    right = figure.bbox.width
    fits = True
    title = figure._suptitle  # type: ignore[attr-defined]
    titles = [(title, 0.98 * right)] if title is not None and title.get_text() else []
    for axes in figure.axes:
        # A title stands at the left of its panel and may be as wide.
        for text in (axes.title, axes._left_title, axes._right_title):  # type: ignore[attr-defined]
            if text.get_text():
                titles.append((text, axes.get_window_extent(renderer).width))
        for label, room in (
            (axes.xaxis.label, 1.05 * axes.get_window_extent(renderer).width),
            (axes.yaxis.label, 1.05 * axes.get_window_extent(renderer).height),
        ):
            if label.get_text():
                titles.append((label, room))
    for text, room in titles:
        box = text.get_window_extent(renderer)
        length = box.height if text.get_rotation() == 90 else box.width
        longest = max(map(len, text.get_text().split("\n")))
        if length > room and longest > 8:
            most = max(8, int(longest * room / length))
            lines = [part for line in text.get_text().split("\n") for part in textwrap.wrap(line, most)]
            text.set_text("\n".join(lines))
            fits = False
    for legend in list(figure.legends):
        box = legend.get_window_extent(renderer)
        columns = int(legend._ncols)  # type: ignore[attr-defined]
        if box.x1 > 0.985 * right and columns > 1:
            _with_fewer_columns(figure, legend, max(1, min(columns - 1, int(columns * right / box.x1))))
            fits = False
    return fits


def _with_fewer_columns(figure: Figure, legend: Any, columns: int) -> None:
    handles, texts = list(legend.legend_handles), [text.get_text() for text in legend.get_texts()]
    legend.remove()
    figure.legend(handles, texts, loc="outside lower left", ncols=columns)
