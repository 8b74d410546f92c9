"""``slamcmp plot`` and ``slamcmp report``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

RESULTS_HELP = "A results folder, or the name of an experiment below results/."


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp plot results/quickstart --figure map --format png")(plot)
    app.command(epilog="Example: slamcmp report results/quickstart")(report)


def plot(
    results: Annotated[str, typer.Argument(help=RESULTS_HELP)],
    figure: Annotated[
        list[str] | None, typer.Option(help="Name of a figure, repeatable; default: all that apply.")
    ] = None,
    formats: Annotated[str, typer.Option("--format", help="Formats, separated by commas.")] = "png,svg",
) -> None:
    """Draw an experiment's figures into its results folder."""
    from slamcmp.errors import UsageError
    from slamcmp.report import draw_figures
    from slamcmp.results.partial import missing_runs
    from slamcmp.results.store import find_results, load_results

    wanted = tuple(part.strip() for part in formats.split(","))
    unknown = [name for name in wanted if name not in ("png", "svg", "pdf")]
    if unknown:
        raise UsageError(f"--format {formats}: {unknown[0]!r} is not one of png, svg, pdf")
    found = load_results(find_results(results))
    missing = missing_runs(found)
    if missing is not None:
        print(f"{found.folder}: {missing.sentence()}", file=sys.stderr)
    names = figure or found.manifest["config"].get("figures")
    drawn = draw_figures(found, names, found.folder / "figures", wanted)
    for path in drawn:
        print(path)
    for name, reason in drawn.skipped.items():
        print(f"{name}: not drawn: {reason}", file=sys.stderr)


def report(results: Annotated[str, typer.Argument(help=RESULTS_HELP)]) -> None:
    """Write an experiment's report as one HTML file that needs no network."""
    from slamcmp.report import write_report
    from slamcmp.results.partial import missing_runs
    from slamcmp.results.store import find_results, load_results

    found = load_results(find_results(results))
    missing = missing_runs(found)
    if missing is not None:
        print(f"{found.folder}: {missing.sentence()}", file=sys.stderr)
    print(write_report(found, found.folder / "report.html"))
