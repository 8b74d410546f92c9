"""An experiment's table for a paper: LaTeX (booktabs, siunitx), Markdown, CSV.

Medians over the runs that ended well, with the distribution-free 95 % interval. *Best* is, in a column and
at a grid point, the smallest median (of a metric where more is better the largest), and with it every back
end that the paired runs do not tell apart from it: a table must not say more than they do.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.errors import UsageError
from slamcmp.metrics import MetricColumn, metric_columns
from slamcmp.metrics.statistics import FEWEST_RATIOS, Interval, median_interval, ratio_interval
from slamcmp.registry import did_you_mean
from slamcmp.results.grid import at_point, grid_points, pose_dimension, swept_columns, value_text
from slamcmp.results.judgements.certainty import runs_by_point
from slamcmp.results.numbers import number_text
from slamcmp.results.partial import comparable, missing_runs
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words

DEFAULT_COLUMNS = ("online_ate", "final_ate", "landmark_rmse", "online_pose_nees", "update_median_ms")
COUNTS = ("runs", "ok", "failed")
LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "²": r"\textsuperscript{2}",
    "–": "--",
    "°": r"\textdegree{}",
    "∞": r"$\infty$",
    "±": r"$\pm$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "·": r"$\cdot$",
    "σ": r"$\sigma$",
    "χ": r"$\chi$",
    "θ": r"$\theta$",
    "λ": r"$\lambda$",
    "μ": r"$\mu$",
    "Σ": r"$\Sigma$",
    "Λ": r"$\Lambda$",
    **{letter: "\\" + letter for letter in "{}$&#_%"},
}
"""Letters that mean something else, or that no Latin font has."""


@dataclass(frozen=True)
class PaperColumn:
    """A metric, or a count."""

    name: str
    header: str
    is_count: bool = False


@dataclass(frozen=True)
class PaperCell:
    """A value with its interval."""

    value: Interval
    best: bool = False


@dataclass(frozen=True)
class PaperTable:
    """A table as numbers, and as text in three languages."""

    keys: tuple[str, ...]
    """What names a row: back end, paths of swept parameters (the columns of CSV)."""
    columns: tuple[PaperColumn, ...]
    rows: tuple[tuple[tuple[str, ...], tuple[PaperCell, ...]], ...]
    comments: tuple[str, ...]
    intervals: bool = True

    @property
    def key_words(self) -> tuple[str, ...]:
        """The keys as a reader says them."""
        words = parameters_in_words(self.keys[1:])
        return (self.keys[0], *(words[path] for path in self.keys[1:]))

    def latex(self) -> str:
        """A tabular whose numbers are aligned at their points."""
        layout = ["l" * len(self.keys)]
        head = [f"{{{latex_escaped(key)}}}" for key in self.key_words]
        for place, column in enumerate(self.columns):
            texts = [_number(column, row[1][place]) for row in self.rows]
            layout.append(f"S[table-format={_siunitx_format(texts)}]")
            if self._has_interval(column):
                layout.append(r"@{\,}l")
                head.append(rf"\multicolumn{{2}}{{c}}{{{latex_escaped(column.header)}}}")
            else:
                head.append(f"{{{latex_escaped(column.header)}}}")
        lines = [f"% {_one_line(text)}" for text in self.comments]
        lines.append(
            r"% \usepackage{booktabs, siunitx}; bold numbers: \sisetup{detect-weight=true, mode=text}"
        )
        lines += [
            rf"\begin{{tabular}}{{{' '.join(layout)}}}",
            r"\toprule",
            " & ".join(head) + r" \\",
            r"\midrule",
        ]
        for keys, cells in self.rows:
            parts = [f"{{{latex_escaped(key)}}}" for key in keys]
            for column, cell in zip(self.columns, cells, strict=True):
                text = _number(column, cell)
                parts.append((r"\bfseries " if cell.best else "") + text if text else "{--}")
                if self._has_interval(column):
                    bounds = _bounds(cell.value)
                    parts.append(rf"{{\footnotesize [{bounds[0]}, {bounds[1]}]}}" if bounds else "{}")
            lines.append(" & ".join(parts) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"

    def markdown(self) -> str:
        """A table of GitHub's Markdown; the comments are hidden."""
        head = [*self.key_words, *(column.header for column in self.columns)]
        marks = ["---"] * len(self.keys) + ["---:"] * len(self.columns)
        rows = []
        for keys, cells in self.rows:
            texts = []
            for column, cell in zip(self.columns, cells, strict=True):
                text = _number(column, cell) or "–"
                bounds = _bounds(cell.value) if self._has_interval(column) else None
                texts.append(
                    (f"**{text}**" if cell.best else text) + (f" [{', '.join(bounds)}]" if bounds else "")
                )
            rows.append([*map(_markdown_escaped, keys), *texts])
        lines = [f"<!-- {_one_line(text).replace('-->', '-- >')} -->" for text in self.comments]
        table = [[*map(_markdown_escaped, head)], marks, *rows]
        return "\n".join([*lines, "", *(f"| {' | '.join(row)} |" for row in table)]) + "\n"

    def csv(self) -> str:
        """Full precision, bounds in columns of their own; comments begin with ``#``."""
        buffer = io.StringIO()
        for text in self.comments:
            buffer.write(f"# {_one_line(text)}\n")
        writer = csv.writer(buffer, lineterminator="\n")
        names: list[str] = []
        for column in self.columns:
            bounds = [f"{column.name}_low", f"{column.name}_high"] if self._has_interval(column) else []
            names += [column.name, *bounds]
        marked = any(cell.best for _, cells in self.rows for cell in cells)
        names += [f"{column.name}_best" for column in self.columns if marked and not column.is_count]
        writer.writerow(["back_end", *self.keys[1:], *names])
        for keys, cells in self.rows:
            values: list[Any] = []
            for column, cell in zip(self.columns, cells, strict=True):
                values.append(int(cell.value.estimate) if column.is_count else _plain(cell.value.estimate))
                if self._has_interval(column):
                    values += [_plain(cell.value.low), _plain(cell.value.high)]
            for column, cell in zip(self.columns, cells, strict=True):
                if marked and not column.is_count:
                    values.append(int(cell.best))
            writer.writerow([*keys, *values])
        return buffer.getvalue()

    def _has_interval(self, column: PaperColumn) -> bool:
        return self.intervals and not column.is_count


