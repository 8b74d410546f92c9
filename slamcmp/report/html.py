"""The report: one HTML file that needs no network, no server and no other file."""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup

from slamcmp.registry import figures as registry_figures
from slamcmp.report.cautions import cautions
from slamcmp.report.faults import fault_table
from slamcmp.report.figures.draw import Drawn, each_figure, fault_text, figure_bytes
from slamcmp.report.live import live_captions, live_data, live_figures, packed, plotly_script
from slamcmp.report.published import order_rows, value_rows
from slamcmp.report.tables import Cell, PageTable, cell, cell_rows, page_table, swept_cell, without_empty
from slamcmp.results.answers.answer import answer
from slamcmp.results.answers.sweep_matrix import sweep_matrices
from slamcmp.results.grid import grid_points, middle_point, point_name, reference_name, swept_columns
from slamcmp.results.judgements.certainty import certainty_table
from slamcmp.results.judgements.summary import paired_table, summary_columns, summary_intervals, summary_table
from slamcmp.results.judgements.unfinished import unfinished_runs
from slamcmp.results.judgements.verdict import judge
from slamcmp.results.numbers import interval_text
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words
from slamcmp.support.files.atomic import write_atomically

NOT_ON_THE_PAGE = ("digest", "back_end")
"""Columns of the frames' table that take room and that the page reads nowhere: the trials' table has them."""
MOST_RUNS = 1500
"""Rows of the table of runs on the page: a browser sorts no more at once, and the page stays under 8 MB."""
SVG_LIMIT = 300_000
"""Bytes above which a figure goes in as PNG: a long log's SVG makes the page slow."""


@dataclass(frozen=True)
class ReportFigure:
    """A figure as the page embeds it."""

    name: str
    title: str
    caption: str
    sources: tuple[str, ...]
    """Data URIs: one, or those of its panels."""
    reason: str
    table: PageTable | None = None
    """Its numbers, where it has them."""


def write_report(results: Results, path: Path | str) -> Path:
    """Write the report of a results folder to ``path`` and return it.

    Raises:
        StorageError: the disk is full or the folder cannot be written; an older report is untouched.
    """
    path = Path(path)
    # The name of a folder or a file, which the page tells, need not be valid Unicode.
    page = report_html(results).encode("utf-8", "replace")
    write_atomically(path, lambda file: file.write(page))
    return path


def report_html(results: Results) -> str:
    """The page as text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slamcmp.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    columns = summary_columns(results)
    summary = summary_table(results)
    faults, more_faults = fault_table(results)
    swept = swept_columns(results.trials)
    words = parameters_in_words(swept)
    unfinished, more_unfinished = unfinished_runs(results)
    manifest = results.manifest
    verdict = judge(results)
    published = [] if verdict is None else [value_rows(verdict), order_rows(verdict)]
    names = manifest.get("config", {}).get("figures")
    shown = [_embed(drawn) for drawn in each_figure(results, names)]
    live = live_figures(results)
    alive = {name: data for name, data in live.items() if names is None or name in names}
    plotly = plotly_script() if alive else ""
    script = _script(live_data(results, alive), plotly)
    return environment.get_template("report.html.j2").render(
        script=Markup(script),
        script_sources=Markup(" ".join(map(_source_hash, filter(None, (script, plotly))))),
        name=manifest.get("name", results.folder.name),
        question=manifest.get("question") or "",
        description=manifest.get("description") or "",
        reference=reference_name(results),
        answer=answer(results),
        matrices=sweep_matrices(results),
        cautions=cautions(results),
        unfinished=unfinished,
        more_unfinished=more_unfinished,
        key_headers=[
            words.get(name, name)
            for name in summary.columns
            if name not in {column.full_header for column in columns}
        ],
        alike=_alike(summary),
        groups=_groups([column.group for column in columns]),
        columns=columns,
        summary_rows=_with_intervals(cell_rows(summary, swept), list(summary.columns), results),
        search=_search_text(manifest),
        verdict=verdict,
        published=[page_table(table, swept) for table in published if len(table)],
        certainty=page_table(certainty_table(results), swept),
        faults=page_table(faults, swept),
        more_faults=more_faults,
        paired=page_table(paired_table(results), swept),
        figures=[figure for figure in shown if figure.sources],
        alive=alive,
        live_captions=live_captions(live, results),
        sparsity_caption=registry_figures.get("sparsity").traits["caption"],
        middle=_middle(results),
        recorded="recording" in results.trials,
        skipped=[figure for figure in shown if not figure.sources],
        trials=without_empty(PageTable(_trial_headers(results), _trial_rows(results))),
        more_trials=max(0, len(results.trials) - MOST_RUNS),
        facts=_facts(manifest),
        versions=sorted(manifest.get("versions", {}).items()),
        config=json.dumps(manifest.get("config", {}), indent=2, default=str, ensure_ascii=False),
    )


def _middle(results: Results) -> str:
    """The grid point in the middle of what was swept, in words; empty where nothing was."""
    swept = len(grid_points(results.trials)) > 1
    return point_name(middle_point(results)) if swept else ""


def _script(live: str, plotly: str) -> str:
    """The page's own script with the data of its figures; plotly.js is in it, packed, where any needs it."""
    folder = importlib.resources.files("slamcmp.report").joinpath("templates")
    parts = [folder.joinpath("page.js").read_text("utf-8")]
    if plotly:
        data = f'const live = {live};\nconst packed = "{packed(plotly)}";\n'
        parts += [data, folder.joinpath("live.js").read_text("utf-8")]
    return "".join(parts)


