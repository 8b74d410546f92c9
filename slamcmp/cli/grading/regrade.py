"""``slamcmp regrade``: other weights, late hand-ins and attempts, without running anybody's code again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from slamcmp.errors import UsageError


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(epilog="Example: slamcmp regrade grades/ekf --rules rules.yaml --submitted submitted.csv")(
        regrade
    )


def regrade(
    results: Annotated[Path, typer.Argument(help="Results folder of `slamcmp grade-all`.")],
    rules: Annotated[
        Path | None, typer.Option("--rules", help="YAML: points of tests, what late and attempts cost.")
    ] = None,
    submitted: Annotated[
        Path | None, typer.Option("--submitted", help="CSV: student, late_h, attempts.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Default: RESULTS/regraded.")] = None,
) -> None:
    """Write gradebook, summary and class page anew by other rules; nothing that was graded is changed."""
    from slamcmp.grading.results.class_page import write_class_page
    from slamcmp.grading.results.class_results import read_class
    from slamcmp.grading.results.class_summary import summarise
    from slamcmp.grading.results.gradebook import write_gradebook
    from slamcmp.grading.results.rules import RulesFields, load_rules, load_submitted, regraded
    from slamcmp.support.files.atomic import write_atomically

    if rules is None and submitted is None:
        raise UsageError("give --rules, --submitted, or both: without them the grades are what they are")
    folder = out or results / "regraded"
    if folder.resolve() == results.resolve():
        raise UsageError(f"--out {folder}: is where the grades are; name another folder, they are kept")
    rows = read_class(results)
    graded = [row.outcome for row in rows if row.outcome is not None]
    if not graded:
        raise UsageError(f"{results}: nobody is graded yet")
    # A grading that was stopped has not met all tests.
    tests = max((outcome.tests for outcome in graded), key=len)
    wanted = RulesFields() if rules is None else load_rules(rules, [test.name for test in tests])
    known = {} if submitted is None else load_submitted(submitted, [row.student for row in rows])
    rows = regraded(rows, wanted, known)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder}: {error.strerror}; a folder to write into is needed") from error
    write_gradebook(rows, folder / "gradebook.csv")
    text = json.dumps(summarise(rows).as_dict(), indent=1) + "\n"
    write_atomically(folder / "summary.json", lambda file: file.write(text.encode()))
    write_class_page(rows, folder / "class.html")
    print(f"{len(graded)} of {len(rows)} by the rules: {folder / 'gradebook.csv'}, {folder / 'class.html'}")