def paper_table(
    results: Results,
    columns: Sequence[str] | None = None,
    *,
    best: bool = False,
    intervals: bool = True,
    command: str = "slamcmp table",
) -> PaperTable:
    """The table of a results folder.

    Args:
        results: of the experiment.
        columns: metric columns of the trials table, and ``runs``, ``ok``, ``failed``; default: those of
            :data:`DEFAULT_COLUMNS` that have values.
        best: mark the best of each column.
        intervals: put the 95 % interval beside each median.
        command: what makes this table again.

    Raises:
        UsageError: there is no such column, or it has no value.
    """
    missing, results = missing_runs(results), comparable(results)
    chosen = _chosen(results, columns)
    swept = swept_columns(results.trials)
    rows = []
    marks = {name: _best(results, name, about) if best else set() for name, about in chosen.items() if about}
    for number, (point, label, own) in enumerate(runs_by_point(results)):
        cells = [_cell(own, name, about, number in marks.get(name, ())) for name, about in chosen.items()]
        rows.append(((label, *(value_text(point[path]) for path in swept)), tuple(cells)))
    space = "SE(3)" if pose_dimension(results.frames) == 6 else "SE(2)"
    heads = tuple(
        PaperColumn(name, _header(name, about, space), about is None) for name, about in chosen.items()
    )
    comments = _comments(results, command, best=best, intervals=intervals)
    if missing is not None:
        comments.append(missing.sentence())
    return PaperTable(("back end", *swept), heads, tuple(rows), tuple(comments), intervals)


def latex_escaped(text: str) -> str:
    """Text that LaTeX prints as it is."""
    flat = " ".join(str(text).split()).replace("χ²", "\0")
    return "".join(LATEX.get(letter, letter) for letter in flat).replace("\0", r"$\chi^2$")


def _chosen(results: Results, columns: Sequence[str] | None) -> dict[str, MetricColumn | None]:
    """The columns in the order that was asked for; None for a count."""
    known = metric_columns()
    there = [name for name in known if name in results.trials and results.trials[name].notna().any()]
    if columns is None:
        found = [name for name in DEFAULT_COLUMNS if name in there]
        return {"runs": None, **{name: known[name] for name in found}}
    for name in columns:
        if name not in COUNTS and name not in there:
            what = "has no value in these results" if name in known else "is no column"
            raise UsageError(f"--columns: {name!r} {what}{did_you_mean(name, [*there, *COUNTS])}")
    if not columns:
        raise UsageError("--columns: no column is named")
    return {name: known.get(name) for name in columns}


