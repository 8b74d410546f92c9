"""``slamcmp table`` and ``slamcmp repro``."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from slamcmp.cli import completion

RESULTS_HELP = "A results folder, or the name of an experiment below results/."


class TableFormat(StrEnum):
    """What a table is written as."""

    latex = "latex"
    markdown = "markdown"
    csv = "csv"


class Best(StrEnum):
    """How the best of a column is marked."""

    none = "none"
    bold = "bold"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp table quickstart --format latex --columns online_ate --best bold | "
        "slamcmp table results/dial --format csv"
    )(table)
    app.command(epilog="Example: slamcmp repro results/quickstart")(repro)


def table(
    results: Annotated[str, typer.Argument(help=RESULTS_HELP, autocompletion=completion.results_folders)],
    file_format: Annotated[TableFormat, typer.Option("--format", help="What to write.")] = TableFormat.latex,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Columns of the trials table, runs, ok, failed, separated by commas; default: errors."
        ),
    ] = None,
    best: Annotated[
        Best, typer.Option(help="Mark the best of each column, and what its pairs do not tell apart from it.")
    ] = Best.none,
    intervals: Annotated[bool, typer.Option(help="95 % interval beside each median.")] = True,
    output: Annotated[Path | None, typer.Option(help="File to write to; default: standard output.")] = None,
) -> None:
    """Print an experiment's table for a paper: medians over the runs, with intervals.

    LaTeX needs the packages booktabs and siunitx. The first lines are comments with the command that makes it
    again.
    """
    from slamcmp.report.paper_table import paper_table
    from slamcmp.results.store import find_results, load_results
    from slamcmp.support.files.atomic import write_atomically

    found = load_results(find_results(results))
    names = None if columns is None else [part.strip() for part in columns.split(",") if part.strip()]
    command = shlex.join(["slamcmp", *sys.argv[1:]])
    made = paper_table(found, names, best=best is Best.bold, intervals=intervals, command=command)
    text = {TableFormat.latex: made.latex, TableFormat.markdown: made.markdown, TableFormat.csv: made.csv}[
        file_format
    ]()
    if output is None:
        print(text, end="")
    else:
        write_atomically(output, lambda file: file.write(text.encode("utf-8", "replace")))
        print(output)


def repro(
    results: Annotated[str, typer.Argument(help=RESULTS_HELP, autocompletion=completion.results_folders)],
    output: Annotated[
        Path | None, typer.Option(help="Folder to write to; default: repro in the results.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print machine-readable results only.")] = False,
) -> None:
    """Write what it takes to run an experiment again, and check it against this installation.

    The exact file (experiment.yaml, every default written out), versions (requirements.txt) and the command
    (reproduce.sh). The exit code is 1 where code or libraries here are others than those of the results.
    """
    from slamcmp.experiment.reproduction import write_reproduction
    from slamcmp.results.store import find_results, load_results

    made = write_reproduction(load_results(find_results(results)), output)
    if as_json:
        checked = [{**asdict(each), "same": each.same} for each in made.checked]
        print(
            json.dumps(
                {
                    "folder": str(made.folder),
                    "files": [str(path) for path in made.files],
                    "same": made.same,
                    "checked": checked,
                    "notes": list(made.notes),
                }
            )
        )
    else:
        for path in made.files:
            print(path)
        for each in made.checked:
            if not each.same:
                grade = "differs" if each.decides else "differs (times, last bits)"
                print(f"{grade}: {each.what}: {each.then} then, {each.now} here")
        for note in made.notes:
            print(f"note: {note}")
        same = sum(each.same for each in made.checked)
        print(
            f"{same} of {len(made.checked)} things are as they were"
            + ("" if made.same else ": not the same place")
        )
    if not made.same:
        raise typer.Exit(1)