def _source_hash(script: str) -> str:
    """As a content security policy names the scripts that may run: no other one can."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def _alike(table: pd.DataFrame) -> list[int]:
    """Positions of the columns that say the same in every row: a reader may leave them out."""
    if len(table) < 2:
        return []
    return [
        index
        for index, name in enumerate(table.columns)
        if index and table[name].map(lambda value: cell(value).text).nunique() == 1
    ]


def _with_intervals(rows: list[list[Cell]], names: list[str], results: Results) -> list[list[Cell]]:
    """The summary's rows with the interval of each median below it."""
    return [
        [
            replace(shown, note=interval_text(known[name])) if name in known else shown
            for name, shown in zip(names, row, strict=True)
        ]
        for row, known in zip(rows, summary_intervals(results), strict=True)
    ]


def _search_text(manifest: Mapping[str, Any]) -> str:
    """How the search for enough seeds ended; empty where the experiment did none."""
    search = manifest.get("until")
    if not search:
        return ""
    asked = f"{100 * search['half_width']:g} %" if search["relative"] else f"{search['half_width']:g}"
    confidence = f"{100 * search['confidence']:g} %"
    coverage = search.get("coverage")
    real = f": about {100 * coverage:.0f} %" if coverage is not None else ""
    return (
        f"Seeds were added in batches of {search['batch']} until the {confidence} interval of the "
        f"{search['statistic']} of {search['metric']} is within ±{asked}, at most "
        f"{search['max_seeds']} seeds: {search['reason']}. The rule looks at widths only, not at who is "
        f"ahead; an interval that ends a search still holds the median a little less often{real}."
    )


def _embed(drawn: Drawn) -> ReportFigure:
    sources: tuple[str, ...] = ()
    if drawn.figure is not None:
        try:
            if drawn.panels:
                sources = tuple(_data_uri(figure_bytes(panel, "jpg"), "jpeg") for panel in drawn.panels)
            else:
                content, kind = figure_bytes(drawn.figure, "svg"), "svg+xml"
                if len(content) > SVG_LIMIT:
                    content, kind = figure_bytes(drawn.figure, "png"), "png"
                sources = (_data_uri(content, kind),)
        except Exception as error:
            return ReportFigure(drawn.name, drawn.title, drawn.caption, (), fault_text(error))
    shown = ReportFigure(drawn.name, drawn.title, drawn.caption, sources, drawn.reason)
    if drawn.table is None:
        return shown
    swept = [name for name in map(str, drawn.table.columns) if "." in name]
    return replace(shown, table=page_table(drawn.table, swept))


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _groups(names: list[str]) -> list[tuple[str, int]]:
    """Runs of equal group names with their lengths."""
    groups: list[tuple[str, int]] = []
    for name in names:
        if groups and groups[-1][0] == name:
            groups[-1] = (name, groups[-1][1] + 1)
        else:
            groups.append((name, 1))
    return groups


def _trial_headers(results: Results) -> list[str]:
    swept = swept_columns(results.trials)
    metrics = [column.full_header for column in summary_columns(results)]
    words = parameters_in_words(swept).values()
    return ["trial", "seed", *words, "back end", "status", "completion", "message", "stream", *metrics]


def _trial_rows(results: Results) -> list[list[Cell]]:
    swept = swept_columns(results.trials)
    metrics = [column.name for column in summary_columns(results)]
    rows = []
    for row in results.trials.head(MOST_RUNS).to_dict("records"):
        status, digest = str(row["status"]), str(row["digest"])
        rows.append(
            [
                cell(row["trial"]),
                cell(row.get("recording") or row["seed"]),
                *(swept_cell(row[path]) for path in swept),
                cell(row["label"]),
                Cell(status, status, status="ok" if status == "ok" else "bad"),
                Cell(f"{100 * row['completion']:.0f} %", repr(float(row["completion"])), True),
                cell(str(row["message"] or "")),
                Cell(digest[:12], digest, title=digest, note=_gate_note(row.get("own_gate"))),
                *(cell(row[name]) for name in metrics),
            ]
        )
    return rows


def _gate_note(gate: float | None) -> str:
    """Empty for a run that used the stream as it is."""
    return "" if gate is None or np.isnan(gate) else f"own gate {gate:g}"


def _facts(manifest: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is needed to repeat the experiment, as far as the manifest knows it."""
    names = {
        "command": "Command",
        "commit": "Commit",
        "created": "Started",
        "finished": "Finished",
        "wall_s": "Wall time [s]",
        "jobs": "Worker processes",
        "cpu": "Processor",
        "platform": "Platform",
        "python": "Python",
        "seeds": "Seeds",
        "front_end_totals": "Detections in the front end",
    }
    facts = []
    for key, title in names.items():
        value = manifest.get(key)
        if value in (None, "", [], {}):
            continue
        facts.append((title, _fact_text(value)))
    return facts


def _fact_text(value: Any) -> str:
    if isinstance(value, Mapping) and "sha" in value:
        return f"{value['sha']}{' with uncommitted changes' if value.get('dirty') else ''}"
    if isinstance(value, Mapping):
        # Counts of the front end: a stage that removed nothing need not be told; that nothing is left has to.
        told = {name: each for name, each in value.items() if each or name in ("raw", "kept")}
        return ", ".join(f"{str(name).replace('_', ' ')} {each}" for name, each in told.items())
    if isinstance(value, list):
        return " ".join(str(each) for each in value)
    return f"{value:.1f}" if isinstance(value, float) else str(value)
