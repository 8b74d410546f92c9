"""A test's plots as images inside of a file."""

from __future__ import annotations

import base64
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from slamcmp.grading.results.outcome import Plot

if TYPE_CHECKING:
    from slamcmp.report.figures.grades import Curve


@lru_cache(maxsize=64)
def data_uri(plot: Plot, image_format: Literal["png", "svg"]) -> str:
    """The plot as a data URI; drawn once where it is asked for again, as it is after each test."""
    # Loading matplotlib takes longer than many a grading.
    from slamcmp.report.figures.draw import figure_bytes
    from slamcmp.report.figures.grades import plot_curves

    figure = plot_curves(
        plot.title, plot.x_label, plot.y_label, plot.x, curves_of(plot), equal_scales=plot.equal_scales
    )
    kind = "svg+xml" if image_format == "svg" else image_format
    return f"data:image/{kind};base64,{base64.b64encode(figure_bytes(figure, image_format)).decode()}"


def curves_of(plot: Plot) -> list[Curve]:
    """The plot's series as the figure takes them."""
    from slamcmp.report.figures.grades import Curve

    return [Curve(series.name, series.y, series.role, series.x or None) for series in plot.series]
