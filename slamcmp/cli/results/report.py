"""``slamcmp plot`` and ``slamcmp report``."""

from __future__ import annotations

import sys
from enum import StrEnum
from typing import Annotated

import typer

from slamcmp.cli import completion
from slamcmp.cli.output import answer, is_quiet
from slamcmp.cli.run import COLUMNS_HELP, show_page

RESULTS_HELP = "A results folder, or the name of an experiment below results/."


class FigureStyle(StrEnum):
    """Where a figure is to stand."""

    page = "page"
    paper = "paper"
    slide = "slide"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp plot results/quickstart --figure map --format png | "
        "slamcmp plot quickstart --figure dial --style paper --width 88mm --format pdf"
    )(plot)
    app.command(epilog="Example: slamcmp report results/quickstart --columns online_ate,final_ate --open")(
        report
    )


def plot(
    results: Annotated[str, typer.Argument(help=RESULTS_HELP, autocompletion=completion.results_folders)],
    figure: Annotated[
        list[str] | None,
        typer.Option(
            help="Name of a figure, repeatable; default: all that apply.", autocompletion=completion.figures
        ),
    ] = None,
    formats: Annotated[str, typer.Option("--format", help="Formats, separated by commas.")] = "png,svg",
    width: Annotated[str | None, typer.Option(help="Of the figure, e.g. 88mm, 3.5in, 252pt.")] = None,
    font: Annotated[str | None, typer.Option(help="Family that this machine has, e.g. serif.")] = None,
    look: Annotated[
        FigureStyle,
        typer.Option("--style", help="Sizes of letters and lines: page, paper, slide."),
    ] = FigureStyle.page,
    panel: Annotated[str, typer.Option(help="all, or one panel by its number from 1 on.")] = "all",
) -> None:
    """Draw an experiment's figures into its results folder.

    With a width panels of a row go below one another where they would be too narrow, and titles are broken
    into lines. --style paper has letters of 8 points for a column of a paper, --style slide of 18 points at
    the width of a slide; both have Type 42 fonts in PDF and text as text in SVG.
    """
    from slamcmp.errors import UsageError
    from slamcmp.report import draw_figures
    from slamcmp.report.figures.look import Look, check_font, parse_width
    from slamcmp.results.partial import missing_runs
    from slamcmp.results.store import find_results, load_results

    chosen = Look(
        look.value,
        None if width is None else parse_width(width),
        None if font is None else check_font(font),
        _panel(panel),
    )
    wanted = tuple(part.strip() for part in formats.split(","))
    unknown = [name for name in wanted if name not in ("png", "svg", "pdf")]
    if unknown:
        raise UsageError(f"--format {formats}: {unknown[0]!r} is not one of png, svg, pdf")
    found = load_results(find_results(results))
    missing = missing_runs(found)
    if missing is not None and not is_quiet():
        print(f"{found.folder}: {missing.sentence()}", file=sys.stderr)
    names = figure or found.manifest["config"].get("figures")
    drawn = draw_figures(found, names, found.folder / "figures", wanted, chosen)
    answer(files=[str(path) for path in drawn], skipped=dict(drawn.skipped))
    for path in drawn:
        print(path)
    for name, reason in drawn.skipped.items() if not is_quiet() else ():
        print(f"{name}: not drawn: {reason}", file=sys.stderr)


def _panel(text: str) -> int | None:
    from slamcmp.errors import UsageError

    if text == "all":
        return None
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise UsageError(f"--panel {text}: all, or a number from 1 on")
    return int(text)


def report(
    results: Annotated[str, typer.Argument(help=RESULTS_HELP, autocompletion=completion.results_folders)],
    columns: Annotated[str | None, typer.Option(help=COLUMNS_HELP)] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
) -> None:
    """Write an experiment's report as one HTML file that needs no network."""
    from slamcmp.report import write_report
    from slamcmp.report.html import NOT_ON_THE_PAGE
    from slamcmp.results.judgements.summary import checked_columns, with_columns
    from slamcmp.results.partial import missing_runs
    from slamcmp.results.store import find_results, load_results

    chosen = [] if columns is None else [name.strip() for name in columns.split(",")]
    checked_columns(chosen, "--columns")
    found = load_results(find_results(results), without=NOT_ON_THE_PAGE)
    missing = missing_runs(found)
    if missing is not None and not is_quiet():
        print(f"{found.folder}: {missing.sentence()}", file=sys.stderr)
    path = write_report(with_columns(found, chosen) if chosen else found, found.folder / "report.html")
    answer(file=str(path))
    print(path)
    if open_page:
        show_page(path)
