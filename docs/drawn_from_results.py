"""Figures and sentences of shipped experiments, drawn when the site is built from what is committed.

``results/reference/`` keeps the runs of the larger experiments and, of those that repeat a publication, each
published value beside the measured one. Nothing is run here.
"""

from __future__ import annotations

import base64
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from slamcmp.report.figures import style
from slamcmp.results.grid import swept_columns, value_text
from slamcmp.results.numbers import number_text
from slamcmp.results.words import parameters_in_words, setting_in_words

REFERENCE = Path(__file__).resolve().parents[1] / "results" / "reference"
MOST_VALUES = 40


@dataclass(frozen=True)
class Shown:
    """A figure with what it shows."""

    svg: bytes
    alt: str
    sentence: str

    def html(self) -> str:
        """The figure inside a page."""
        data = base64.b64encode(self.svg).decode()
        return f'<img alt="{self.alt}" src="data:image/svg+xml;base64,{data}" style="background:#fff">'


def shown(name: str) -> Shown | None:
    """Of a shipped experiment; None where nothing of it is committed."""
    key = name.replace("/", "_")
    for runs in (REFERENCE / f"{key}_runs.csv", REFERENCE / f"{name}.csv"):
        if runs.is_file():
            return of_runs(pd.read_csv(runs, comment="#"))
    summary = REFERENCE / f"{key}.json"
    if summary.is_file():
        content = json.loads(summary.read_text(encoding="utf-8"))
        return of_published(content) if "sentence" in content else None
    return None


def of_published(content: dict[str, Any]) -> Shown:
    """How far each measured value is from the published one, over its tolerance."""
    values = [each for each in content["values"] if each.get("deviation") is not None][:MOST_VALUES]
    judged = [each for each in values if each.get("tolerance")]
    orders = [order["verdict"] for order in content["orders"]]
    with matplotlib.rc_context(style.RC):
        figure = style.new_figure(8.5, 0.9 + 0.19 * len(values), "Measured against published")
        axes = figure.subplots()
        for row, each in enumerate(values):
            tolerance = 100.0 * (each["tolerance"] or 0.0)
            axes.barh(row, 2.0 * tolerance, left=-tolerance, color="#dddddd", height=0.8)
            colour = "#D55E00" if each in judged and each["verdict"] != "inside" else "#0072B2"
            axes.plot(100.0 * each["deviation"], row, "o", color=colour, markersize=4)
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.set_yticks(range(len(values)), [_value_name(each) for each in values], fontsize=6.5)
        axes.invert_yaxis()
        band = ", over its tolerance (grey)" if judged else ""
        axes.set_xlabel(f"deviation from the published value [%]{band}")
        svg = _svg(figure)
    inside = sum(each["verdict"] == "inside" for each in judged)
    parts = [f"{inside} of {len(judged)} published values lie inside their tolerance"] if judged else []
    if orders:
        held = orders.count("held")
        parts.append(f"{held} of {len(orders)} published orders are held")
    basis = f"on {content['seeds']} seeds" if content["seeds"] else "on the recording"
    return Shown(
        svg, "Deviation of each measured value from the published one", f"{'; '.join(parts)} ({basis})."
    )


def of_runs(runs: pd.DataFrame) -> Shown:
    """The error of each back end: a point a run with its median, or medians over what was swept."""
    metric = next(m for m in ("online_ate_aligned", "online_ate") if m in runs and runs[m].notna().any())
    words = f"{'aligned ' if metric.endswith('aligned') else ''}online ATE [m]"
    ok = runs[(runs["status"] == "ok") & runs[metric].notna()]
    labels = [label for label in dict.fromkeys(runs["label"]) if label in set(ok["label"])]
    swept = [path for path in swept_columns(runs) if ok[path].nunique() > 1]
    # The number of a recording is a name.
    seeded = runs["seed"].nunique() > 1
    numeric = [path for path in swept if seeded and pd.api.types.is_numeric_dtype(ok[path])]
    with matplotlib.rc_context(style.RC):
        if numeric:
            figure, sentence = _over_values(ok, labels, metric, numeric[-1], words, others=swept[:-1])
        else:
            figure, sentence = _points(ok, labels, metric, words)
        svg = _svg(figure)
    failed = int((runs["status"] != "ok").sum())
    samples = runs["seed"].nunique()
    basis = f"{samples} seeds" if samples > 1 else f"{len(runs)} runs of recorded data"
    end = f", {failed} of {len(runs)} runs failed and are in no number" if failed else ""
    return Shown(svg, f"{words} of each back end", f"{sentence} ({basis}{end}).")


def _over_values(
    ok: pd.DataFrame, labels: list[str], metric: str, path: str, words: str, *, others: list[str]
) -> tuple[Figure, str]:
    name = parameters_in_words([path])[path]
    figure = style.new_figure(8.5, 3.6, "")
    axes = figure.subplots()
    medians = ok.groupby(["label", path], sort=False)[metric].median().unstack()
    for label in labels:
        own = medians.loc[label].dropna().sort_index()
        axes.plot(own.index, own, marker="o", markersize=3.5, label=label)
    style.log_if_wide(axes, medians.to_numpy(float).ravel(), "y")
    style.log_if_wide(axes, medians.columns.to_numpy(float), "x")
    axes.set_xlabel(name)
    axes.set_ylabel(words)
    axes.legend(fontsize=7, ncols=2)
    last = medians.columns.max()
    best, worst = medians[last].idxmin(), medians[last].idxmax()
    over = f", over all values of {' and '.join(parameters_in_words(others).values())}" if others else ""
    ends = _ends(medians[last], str(best), str(worst))
    metric = words.removesuffix(" [m]")
    with_last = f"With {setting_in_words(name, value_text(last))}"
    return figure, f"{with_last} the median {metric} goes from {ends}{over}"


def _points(ok: pd.DataFrame, labels: list[str], metric: str, words: str) -> tuple[Figure, str]:
    figure = style.new_figure(8.5, 0.9 + 0.28 * len(labels), "")
    axes = figure.subplots()
    medians = ok.groupby("label", sort=False)[metric].median()
    for row, label in enumerate(labels):
        own = ok.loc[ok["label"] == label, metric].to_numpy(float)
        axes.plot(own, np.full(own.size, row), "o", color="#0072B2", alpha=0.45, markersize=4)
        axes.plot(medians[label], row, "|", color="black", markersize=13)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    style.log_if_wide(axes, ok[metric].to_numpy(float), "x")
    # One run is no median.
    several = len(ok) > len(labels)
    axes.set_xlabel(f"{words}; a point a run, the line their median" if several else words)
    best, worst = medians.idxmin(), medians.idxmax()
    ends = _ends(medians, str(best), str(worst))
    return figure, f"The {'median ' if several else ''}{words.removesuffix(' [m]')} goes from {ends}"


def _ends(medians: pd.Series[float], *labels: str) -> str:
    return " to ".join(f"{number_text(float(medians[label]))} m ({label})" for label in labels)


def _value_name(each: dict[str, Any]) -> str:
    words = parameters_in_words(each["at"])
    at = [setting_in_words(words[path], value_text(value)) for path, value in each["at"].items()]
    metric = each["metric"].replace("_", " ")
    for short, written in (("nees", "NEES"), ("rmse", "RMSE"), ("chi2", "χ²"), ("nis", "NIS")):
        metric = metric.replace(short, written)
    return ", ".join([each["label"], metric, *at])


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
