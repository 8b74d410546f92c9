"""A comparison of results folders as tables, as Markdown for a pull request, and as one HTML page."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import jinja2
import pandas as pd

from slamcmp.metrics.statistics import Interval
from slamcmp.results.compare.comparison import Comparison, Judgement
from slamcmp.results.compare.differences import Difference
from slamcmp.results.grid import swept_columns, value_text
from slamcmp.results.numbers import interval_text, number_text
from slamcmp.results.words import parameters_in_words

RULE = {
    "interval": "a condition holds where the whole 95 % interval is past the amount; without one (fewer than "
    "5 pairs for a ratio, 6 for a difference) the estimate decides",
    "estimate": "a condition holds where the estimate is past the amount",
}
"""What ``--fail-if`` looks at, by the evidence."""


def comparison_rows(comparison: Comparison) -> pd.DataFrame:
    """One row per metric, back end and grid point, as text."""
    rows: list[dict[str, Any]] = []
    for each in comparison.rows:
        unit = "" if each.unit == "1" else f" [{each.unit}]"
        rows.append(
            {
                "metric": f"{each.metric}{unit}",
                "back end": each.label,
                **{path: value_text(value) for path, value in each.at.items()},
                "pairs": each.pairs,
                "base": _number(each.base),
                "other": _number(each.other),
                "ratio [95 %]": _with_bounds(each.ratio),
                "difference [95 %]": _with_bounds(each.difference),
                "verdict": each.verdict,
                "failed in one": _one_sided(each.lost, each.gained),
            }
        )
    table = pd.DataFrame(rows)
    if rows and not any(table["failed in one"]):
        table = table.drop(columns="failed in one")
    return table.rename(columns=parameters_in_words(swept_columns(table)))


def difference_rows(comparison: Comparison) -> Iterator[tuple[str, Difference]]:
    """What is otherwise, with the kind it belongs to."""
    found = comparison.differences
    for kind, parts in (
        ("configuration", found.configuration),
        ("code", found.code),
        ("versions", found.versions),
    ):
        yield from ((kind, each) for each in parts)


def comparison_markdown(
    comparisons: Sequence[Comparison], judgements: Sequence[Judgement] = (), evidence: str = "interval"
) -> str:
    """For a pull request: verdict of the conditions first, the table, and folded what differs."""
    lines: list[str] = []
    for judgement in judgements:
        lines += [f"**{_judged(judgement)}**", *(f"- {_escaped(each)}" for each in judgement.because), ""]
    if judgements:
        lines += [f"*{RULE[evidence]}*", ""]
    for each in comparisons:
        lines += [f"### {_escaped(each.other)} against {_escaped(each.base)}", ""]
        lines += [*_markdown_table(comparison_rows(each)), ""]
        lines += [f"- {_escaped(text)}" for text in (*(r.sentence() for r in each.refused), *each.notes)]
        changed = [(kind, d.key, d.base, d.other) for kind, d in difference_rows(each)]
        if changed:
            table = pd.DataFrame(changed, columns=["kind", "what", "base", "other"])
            lines += ["", "<details><summary>What differs</summary>", "", *_markdown_table(table)]
            lines += ["", "</details>"]
        else:
            lines += ["", "Nothing differs in configuration, code and versions."]
        lines.append("")
    return "\n".join(lines)


def comparison_html(
    comparisons: Sequence[Comparison], judgements: Sequence[Judgement] = (), evidence: str = "interval"
) -> str:
    """One page that needs no network."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slamcmp.report"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    shown = [
        {
            "title": f"{each.other} against {each.base}",
            "headers": list(table.columns),
            "rows": table.to_numpy().tolist(),
            "remarks": [*(refusal.sentence() for refusal in each.refused), *each.notes],
            "changed": [(kind, d.key, d.base, d.other) for kind, d in difference_rows(each)],
        }
        for each in comparisons
        for table in [comparison_rows(each)]
    ]
    return environment.get_template("comparison.html.j2").render(
        comparisons=shown,
        judgements=[(_judged(each), each.fails, each.because) for each in judgements],
        rule=RULE[evidence],
    )


def _judged(judgement: Judgement) -> str:
    return f"{'FAILS' if judgement.fails else 'passes'}: {judgement.condition}"


def _number(value: float) -> str:
    return number_text(value) if value == value else "–"


def _with_bounds(interval: Interval) -> str:
    if interval.estimate != interval.estimate:
        return "–"
    bounds = interval_text(interval)
    return number_text(interval.estimate) + (f" [{bounds}]" if bounds else "")


def _one_sided(lost: Sequence[str], gained: Sequence[str]) -> str:
    parts = [f"other: {len(lost)}"] if lost else []
    return ", ".join(parts + ([f"base: {len(gained)}"] if gained else []))


def _markdown_table(table: pd.DataFrame) -> list[str]:
    if table.empty:
        return ["(nothing to compare)"]
    head = [_escaped(str(name)) for name in table.columns]
    rows = [[_escaped(str(value)) for value in row] for row in table.to_numpy().tolist()]
    return [f"| {' | '.join(each)} |" for each in (head, ["---"] * len(head), *rows)]


def _escaped(text: str) -> str:
    """Names of back ends and folders as text: neither columns, nor emphasis, nor tags, nor mentions."""
    flat = " ".join(text.split())
    return re.sub(r"([\\`*_|<>\[\]#~@])", r"\\\1", flat)
