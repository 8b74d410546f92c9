"""``slamcmp handout`` for students, ``slamcmp assignment …`` for those who write and grade."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp handout ekf my_ekf")(handout)
    staff = typer.Typer(
        name="assignment",
        help="For staff: write an assignment, and try it before students do.",
        epilog="Example: slamcmp assignment export ~/course/assignments",
        no_args_is_help=True,
    )
    staff.command(epilog="Example: slamcmp assignment export ~/course/assignments")(export)
    app.add_typer(staff)


def handout(
    name: Annotated[str, typer.Argument(help="One of `slamcmp list assignments`.")],
    folder: Annotated[Path, typer.Argument(help="Where its files go.")],
) -> None:
    """Write an assignment's handout, starter and public tests into a folder, to work there."""
    from slamcmp.grading.assignment.handout import find_handout, write_handout

    files = write_handout(name, folder)
    entry = folder / find_handout(name).entry
    for file in files:
        print(file)
    print(f"read {folder / 'README.md'}, fill in {entry}, and try it: slamcmp check {entry}")


def export(
    folder: Annotated[Path, typer.Argument(help="A new folder.")],
) -> None:
    """Copy the shipped assignments with their solutions and hidden tests, to grade without a checkout."""
    from slamcmp.grading.assignment.handout import STAFF_VARIABLE, export_staff

    for path in export_staff(folder):
        print(path)
    print(f"to grade with them where slamcmp is installed: export {STAFF_VARIABLE}={folder.resolve()}")
