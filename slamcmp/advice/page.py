"""The advice as one HTML page that needs no network."""

from __future__ import annotations

import jinja2

from slamcmp.advice.advice import Advice

HEADINGS = {
    "answer": "The answer",
    "odometry": "Against odometry alone",
    "others": "The others",
    "hindsight": "With hindsight",
    "change": "What would change this",
    "failed": "What failed",
    "limits": "What this rests on",
}


def advice_html(advice: Advice) -> str:
    """Sentences by what they are about, and the table behind them."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slamcmp.advice"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    parts = [
        (heading, [each.text for each in advice.sentences if each.kind == kind])
        for kind, heading in HEADINGS.items()
    ]
    table = advice.table
    return environment.get_template("advice.html.j2").render(
        name=advice.name,
        mode="with hindsight" if advice.asked.which == "final" else "online",
        parts=[part for part in parts if part[1]],
        headers=[str(name) for name in table.columns],
        rows=table.to_numpy().tolist(),
        folder=str(advice.folder),
    )
