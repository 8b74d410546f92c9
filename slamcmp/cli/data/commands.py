"""``slamcmp data``: published data sets, and one's own logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamcmp.cli.data import data_sets
from slamcmp.cli.data.data_convert import convert

FORMATS = (".png", ".svg", ".pdf")


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    data = typer.Typer(
        help="Get published data sets, and look into logs in plain files.",
        epilog="Example: slamcmp data check odometry.csv detections.csv truth.csv landmarks.csv",
        no_args_is_help=True,
    )
    data_sets.add_commands(data)
    data.command(epilog="Example: slamcmp data check odometry.csv detections.csv truth.csv --plot log.png")(
        check
    )
    data.command(
        epilog="Examples: slamcmp data convert odometry.csv detections.csv log.g2o --set range_sigma_m=0.05 "
        "--set bearing_sigma_rad=0.01; slamcmp data convert quickstart my_log"
    )(convert)
    app.add_typer(data, name="data")


def check(
    files: Annotated[list[Path], typer.Argument(help="Files of one log; what each holds, its columns tell.")],
    metres_per_tick: Annotated[float | None, typer.Option(help="Of wheel counts.")] = None,
    track_m: Annotated[float | None, typer.Option(help="Between the wheels.")] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="A file to draw into (.png, .svg or .pdf): gaps, offset, scales, sightings, errors."
        ),
    ] = None,
) -> None:
    """Say what is wrong with a log before a filter runs on it; exit code 1 where something is."""
    from slamcmp.datasets.plain.log_checks import check_files
    from slamcmp.errors import MissingDataError, UsageError
    from slamcmp.support.files.paths import is_file

    for path in files:
        if not is_file(path):
            raise MissingDataError(f"{path}: there is no such file")
    if plot is not None and plot.suffix not in FORMATS:
        raise UsageError(f"--plot {plot}: a file's name ends in one of {', '.join(FORMATS)}")
    report = check_files(files, metres_per_tick=metres_per_tick, track_m=track_m)
    if plot is not None:
        from slamcmp.report.figures.log_check import draw_log_check

        draw_log_check(report, plot)
        print(f"drawn: {plot}")
    for fact in report.facts:
        print(fact)
    for finding in report.findings:
        print(f"wrong: {finding}")
    print(f"{len(report.findings)} findings" if report.findings else "nothing wrong found")
    if report.findings:
        raise typer.Exit(1)
