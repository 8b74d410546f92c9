"""``slamcmp compare``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamcmp.cli import completion

if TYPE_CHECKING:
    from slamcmp.results.compare.comparison import Comparison, Judgement


class Format(StrEnum):
    """What a comparison is written as."""

    text = "text"
    json = "json"
    markdown = "markdown"
    html = "html"


class Evidence(StrEnum):
    """What a condition looks at."""

    interval = "interval"
    estimate = "estimate"


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    app.command(
        epilog="Examples: slamcmp compare results/before results/after | slamcmp compare before after "
        "--fail-if 'online_ate worse by 5%' --format markdown --output comment.md"
    )(compare)


def compare(
    base: Annotated[
        str,
        typer.Argument(
            help="Results folder, or a name below results/: what was before.",
            autocompletion=completion.results_folders,
        ),
    ],
    others: Annotated[
        list[str],
        typer.Argument(
            help="One or more that are held against it.", autocompletion=completion.results_folders
        ),
    ],
    metric: Annotated[
        list[str] | None,
        typer.Option(
            help="Column of the trials table, repeatable; default: the errors.",
            autocompletion=completion.metrics,
        ),
    ] = None,
    back_end: Annotated[
        list[str] | None, typer.Option(help="Label of the base, repeatable; default: all.")
    ] = None,
    pair: Annotated[
        list[str] | None, typer.Option(help="BASE=OTHER: labels that belong together, repeatable.")
    ] = None,
    fail_if: Annotated[
        list[str] | None,
        typer.Option(
            help="Exit with 1 if so, repeatable: 'METRIC worse|better|differs by X%' or '… by X UNIT'."
        ),
    ] = None,
    evidence: Annotated[
        Evidence,
        typer.Option(
            help="A condition needs the whole 95 % interval past the amount, or the estimate alone."
        ),
    ] = Evidence.interval,
    output_format: Annotated[Format, typer.Option("--format", help="What to write.")] = Format.text,
    output: Annotated[Path | None, typer.Option(help="File to write to; default: standard output.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
) -> None:
    """Hold results folders of two commits or configurations against each other, run by run.

    Runs are paired where grid point, seed and back end are the same and both ran on the same stream (its
    digest); what cannot be paired is refused with the reason. Ratio and difference are other against base,
    with 95 % intervals over the pairs; what they do not tell apart is a tie.

    With --fail-if the exit code is 1 where a condition holds: by default where the whole interval is past the
    amount, or, where there are too few pairs for an interval, the estimate is. Runs that finished in the base
    only count as worse.
    """
    from slamcmp.errors import UsageError
    from slamcmp.metrics import metric_columns
    from slamcmp.report.comparison import comparison_html, comparison_markdown
    from slamcmp.results.compare.comparison import DEFAULT_METRICS, compare_results, judge_condition
    from slamcmp.results.compare.conditions import parse_condition
    from slamcmp.results.store import find_results, load_results
    from slamcmp.support.files.atomic import write_atomically

    conditions = [parse_condition(text, metric_columns()) for text in fail_if or ()]
    names = _pairs(pair or ())
    before, *after = [load_results(find_results(each)) for each in (base, *others)]
    asked = list(metric or ())
    if metric:
        asked = list(dict.fromkeys([*asked, *(each.metric for each in conditions)]))
    elif any(each.metric not in DEFAULT_METRICS for each in conditions):
        there = [
            name
            for name in DEFAULT_METRICS
            if all(name in each.trials and each.trials[name].notna().any() for each in (before, *after))
        ]
        asked = list(dict.fromkeys([*there, *(each.metric for each in conditions)]))
    found, refused = [], []
    for each in after:
        try:
            found.append(compare_results(before, each, asked, back_ends=back_end, names=names))
        except UsageError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    judgements = [judge_condition(each, found, evidence.value) for each in conditions]
    kind = Format.json if as_json else output_format
    if kind is Format.text and output is None:
        _print(found, judgements, evidence)
    else:
        texts = {
            Format.json: lambda: _json(found, judgements, evidence),
            Format.html: lambda: comparison_html(found, judgements, evidence.value),
        }
        text = texts.get(kind, lambda: comparison_markdown(found, judgements, evidence.value))()
        if output is None:
            print(text)
        else:
            write_atomically(output, lambda file: file.write(text.encode("utf-8", "replace")))
            print(output)
    if refused:
        # Those that can be compared stand above; that one cannot is a mistake of the line all the same.
        raise UsageError("; ".join(map(str, refused)))
    if any(each.fails for each in judgements):
        raise typer.Exit(1)


def _pairs(given: Sequence[str]) -> dict[str, str]:
    from slamcmp.errors import UsageError

    found = {}
    for text in given:
        ours, sign, theirs = text.partition("=")
        if not (ours and sign and theirs):
            raise UsageError(f"--pair {text!r}: expected BASE=OTHER, two labels of back ends")
        found[ours] = theirs
    return found


def _json(found: Sequence[Comparison], judgements: Sequence[Judgement], evidence: Evidence) -> str:
    from slamcmp.cli.run import json_value

    content = {
        "evidence": evidence.value,
        "comparisons": [asdict(each) for each in found],
        "fail_if": [asdict(each) for each in judgements],
        "fails": any(each.fails for each in judgements),
    }
    return json.dumps(json_value(content), indent=2, default=str, allow_nan=False)


def _print(found: Sequence[Comparison], judgements: Sequence[Judgement], evidence: Evidence) -> None:
    from slamcmp.cli.run import print_table
    from slamcmp.report.comparison import RULE, comparison_rows, difference_rows

    for each in found:
        print(f"{each.other} against {each.base}")
        changed = list(difference_rows(each))
        for kind, difference in changed:
            print(f"  {kind}: {difference.key}: {difference.base} → {difference.other}")
        if not changed:
            print("  nothing differs in configuration, code and versions")
        print_table(comparison_rows(each), upright_rows=0)
        for refusal in each.refused:
            print(f"not compared: {refusal.sentence()}")
        for note in each.notes:
            print(f"note: {note}")
    for judgement in judgements:
        print(f"{'FAILS' if judgement.fails else 'passes'}: {judgement.condition}")
        for reason in judgement.because:
            print(f"  {reason}")
    if judgements:
        print(f"({RULE[evidence.value]})")