def _header(name: str, about: MetricColumn | None, space: str) -> str:
    if about is None:
        return name
    unit = "" if about.unit == "1" else f" [{about.unit}]"
    return f"{about.trajectory} {about.header.replace('SE-aligned', f'{space}-aligned')}{unit}".strip()


def _cell(own: pd.DataFrame, name: str, about: MetricColumn | None, best: bool) -> PaperCell:
    ok = own[own["status"] == "ok"]
    if about is None:
        count = {"runs": len(own), "ok": len(ok), "failed": len(own) - len(ok)}[name]
        return PaperCell(Interval(float(count), math.nan, math.nan, len(own)))
    return PaperCell(median_interval(ok[name].astype(float)), best)


def _best(results: Results, name: str, about: MetricColumn) -> set[int]:
    """Numbers of the rows that are best at their grid point, in the order of the rows."""
    if about.lower_is_better is None:
        return set()
    numbers = {(value_key(point), label): k for k, (point, label, _) in enumerate(runs_by_point(results))}
    found: set[int] = set()
    for point in grid_points(results.trials):
        rows = at_point(results.trials, point)
        rows = rows[(rows["status"] == "ok") & rows[name].notna()]
        # Its own difference from itself is no merit.
        rows = rows[~((rows["reference"] == rows["label"] + " (final)") & (about.trajectory == "final"))]
        table = rows.pivot(index="trial", columns="label", values=name).astype(float)
        if table.empty:
            continue
        medians = table.median() if about.lower_is_better else -table.median()
        first = str(medians.idxmin())
        for label in map(str, table.columns):
            if label == first or _not_told_apart(table[label], table[first]):
                found.add(numbers[value_key(point), label])
    return found


def value_key(point: Mapping[str, Any]) -> tuple[str, ...]:
    """A grid point as something to look up."""
    return tuple(value_text(value) for value in point.values())


def _not_told_apart(values: pd.Series[float], best: pd.Series[float]) -> bool:
    pairs = pd.concat([values, best], axis=1).dropna().to_numpy(float)
    if len(pairs) and (pairs[:, 0] == pairs[:, 1]).all():
        return True
    if len(pairs) < FEWEST_RATIOS:
        return False
    interval = ratio_interval(*pairs.T)
    return bool(np.isfinite(interval.half_width) and interval.low <= 1.0 <= interval.high)


def _comments(results: Results, command: str, *, best: bool, intervals: bool) -> list[str]:
    manifest = results.manifest
    commit = manifest.get("commit")
    sha = f", commit {str(commit.get('sha'))[:12]}" if isinstance(commit, Mapping) else ""
    dirty = " with uncommitted changes" if isinstance(commit, Mapping) and commit.get("dirty") else ""
    version = (manifest.get("versions") or {}).get("slamcmp")
    lines = [command]
    if manifest.get("command"):
        of = f" (slamcmp {version}{sha}{dirty}, {manifest.get('created', '')})" if version else ""
        lines.append(f"results: {manifest['command']}{of}")
    what = "medians over the runs that ended well"
    lines.append(what + (", with the distribution-free 95 % interval (from 6 runs on)" if intervals else ""))
    if best:
        lines.append(
            f"bold: the best, and what the 95 % interval of the paired ratio (from {FEWEST_RATIOS} pairs on) "
            "does not tell apart from it"
        )
    return lines


def _number(column: PaperColumn, cell: PaperCell) -> str:
    value = cell.value.estimate
    if not math.isfinite(value):
        return ""
    return str(int(value)) if column.is_count else number_text(value)


def _bounds(interval: Interval) -> tuple[str, str] | None:
    if not np.isfinite([interval.low, interval.high]).all():
        return None
    return number_text(interval.low), number_text(interval.high)


def _siunitx_format(texts: Sequence[str]) -> str:
    """``2.3``: digits before and behind the point, with the longest of each."""
    whole, behind, exponent, sign = 1, 0, 0, ""
    for text in filter(None, texts):
        match = re.fullmatch(r"(-?)(\d+)(?:\.(\d+))?(?:e[+-]?(\d+))?", text)
        assert match is not None, text
        sign = sign or match[1]
        whole, behind = max(whole, len(match[2])), max(behind, len(match[3] or ""))
        exponent = max(exponent, len(match[4] or ""))
    return f"{sign}{whole}.{behind}" + (f"e-{exponent}" if exponent else "")


def _plain(value: float) -> Any:
    return repr(value) if math.isfinite(value) else ""


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _markdown_escaped(text: str) -> str:
    return re.sub(r"([\\`*_|<>\[\]#~])", r"\\\1", _one_line(text))
