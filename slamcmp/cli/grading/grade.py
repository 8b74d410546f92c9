"""``slamcmp grade``: one submission against the tests of an assignment."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.errors import MissingDataError, UsageError

if TYPE_CHECKING:
    from slamcmp.grading.results.outcome import GradeOutcome

SECRET_VARIABLE = "SLAMCMP_GRADING_SECRET"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp grade ekf my_ekf.py --student ada --secret-file secret.txt")(grade)


def grade(
    assignment: Annotated[str, typer.Argument(help="Name of a shipped assignment, or a folder.")],
    submission: Annotated[Path, typer.Argument(help="A .py file, a folder, a .zip or a notebook.")],
    student: Annotated[
        str | None,
        typer.Option("--student", help="Whose it is; decides the seeds. Default: the file's name."),
    ] = None,
    secret_file: Annotated[
        Path | None, typer.Option("--secret-file", help=f"The course's secret; or set {SECRET_VARIABLE}.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="JSON file for the outcome, written after each test.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", help="HTML page for the student: no hidden test is in it.")
    ] = None,
    accept_weak_sandbox: Annotated[
        bool, typer.Option("--accept-weak-sandbox", help="Grade though hidden tests cannot be protected.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole outcome as JSON only.")] = False,
) -> None:
    """Grade one submission in a sandbox and explain what is wrong.

    Exit code 0: graded, whatever the marks are; 2: there is nothing to grade.
    """
    import json
    from dataclasses import asdict

    from slamcmp.grading.run.grader import grade as grade_submission

    if not os.path.lexists(submission):
        raise UsageError(f"{submission}: there is no such file or folder to grade")
    outcome = grade_submission(
        Path(assignment),
        submission,
        student=student or submission.stem,
        secret=read_secret(secret_file),
        out=out,
        accept_weak_sandbox=accept_weak_sandbox,
    )
    if html is not None:
        from slamcmp.grading.results.page import write_grade_page

        write_grade_page(outcome, html, audience="student")
    if as_json:
        print(
            json.dumps({**asdict(outcome), "score": outcome.score, "max_score": outcome.max_score}, indent=1)
        )
    else:
        _print(outcome)


def read_secret(secret_file: Path | None) -> bytes:
    """The course's secret from a file or the environment.

    Raises:
        MissingDataError: the file cannot be read.
        UsageError: there is no secret.
    """
    if secret_file is not None:
        try:
            return secret_file.read_bytes()
        except OSError as error:
            raise MissingDataError(f"{secret_file}: {error.strerror}") from error
    if secret := os.environ.get(SECRET_VARIABLE):
        return secret.encode()
    raise UsageError(
        "hidden seeds need a secret: name a file with --secret-file or set "
        f"{SECRET_VARIABLE}; make one with python -c 'import secrets; print(secrets.token_hex(32))'"
    )


def _print(outcome: GradeOutcome) -> None:
    from rich.console import Console
    from rich.text import Text

    from slamcmp.grading.results.student_view import clean

    console = Console()
    styles = {"passed": "green", "partial": "yellow", "skipped": "dim"}
    for test in outcome.tests:
        style = styles.get(test.status, "bold red")
        hidden = "" if test.visibility == "visible" else f"  [{test.visibility}]"
        head = f"{test.score:6.2f} / {test.max_score:g}  "
        console.print(Text.assemble(head, (test.status, style), f"  {test.number}. {test.name}{hidden}"))
        if test.message and test.status != "passed":
            for line in clean(test.message).splitlines():
                console.print(Text(f"        {line}"), soft_wrap=True)
    for note in outcome.notes:
        console.print(Text(clean(note), style="bold"))
    print(
        f"{clean(outcome.student)}: {outcome.score:.2f} of {outcome.max_score:g} points "
        f"in {outcome.assignment}, sandbox: {outcome.sandbox_level}"
    )
