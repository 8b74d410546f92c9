"""The experiment in one table: medians over the seeds of each grid point, failed runs counted beside them."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.errors import UsageError
from slamcmp.metrics import metric_columns
from slamcmp.metrics.statistics import (
    Interval,
    median_interval,
    paired_interval,
    ratio_interval,
    ratio_test,
    sign_test,
    signed_rank_test,
)
from slamcmp.registry import did_you_mean
from slamcmp.results.grid import (
    at_point,
    grid_points,
    has_values,
    labels,
    own_columns,
    own_points,
    pose_dimension,
    swept_columns,
)
from slamcmp.results.judgements.certainty import failure_rate, runs_by_point, worst_run
from slamcmp.results.numbers import interval_text, number_text
from slamcmp.results.partial import comparable, missing_runs
from slamcmp.results.store import IMPORTED, Results
from slamcmp.results.words import parameters_in_words

TRAJECTORY_METRICS = ("ate", "ate_aligned", "heading_rmse_deg", "pose_nees")
RUN_METRICS = (
    "landmark_rmse",
    "landmark_nees",
    "joint_nees_per_dof",
    "nis_per_dof",
    "chi2_per_dof",
    "nullity",
    "spurious_turn_per_rad2",
    "spurious_shift_per_m2",
    "kl_from_batch_median",
    "gate_recall",
    "gate_precision",
    "update_median_ms",
    "update_p95_ms",
    "update_s",
    "estimate_s",
    "final_solution_s",
    "peak_memory_mb",
)
STATUSES = ("diverged", "crashed", "timed_out", "killed", "missing")
ENOUGH_SEEDS = 5
"""Below this many runs per grid point medians and tests say little."""


@dataclass(frozen=True)
class SummaryColumn:
    """A metric column that has values in these results."""

    name: str
    """In the trials table."""
    group: str
    """``online``, ``final``, or ``""`` for the whole run."""
    header: str
    """With the unit, without the group."""
    description: str

    @property
    def full_header(self) -> str:
        """The heading where no group stands above it."""
        return f"{self.group} {self.header}".strip()


def summary_table(results: Results) -> pd.DataFrame:
    """One row per back end and combination of its swept values: counts, then medians of the ok runs.

    Every error column says whether it scores the online or the final trajectory; ``failed`` names the
    statuses of the runs that are in no median; ``origin``, where any run is imported, marks those;
    ``own gate``, where there is any, says which rows chose their observations by a gate of their own. Where
    runs are missing, ``missing`` counts them, and everything else is over the trials that all back ends have.
    """
    missing, results = missing_runs(results), comparable(results)
    columns = summary_columns(results)
    gated, swept = has_values(results.trials, ["own_gate"]), swept_columns(results.trials)
    foreign = has_values(results.trials, ["back_end"]) and (results.trials["back_end"] == IMPORTED).any()
    rows: list[dict[str, Any]] = []
    for point, label, own in runs_by_point(results):
        ok = own[own["status"] == "ok"]
        failed = [f"{int((own['status'] == s).sum())} {s}" for s in STATUSES if (own["status"] == s).any()]
        rows.append(
            {
                "back end": label,
                **{path: point.get(path) for path in swept},
                **(
                    {"origin": IMPORTED if (own["back_end"] == IMPORTED).all() else "run here"}
                    if foreign
                    else {}
                ),
                **({"own gate": gate_text(own)} if gated else {}),
                "runs": len(own),
                "ok": len(ok),
                "failed": ", ".join(failed),
                **({} if missing is None else {"missing": missing.of(label, point)}),
                "reference": ", ".join(sorted(own["reference"].dropna().astype(str).unique())),
                **{column.full_header: ok[column.name].dropna().median() for column in columns},
            }
        )
    return pd.DataFrame(rows)


def gate_text(runs: pd.DataFrame) -> str:
    """The probability of these runs' own gate, or ``none``."""
    found = runs["own_gate"].dropna()
    return "none" if found.empty else ", ".join(f"{value:g}" for value in found.unique())


