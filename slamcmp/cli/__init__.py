"""The command line: each command calls one public function.

Nothing heavy is imported here, so that ``--help`` answers at once: commands import what they need when they
are called.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

import slamcmp
from slamcmp.cli import advise, cache, check, ensemble, frontend, run, seeds, show, stream
from slamcmp.cli.data import commands as data
from slamcmp.cli.data import noise
from slamcmp.cli.grading import assignment, grade, grade_all, regrade
from slamcmp.cli.output import equip, respect_no_color
from slamcmp.cli.results import compare, papers, report, trajectories, view, watch
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.support.messages import printable, told

app = typer.Typer(
    name="slamcmp",
    help="Filter or smooth? Compare SLAM back ends on one shared front end.",
    epilog="Example: slamcmp run quickstart",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# In the order of --help.
for _commands in (
    run,
    advise,
    ensemble,
    check,
    seeds,
    report,
    watch,
    view,
    compare,
    papers,
    show,
    stream,
    cache,
    trajectories,
    data,
    noise,
    frontend,
    assignment,
    grade,
    grade_all,
    regrade,
):
    _commands.add_commands(app)
equip(app)

_debug = False


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"slamcmp {slamcmp.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[  # noqa: ARG001
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    global _debug
    _debug = debug


def main() -> None:
    """Run the command line; exit codes: 0 ok, 1 runs failed, 2 usage, 3 missing data, 130 interrupted."""
    # Before numpy loads: several threads on small matrices only get into each other's way.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    respect_no_color()
    try:
        app()
    except SlamcmpError as error:
        if _debug:
            raise
        print(told(printable(f"slamcmp: {error}")), file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        # A name that no file can have, a folder that is one no longer: whatever it is, one line says it.
        if _debug or isinstance(error, BrokenPipeError):
            raise
        where = "" if error.filename is None else f"{error.filename}: "
        print(told(printable(f"slamcmp: {where}{error.strerror or error}")), file=sys.stderr)
        sys.exit(UsageError.exit_code)
