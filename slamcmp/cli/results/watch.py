"""``slamcmp watch``."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from slamcmp.cli import completion
from slamcmp.cli.output import answer, is_quiet
from slamcmp.errors import MissingDataError, UsageError


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp watch results/quickstart")(watch)


def watch(
    results: Annotated[
        str,
        typer.Argument(
            help="A results folder that is being written, or its name below results/.",
            autocompletion=completion.results_folders,
        ),
    ],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; default: a free one.")] = 0,
    every: Annotated[float, typer.Option(min=0.5, help="Seconds between two looks.")] = 2.0,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the address only.")] = False,
) -> None:
    """Show an experiment while it runs: a page on this machine that refreshes, and ends as the report.

    Start it beside slamcmp run, from another terminal; Ctrl-C ends it and leaves the experiment alone.
    """
    from slamcmp.report.watch import watch_server

    folder = _folder(results)
    try:
        server = watch_server(folder, port, every)
    except OSError as error:
        raise UsageError(f"--port {port}: {error.strerror or error}; leave it out for a free one") from error
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    answer(address=address, folder=str(folder))
    print(address, flush=True)
    if not no_open and not webbrowser.open(address) and not is_quiet():
        print("no browser was found: open the address in one", file=sys.stderr)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    finally:
        server.server_close()


def _folder(results: str) -> Path:
    """The folder of that name.

    Raises:
        MissingDataError: no experiment has begun there.
    """
    for folder in (Path(results), Path("results") / results):
        if (folder / ".lock").is_file() or (folder / "manifest.json").is_file():
            return folder.resolve()
    raise MissingDataError(f"{results}: no experiment has begun there; slamcmp run starts one")