def warm_started(results: Results) -> list[str]:
    """Labels of the batch solvers that solve once: what they say online is their warm start's."""
    return [
        str(each.get("label", "batch"))
        for each in results.manifest.get("config", {}).get("back_ends", [])
        if each.get("name") == "batch" and not each.get("every")
    ]


def priors_in_body_axes(results: Results) -> list[str]:
    """Labels of the fixed lags that poses have left: GTSAM keeps what those leave in the axes of a body."""
    config = results.manifest.get("config", {})
    swept = [
        value
        for path, values in (config.get("sweep") or {}).items()
        if path.endswith(".lag_frames")
        for value in values
    ]
    frames = results.trials["frames"].max() if "frames" in results.trials else 0
    return [
        str(each.get("label", "fixed_lag"))
        for each in config.get("back_ends", [])
        if each.get("name") == "fixed_lag" and min([each.get("lag_frames", 20), *swept]) < frames - 1
    ]


def checked_columns(names: Sequence[str], asked_by: str = "columns") -> list[str]:
    """The names of metric columns as they are.

    Raises:
        UsageError: there is no such column, or one is named twice.
    """
    known = metric_columns()
    for index, name in enumerate(names):
        if name not in known:
            raise UsageError(f"{asked_by}: no metric column {name!r}{did_you_mean(name, known)}")
        if name in names[:index]:
            raise UsageError(f"{asked_by}: {name!r} stands twice")
    return list(names)


def with_columns(results: Results, names: Sequence[str]) -> Results:
    """The results with these metric columns in their tables, in place of those that the experiment chose.

    Raises:
        UsageError: there is no such column, or one is named twice.
    """
    names = checked_columns(names)
    config = {**results.manifest.get("config", {}), "columns": list(names)}
    return replace(results, manifest={**results.manifest, "config": config})


def in_words(table: pd.DataFrame) -> pd.DataFrame:
    """A table whose swept columns are called as a reader says them: for eyes, not for programs."""
    return table.rename(columns=parameters_in_words(swept_columns(table)))


def summary_intervals(results: Results) -> list[dict[str, Interval]]:
    """For each row of :func:`summary_table` the 95 % interval of each median, by the column's heading."""
    results = comparable(results)
    columns = summary_columns(results)
    return [
        {
            column.full_header: median_interval(own[own["status"] == "ok"][column.name].astype(float))
            for column in columns
        }
        for _, _, own in runs_by_point(results)
    ]


def terminal_table(results: Results) -> pd.DataFrame:
    """The summary with what a reader must see beside the first error: its interval, its worst run.

    Failure rates stand beside the counts as soon as there are enough runs to speak of a rate.
    """

    def short(text: str) -> str:
        return text.replace(" to ", "–")

    table = summary_table(results)
    if table.empty:
        return table
    results = comparable(results)
    groups = [own for _, _, own in runs_by_point(results)]
    if max((len(own) for own in groups), default=0) >= ENOUGH_SEEDS:
        rates = [short(failure_rate(own)) for own in groups]
        table.insert(list(table.columns).index("failed") + 1, "failed (95 %)", rates)
    column = next((c for c in summary_columns(results) if c.name.endswith("_ate")), None)
    if column is None:
        return table
    where = list(table.columns).index(column.full_header) + 1
    worst = [worst_run(own, column.name) for own in groups]
    if len(results.trials) > len(groups):
        texts = [
            number_text(value) + (f" ({seed})" if seed else "") if value == value else ""
            for value, seed in worst
        ]
        table.insert(where, "  worst run (seed)", texts)
    intervals = [short(interval_text(row[column.full_header])) for row in summary_intervals(results)]
    table.insert(where, "  95 % of median", intervals)
    return table


