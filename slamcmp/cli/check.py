"""``slamcmp check``: does a back end do what every back end must, and does a file pass its public tests?"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.errors import UsageError

if TYPE_CHECKING:
    from slamcmp.experiment.conformance.check import Finding


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp check my_backend.py:MyEkf | slamcmp check isam2 --set relinearize_skip=10 "
        "| slamcmp check ekf.py"
    )(check)


def check(
    back_end: Annotated[
        str,
        typer.Argument(
            help="A registered name, or FILE.py:CLASS for your own; FILE.py alone runs the public_tests.py "
            "of an assignment that lies beside it."
        ),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the back end; may be repeated."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON only.")] = False,
) -> None:
    """Check that a back end is finite, causal, deterministic, consistent, and in the right chart.

    Exit code 0: it has every property; 1: it lacks some, and the likely cause is printed.
    """
    findings = _findings(back_end, settings or [])
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        _print(back_end, findings)
    if not all(finding.passed for finding in findings):
        raise typer.Exit(1)


def _findings(back_end: str, settings: list[str]) -> list[Finding]:
    if back_end.endswith(".py"):
        from slamcmp.grading.assignment.public_tests import run_public_tests

        if settings:
            raise UsageError(f"--set: {back_end} is no back end; FILE.py:CLASS would be one")
        return run_public_tests(Path(back_end))
    from slamcmp.experiment.conformance.check import check_back_end

    return check_back_end(back_end, _parameters(back_end, settings))


def _parameters(back_end: str, settings: list[str]) -> dict[str, Any]:
    """The back end's keyword arguments from ``name=value`` texts, checked as a configuration's are."""
    from pydantic import ValidationError
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    from slamcmp.registry import back_ends
    from slamcmp.support.configuration.plugin_models import bind_parameters

    given = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise UsageError(f"--set {setting!r}: NAME=VALUE is needed, e.g. --set relinearize_skip=10")
        try:
            given[name] = YAML(typ="safe").load(value)
        except YAMLError as error:
            what = (getattr(error, "problem", None) or str(error)).replace("\n", " ")
            raise UsageError(f"--set {setting!r}: {value!r} is not a YAML value: {what}") from error
    plugin = back_ends.get(back_end)
    try:
        return bind_parameters(plugin, given)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise UsageError(f"back end {back_end!r}: {faults}") from error


def _print(back_end: str, findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console()
    for finding in findings:
        mark, style = ("ok  ", "green") if finding.passed else ("FAIL", "bold red")
        console.print(Text.assemble((mark, style), f" {finding.check}"))
        message = finding.message.replace("\n", "\n     ")
        console.print(Text(f"     {message}", style="" if not finding.passed else "dim"))
    failed = sum(not finding.passed for finding in findings)
    if failed:
        print(f"{back_end}: {failed} of {len(findings)} checks failed")
    else:
        print(f"{back_end}: all {len(findings)} checks passed")
