"""A figure of an experiment or of single runs, as an object that a notebook shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from slamcmp.api.streams import SourceStream
from slamcmp.errors import UsageError
from slamcmp.report.figures.draw import draw_figure
from slamcmp.results.runs.of_runs import results_of_runs
from slamcmp.results.store import Results
from slamcmp.types import GroundTruth, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(
    shown: Results | Run | Sequence[Run],
    figure: str = "map",
    *,
    truth: GroundTruth | SourceStream | None = None,
) -> Figure:
    """Draw a registered figure of an experiment's results, of a run, or of several runs of one stream.

    >>> import slamcmp
    >>> stream = slamcmp.make_stream("circle", 3, landmarks=10, steps=20)
    >>> runs = [slamcmp.run_back_end(name, stream) for name in ("ekf_slam", "isam2")]
    >>> slamcmp.plot(runs, figure="errors", truth=stream)
    <PageFigure size ...>
    >>> slamcmp.plot(runs[0], figure="dial")
    Traceback (most recent call last):
    slamcmp.errors.UsageError: figure 'dial' cannot be drawn: no sliding_window was run with two windows, ...

    A notebook shows what the last line of a cell returns; ``savefig`` writes it to a file.

    Args:
        shown: what :func:`run`, :func:`load_results` or :func:`run_back_end` gave.
        figure: its name; ``slamcmp list figures`` shows them.
        truth: of the runs' stream (or that stream itself, of :func:`make_stream`), for errors and NEES;
            an experiment's results have theirs.

    Raises:
        UsageError: there is no such figure, or it shows what is not there; the message says what.
    """
    known = truth.truth if isinstance(truth, SourceStream) else truth
    if isinstance(shown, Results):
        if truth is not None:
            raise UsageError("plot: an experiment's results have their truth; truth= is for runs")
        return draw_figure(shown, figure)
    runs = [shown] if isinstance(shown, Run) else list(shown)
    if not all(isinstance(run, Run) for run in runs):
        raise UsageError("plot: Results, a Run, or several runs are needed")
    try:
        return draw_figure(results_of_runs(runs, known), figure)
    except UsageError as error:
        if known is not None or "truth" not in str(error):
            raise
        raise UsageError(
            f"{error}; with the truth it could be: plot(run, {figure!r}, truth=stream)"
        ) from None