def summary_columns(results: Results) -> list[SummaryColumn]:
    """The metric columns of the summary that have a value, online before final before the whole run's.

    Those that the experiment chose (``columns:``) in the order in which it did; else the usual ones.
    """
    known = metric_columns()
    space = "SE(3)" if pose_dimension(results.frames) == 6 else "SE(2)"
    names = [f"{which}_{metric}" for which in ("online", "final") for metric in TRAJECTORY_METRICS]
    columns = []
    for name in results.manifest.get("config", {}).get("columns") or [*names, *RUN_METRICS]:
        if name not in known or not has_values(results.trials, [name]):
            continue
        metric = known[name]
        header = metric.header.replace("SE-aligned", f"{space}-aligned")
        unit = "" if metric.unit == "1" else f" [{metric.unit}]"
        columns.append(SummaryColumn(name, metric.trajectory, header + unit, metric.description))
    return columns


def paired_table(results: Results) -> pd.DataFrame:
    """ATE of each back end over that of the first one on the same stream, trial by trial.

    One row per trajectory, back end and combination of the swept values that one of the two has: pairs;
    geometric mean of the ratio with the interval and the two-sided p value of Student's t on its logarithm,
    which is the test that ``slamcmp seeds`` plans; median ratio and median difference with their
    distribution-free intervals; pairs in which it was better, and the p values of the sign test and of
    Wilcoxon's signed-rank test on the same logarithm, which assume less. Tests need five pairs. The reference
    itself is left out. Where a back end gates for itself, ``own gates`` says so of both sides.
    """
    results = comparable(results)
    rows: list[dict[str, Any]] = []
    swept = swept_columns(results.trials)
    gated = has_values(results.trials, ["own_gate"])
    points_of = functools.cache(functools.partial(own_points, results.trials))
    for index, point in enumerate(grid_points(results.trials)):
        here = at_point(results.trials, point)
        for which in ("online", "final"):
            errors = errors_by_trial(here, f"{which}_ate")
            compared = [label for label in labels(results) if label in errors.columns]
            for label in compared[1:]:
                pairs = errors[[compared[0], label]].dropna()
                if pairs.empty or index not in points_of(compared[0], label):
                    continue
                own = own_columns(swept, compared[0], label)
                ratio = pairs[label] / pairs[compared[0]]
                mean_ratio = ratio_interval(pairs[label], pairs[compared[0]])
                difference = paired_interval(pairs[label], pairs[compared[0]])
                better = int((ratio < 1).sum())
                enough = len(pairs) >= ENOUGH_SEEDS
                rows.append(
                    {
                        **{path: point[path] if path in own else None for path in swept},
                        "trajectory": which,
                        "back end": label,
                        "compared with": compared[0],
                        **({"own gates": _gates(here, label, compared[0])} if gated else {}),
                        "pairs": len(pairs),
                        "ATE ratio": mean_ratio.estimate,
                        "95 % of it": interval_text(mean_ratio),
                        "t test p": ratio_test(pairs[label], pairs[compared[0]]),
                        "median ATE ratio": float(ratio.median()),
                        "95 % of the ratio": interval_text(median_interval(ratio)),
                        "median difference [m]": difference.estimate,
                        "95 % of the difference": interval_text(difference),
                        "better in": better,
                        "sign test p": sign_test(ratio - 1) if enough else math.nan,
                        "signed-rank p": signed_rank_test(np.log(ratio)) if enough else math.nan,
                    }
                )
    return pd.DataFrame(rows)


def _gates(rows: pd.DataFrame, label: str, other: str) -> str:
    """``both 0.999``, or ``0.999 against none``."""
    own, others = (gate_text(rows[rows["label"] == each]) for each in (label, other))
    return f"both {own}" if own == others else f"{own} against {others}"


def errors_by_trial(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    """Trials by labels; failed runs and the reference's own zero are left out."""
    if column not in rows.columns:
        return pd.DataFrame()
    used = rows[(rows["status"] == "ok") & (rows[column] > 0)]
    itself = (used["reference"] == used["label"] + " (final)") & column.startswith("final")
    return used[~itself].pivot(index="trial", columns="label", values=column)
