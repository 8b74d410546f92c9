"""What a reader must know before believing the numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slamcmp.experiment.store import Results
from slamcmp.report.selection import (
    has_values,
    labels,
    point_name,
    reference_name,
    swept_columns,
)
from slamcmp.report.summary import ENOUGH_SEEDS

HEALTHY_NIS = (0.8, 1.25)
"""NIS per degree of freedom that a reader would pass as healthy."""
FAR_SIGMAS = 3.0
"""Median distance, in the back end's own standard deviations, that its covariance cannot explain."""


@dataclass(frozen=True)
class Caution:
    """One box on top of the report."""

    title: str
    text: str


def cautions(results: Results) -> list[Caution]:
    """Failed runs, innovations that look healthy on a wrong trajectory, too few runs, unequal streams."""
    found = [
        _failed(results),
        _healthy_but_far(results),
        _few_runs(results),
        _unequal_streams(results),
    ]
    return [caution for caution in found if caution is not None]


def distance_in_sigmas(frames: pd.DataFrame) -> float:
    """Median over the frames of the online position's Mahalanobis distance to the truth or reference.

    Where there is neither, to the run's own final trajectory; NaN without that too.
    """
    target = next((prefix for prefix in ("true", "final") if has_values(frames, [f"{prefix}_x"])), None)
    if target is None or not has_values(frames, ["online_P_xx"]):
        return float("nan")
    dx, dy = (
        (frames[f"{target}_{axis}"] - frames[f"online_{axis}"]).to_numpy(dtype=float) for axis in ("x", "y")
    )
    P_xx, P_xy, P_yy = (frames[f"online_P_{name}"].to_numpy(dtype=float) for name in ("xx", "xy", "yy"))
    determinant = P_xx * P_yy - P_xy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (P_yy * dx**2 - 2.0 * P_xy * dx * dy + P_xx * dy**2) / determinant
    usable = squared[(determinant > 0) & np.isfinite(squared)]
    return float(np.sqrt(np.median(usable))) if usable.size else float("nan")


def _failed(results: Results) -> Caution | None:
    failed = results.trials[results.trials["status"] != "ok"]
    if failed.empty:
        return None
    keys = ["label", *swept_columns(failed), "status"]
    parts = []
    for names, rows in failed.groupby(keys, sort=False, dropna=False):
        values = dict(zip(keys, names, strict=True))
        label, status = values.pop("label"), values.pop("status")
        where = point_name({str(path): value for path, value in values.items()})
        parts.append(f"{label}{f' at {where}' if where else ''}: {len(rows)} {status}")
    return Caution(
        f"{len(failed)} of {len(results.trials)} runs are not ok",
        f"{'; '.join(parts)}. They are in no median; the remaining runs may be the easier ones.",
    )


def _healthy_but_far(results: Results) -> Caution | None:
    if not has_values(results.trials, ["nis_per_dof"]) or results.frames.empty:
        return None
    distances = {
        key: distance_in_sigmas(rows) for key, rows in results.frames.groupby(["trial", "label"], sort=False)
    }
    parts = []
    for label in labels(results):
        own = results.trials[results.trials["label"] == label]
        healthy = own[own["nis_per_dof"].between(*HEALTHY_NIS)]
        sigmas = healthy["trial"].map(lambda trial, label=label: distances.get((trial, label), np.nan))
        far = sigmas[sigmas > FAR_SIGMAS]
        if far.empty:
            continue
        nis = healthy.loc[far.index, "nis_per_dof"].median()
        parts.append(
            f"{label}: NIS/dof {nis:.2f}, yet the online position is typically {far.median():.1f} of its own "
            f"standard deviations away ({len(far)} of {len(own)} runs)"
        )
    if not parts:
        return None
    reference = reference_name(results)
    target = "its own final trajectory" if reference == "none" else f"the {reference}"
    if reference not in ("none", "truth"):
        target = f"the reference {reference}"
    return Caution(
        "A healthy NIS hides a wrong trajectory",
        f"{'; '.join(parts)}. The distance is to {target}. The innovations only test each step against the "
        "map the back end already has; they do not see that the map itself has drifted.",
    )


def _few_runs(results: Results) -> Caution | None:
    keys = ["label", *swept_columns(results.trials)]
    if results.trials.empty:
        return None
    fewest = int(results.trials.groupby(keys, dropna=False).size().min())
    if fewest >= ENOUGH_SEEDS:
        return None
    runs = "one run" if fewest == 1 else f"{fewest} runs"
    return Caution(
        f"Too few runs for statistics: {runs} per back end and grid point",
        "A difference between back ends may be chance. Frames of one run are not independent samples; only "
        f"whole runs are. At least {ENOUGH_SEEDS} seeds (better 20) are needed, or several recordings.",
    )


def _unequal_streams(results: Results) -> Caution | None:
    known = results.trials[results.trials["digest"].astype(str) != ""]
    counts = known.groupby("trial")["digest"].nunique()
    mixed = [str(trial) for trial in counts.index[counts > 1]]
    if not mixed:
        return None
    return Caution(
        "Back ends of one trial did not get the same measurements",
        f"The digests differ in trial {', '.join(mixed)}: those rows must not be compared.",
    )
