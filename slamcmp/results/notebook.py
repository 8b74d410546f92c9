"""Results as a notebook shows them: what ran, what is missing, and the key figures."""

from __future__ import annotations

import pandas as pd

from slamcmp.results.answers.answer import answer
from slamcmp.results.grid import swept_columns, value_text
from slamcmp.results.judgements.summary import summary_columns, summary_table
from slamcmp.results.numbers import number_text
from slamcmp.results.partial import missing_runs
from slamcmp.results.store import Results
from slamcmp.types.html import facts_html, rows_html

KEY_FIGURES = (
    "online_ate",
    "final_ate",
    "online_pose_nees",
    "nis_per_dof",
    "chi2_per_dof",
    "update_median_ms",
)
MOST_ROWS = 40
MOST_LINES = 8


def results_html(results: Results) -> str:
    """A few facts, and medians over the runs that are ok."""
    told = answer(results)
    facts = [
        ("question", str(results.manifest.get("question") or "")),
        ("answer", told.text),
        *(("over the sweep", line) for line in told.lines[:MOST_LINES]),
        ("runs", run_counts(results)),
    ]
    missing = missing_runs(results)
    if missing is not None:
        facts.append(("missing", missing.sentence()))
    session = results.manifest.get("in_session")
    if session:
        facts.append(
            ("in the session's process", f"{', '.join(session)}: without a memory limit, not resumable")
        )
    facts.append(("folder", str(results.folder)))
    title = str(results.manifest.get("name") or results.folder.name)
    return facts_html(title, [fact for fact in facts if fact[1]]) + _key_figures(results)


def run_counts(results: Results) -> str:
    """``20: 18 ok, 2 diverged``."""
    counts = results.trials["status"].value_counts(sort=False)
    parts = [f"{count} {status}" for status, count in counts.items()]
    return f"{len(results.trials)}{': ' if parts else ''}{', '.join(parts)}"


def _key_figures(results: Results) -> str:
    if results.trials.empty:
        return ""
    table = summary_table(results)
    figures = [column.full_header for column in summary_columns(results) if column.name in KEY_FIGURES]
    keys = ["back end", *swept_columns(results.trials), "runs", "ok", "failed"]
    shown = [name for name in [*keys, *figures] if name in table]
    rows = [[_text(row[name], name in figures) for name in shown] for row in table.to_dict("records")]
    more = f"<p>… and {len(rows) - MOST_ROWS} more</p>" if len(rows) > MOST_ROWS else ""
    return rows_html(shown, rows[:MOST_ROWS]) + more


def _text(value: object, is_figure: bool) -> str:
    if is_figure:
        return "–" if pd.isna(value) else number_text(float(value))  # type: ignore[call-overload, arg-type]
    return value_text(value)
