"""``slamcmp handout`` for students, ``slamcmp assignment …`` for those who write and grade."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from slamcmp.grading.run.publish import GateStep


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp handout ekf my_ekf")(handout)
    staff = typer.Typer(
        name="assignment",
        help="For staff: write an assignment, and try it before students do.",
        epilog="Example: slamcmp assignment export ~/course/assignments",
        no_args_is_help=True,
    )
    staff.command(epilog="Example: slamcmp assignment new wheel_odometry ~/course")(new)
    staff.command(epilog="Example: slamcmp assignment verify ~/course/wheel_odometry --seeds 10")(verify)
    staff.command("reference", epilog="Example: slamcmp assignment reference > keys.md")(print_reference)
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


def new(
    name: Annotated[str, typer.Argument(help="Also what students' file is called, without .py.")],
    folder: Annotated[Path, typer.Argument(help="A folder NAME is made in it.")],
) -> None:
    """Write a small assignment that passes `verify`, to change step by step (docs/writing-assignments.md)."""
    from slamcmp.grading.assignment.skeleton import write_skeleton

    for file in write_skeleton(name, folder):
        print(file)
    print(f"try it: slamcmp assignment verify {folder / name}")


def verify(
    assignment: Annotated[str, typer.Argument(help="Name of an assignment, or its folder.")],
    seeds: Annotated[int, typer.Option(min=1, help="Students whose data the solution has to solve.")] = 3,
    mutants: Annotated[
        int | None, typer.Option(min=0, help="Known mistakes to grade, drawn; default: all.")
    ] = None,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="Without a sandbox: quicker, and says nothing of its limits.")
    ] = False,
    accept_weak_sandbox: Annotated[
        bool, typer.Option("--accept-weak-sandbox", help="Also where hidden tests cannot be protected.")
    ] = False,
) -> None:
    """Grade what is known of an assignment: solution, starter, idle submissions, known mistakes.

    Exit code 0: ready to publish; 1: something does not earn what it should, and it is told what.
    """
    import resource

    from rich.console import Console

    from slamcmp.grading.run.publish import gate

    console = Console(highlight=False, markup=False, soft_wrap=True)
    steps = gate(
        assignment,
        seeds=seeds,
        mutants=mutants,
        sandboxed=not in_process,
        accept_weak_sandbox=accept_weak_sandbox,
    )
    done = []
    console.print(f"{'':4} {'submission':44} {'should earn':>12} {'earns':>7} {'time':>8}")
    for step in steps:
        _print_step(console, step)
        done.append(step)
    faults = sum(len(step.findings) for step in done)
    graded = [step.seconds for step in done if step.earned is not None]
    # Of this process and of the sandboxes it started; Linux counts in KiB.
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    memory = max(resource.getrusage(who).ru_maxrss for who in users) / 1024
    console.print(f"longest grading {max(graded):.1f} s; most memory of a process {memory:.0f} MB")
    print("ready to publish" if not faults else f"{faults} {'fault' if faults == 1 else 'faults'}")
    if faults:
        raise typer.Exit(1)


def print_reference() -> None:
    """Print all keys of assignment.yaml and mutants.yaml, with every kind of test, as Markdown."""
    from slamcmp.grading.assignment.reference import reference

    print(reference(), end="")


def export(
    folder: Annotated[Path, typer.Argument(help="A new folder.")],
) -> None:
    """Copy the shipped assignments with their solutions and hidden tests, to grade without a checkout."""
    from slamcmp.grading.assignment.handout import STAFF_VARIABLE, export_staff

    for path in export_staff(folder):
        print(path)
    print(f"to grade with them where slamcmp is installed: export {STAFF_VARIABLE}={folder.resolve()}")


def _print_step(console: Console, step: GateStep) -> None:
    earned = "" if step.earned is None else f"{step.earned:.4g}"
    mark = "FAIL" if step.findings else "ok"
    console.print(f"{mark:4} {step.who:44} {step.wanted:>12} {earned:>7} {step.seconds:6.1f} s")
    for finding in step.findings:
        console.print("     " + finding.what.replace("\n", "\n     "))
