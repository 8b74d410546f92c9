"""``slamcmp grade-all``, ``slamcmp grade-export`` and ``slamcmp gradescope-bundle``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli.grading.grade import SECRET_VARIABLE, read_secret

if TYPE_CHECKING:
    from slamcmp.grading.run.class_run import ClassResult

INTERRUPTED = 130
BAR_WIDTH = 40


class ExportFormat(StrEnum):
    """What ``grade-export`` writes."""

    html = "html"
    junit = "junit"
    gradescope = "gradescope"
    prairielearn = "prairielearn"


class Reader(StrEnum):
    """Who will read it."""

    student = "student"
    staff = "staff"


Assignment = Annotated[str, typer.Argument(help="Name of a shipped assignment, or a folder.")]
SecretFile = Annotated[
    Path | None, typer.Option("--secret-file", help=f"The course's secret; or set {SECRET_VARIABLE}.")
]
AcceptWeak = Annotated[
    bool, typer.Option("--accept-weak-sandbox", help="Grade though hidden tests cannot be protected.")
]


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        "grade-all", epilog="Example: slamcmp grade-all ekf submissions/ --secret-file secret.txt --jobs 4"
    )(grade_all)
    app.command(
        "grade-export", epilog="Example: slamcmp grade-export outcome.json --format junit --out grade.xml"
    )(grade_export)
    app.command(
        "gradescope-bundle",
        epilog="Example: slamcmp gradescope-bundle ekf --secret-file secret.txt --out autograder.zip",
    )(gradescope_bundle)


def grade_all(
    assignment: Assignment,
    folder: Annotated[Path, typer.Argument(help="One file, zip, notebook or folder a student.")],
    secret_file: SecretFile = None,
    out: Annotated[Path | None, typer.Option("--out", help="Default: grades/ASSIGNMENT.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Gradings at a time; default: one a core.")] = None,
    time_limit_s: Annotated[
        float, typer.Option(min=1, help="Seconds for one submission, all its tests.")
    ] = 900,
    rerun_failed: Annotated[
        bool, typer.Option("--rerun-failed", help="Grade again where the grader did not come to its end.")
    ] = False,
    accept_weak_sandbox: AcceptWeak = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON only.")] = False,
) -> None:
    """Grade a class, or what is left of it; writes gradebook.csv and a page for each student.

    Exit code 0: everybody has a grade; 1: some gradings did not come to their end; 130: interrupted.
    """
    from slamcmp.grading.assignment.description import load_assignment
    from slamcmp.grading.assignment.seeds import check_secret
    from slamcmp.grading.run.class_run import run_class

    checked = load_assignment(Path(assignment))
    result = run_class(
        checked.folder,
        folder,
        out or Path("grades") / checked.name,
        secret=check_secret(read_secret(secret_file)),
        entry=checked.fields.entry,
        jobs=jobs,
        accept_weak_sandbox=accept_weak_sandbox,
        rerun_failed=rerun_failed,
        time_limit_s=time_limit_s,
        progress=not as_json,
    )
    if as_json:
        print(
            json.dumps(
                {"folder": str(result.folder), "left_out": result.left_out, **result.summary.as_dict()}
            )
        )
    else:
        _print(result)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    if set(result.summary.endings) - {"ok"}:
        raise typer.Exit(1)


def grade_export(
    outcome: Annotated[Path, typer.Argument(help="What `slamcmp grade --out` or grade-all wrote.")],
    out: Annotated[Path, typer.Option("--out", help="The file to write.")],
    to: Annotated[ExportFormat, typer.Option("--format", help="The format.")] = ExportFormat.html,
    reader: Annotated[
        Reader, typer.Option("--for", help="Staff see hidden tests too (html and junit).")
    ] = Reader.student,
) -> None:
    """Write a grade as a page, as JUnit XML, or as a platform reads it."""
    from slamcmp.grading.results.gradescope import write_gradescope_results
    from slamcmp.grading.results.junit import write_junit_xml
    from slamcmp.grading.results.outcome import load_outcome
    from slamcmp.grading.results.page import write_grade_page
    from slamcmp.grading.results.prairielearn import write_prairielearn_results

    found = load_outcome(outcome)
    if to is ExportFormat.html:
        write_grade_page(found, out, audience=reader.value)
    elif to is ExportFormat.junit:
        write_junit_xml(found, out, audience=reader.value)
    elif to is ExportFormat.gradescope:
        write_gradescope_results(found, out)
    else:
        write_prairielearn_results(found, out)
    print(out)


def gradescope_bundle(
    assignment: Assignment,
    secret_file: SecretFile = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The zip to write.")] = Path("autograder.zip"),
    time_limit_s: Annotated[
        float, typer.Option(min=1, help="Seconds for one submission; less than the platform's own limit.")
    ] = 540,
    accept_weak_sandbox: AcceptWeak = False,
) -> None:
    """Write the zip that Gradescope asks for; it holds the solution and the secret."""
    from slamcmp.grading.assignment.description import load_assignment
    from slamcmp.grading.assignment.seeds import check_secret
    from slamcmp.grading.run.bundle import write_bundle

    path = write_bundle(
        load_assignment(Path(assignment)).folder,
        out,
        secret=check_secret(read_secret(secret_file)),
        accept_weak_sandbox=accept_weak_sandbox,
        time_limit_s=time_limit_s,
    )
    print(f"{path} ({path.stat().st_size / 1e6:.1f} MB): upload it as the assignment's autograder")


def _print(result: ClassResult) -> None:
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    summary = result.summary
    console.print(f"{summary.graded} of {summary.submissions} graded ({result.reused} from earlier runs)")
    if summary.quartiles is not None and summary.mean is not None:
        low, lower, middle, upper, high = summary.quartiles
        console.print(
            f"percent of the points: median {middle:.1f}, mean {summary.mean:.1f}, "
            f"quartiles {lower:.1f} to {upper:.1f}, range {low:.1f} to {high:.1f}"
        )
        most = max(summary.histogram)
        for index, count in enumerate(summary.histogram):
            width = 100 // len(summary.histogram)
            bar = "█" * round(BAR_WIDTH * count / most)
            console.print(f"  {index * width:3d} to {(index + 1) * width:3d} {count:4d} {bar}")
    if summary.failures:
        console.print("most frequent failures:")
    for failure in summary.failures:
        share = f"{_counted(failure.submissions, 'submission')}, {100 * failure.lost:.0f} % of its points"
        console.print(f"  {failure.test}: {share}")
        if failure.message:
            console.print(
                f"      {_counted(failure.message_count, 'time')}: {failure.message}", soft_wrap=True
            )
    if result.left_out:
        console.print(f"hidden, not graded: {', '.join(result.left_out)}", soft_wrap=True)
    for row in result.rows:
        if row.ended not in ("ok", "pending"):
            console.print(f"grader {row.ended}: {row.student}", soft_wrap=True)
    console.print(f"gradebook: {result.folder / 'gradebook.csv'}", soft_wrap=True)
    console.print(f"the class: {result.folder / 'class.html'}", soft_wrap=True)


def _counted(count: int, name: str) -> str:
    return f"{count} {name}" if count == 1 else f"{count} {name}s"
