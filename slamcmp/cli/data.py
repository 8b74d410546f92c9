"""``slamcmp data``: published data sets, and one's own logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamcmp.cli import data_sets


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    data = typer.Typer(
        help="Get published data sets, and look into logs in plain files.",
        epilog="Example: slamcmp data check odometry.csv detections.csv truth.csv landmarks.csv",
        no_args_is_help=True,
    )
    data_sets.add_commands(data)
    data.command(epilog="Example: slamcmp data check odometry.csv detections.csv truth.csv")(check)
    app.add_typer(data, name="data")


def check(
    files: Annotated[list[Path], typer.Argument(help="Files of one log; what each holds, its columns tell.")],
    metres_per_tick: Annotated[float | None, typer.Option(help="Of wheel counts.")] = None,
    track_m: Annotated[float | None, typer.Option(help="Between the wheels.")] = None,
) -> None:
    """Say what is wrong with a log before a filter runs on it; exit code 1 where something is."""
    from slamcmp.datasets.log_checks import check_files
    from slamcmp.errors import MissingDataError
    from slamcmp.support.paths import is_file

    for path in files:
        if not is_file(path):
            raise MissingDataError(f"{path}: there is no such file")
    report = check_files(files, metres_per_tick=metres_per_tick, track_m=track_m)
    for fact in report.facts:
        print(fact)
    for finding in report.findings:
        print(f"wrong: {finding}")
    print(f"{len(report.findings)} findings" if report.findings else "nothing wrong found")
    if report.findings:
        raise typer.Exit(1)
