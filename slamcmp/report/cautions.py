"""What a reader must know before believing the numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import bdtrc, chdtrc

from slamcmp.metrics.consistency import average_band
from slamcmp.results.grid import has_values, labels, point_name, pose_dimension, reference_name, swept_columns
from slamcmp.results.judgements.certainty import last_frame_nees, runs_by_point
from slamcmp.results.judgements.summary import ENOUGH_SEEDS, priors_in_body_axes, warm_started
from slamcmp.results.partial import Missing, comparable, missing_runs
from slamcmp.results.store import Results

HEALTHY_NIS = (0.8, 1.25)
"""NIS per degree of freedom that a reader would pass as healthy."""
FAR_SIGMAS = 3.0
"""Median distance, in the back end's own standard deviations, that its covariance cannot explain.

A consistent back end's is about 1.2; one error common to all frames or landmarks passes 3 by chance in
:data:`FAR_CHANCE` of the runs, so a few far runs among many are no sign.
"""
FAR_CHANCE = float(chdtrc(2, FAR_SIGMAS**2))
"""0.011: of a chi-square variable of two degrees of freedom."""
FAR_BY_LUCK = 0.02
"""Probability of that many far runs below which a caution is given."""
WAITED = 1.1
"""Wall time over processor time above which the median run was disturbed."""
SHORTEST_S = 0.02
"""Runs that took less are told by no clock of the system."""
SURE = 0.998
"""Two-sided share of the ANEES band: one false caution in a thousand grid points."""


@dataclass(frozen=True)
class Caution:
    """One box on top of the report."""

    title: str
    text: str


def cautions(results: Results) -> list[Caution]:
    """Failed runs, innovations that look healthy on a wrong trajectory, too few runs, unequal streams."""
    missing, results = missing_runs(results), comparable(results)
    found = [
        None if missing is None else Caution("Not complete", _sentence(missing)),
        _warnings(results),
        _failed(results),
        _cut_short(results),
        _own_gates(results),
        _healthy_but_far(results),
        _borrowed_online_column(results),
        _priors_in_body_axes(results),
        _few_runs(results),
        _in_session(results),
        _no_times(results),
        _shared_machine(results),
        _unequal_streams(results),
    ]
    return [caution for caution in found if caution is not None]


def _sentence(missing: Missing) -> str:
    text = missing.sentence()
    return f"{text[:1].upper()}{text[1:]}. The same command runs what is missing."


def distances_in_sigmas(frames: pd.DataFrame) -> pd.Series[float]:
    """Median over each run's frames of the online position's Mahalanobis distance to the truth or reference.

    By trial and label. Where a run has neither, to its own final trajectory; NaN without that too.
    """
    keys = [frames["trial"], frames["label"]]
    squared = _squared_distances(frames, "true")
    if not has_values(frames, ["true_x"]) or frames["true_x"].isna().any():
        known = frames["true_x"].notna() if "true_x" in frames else pd.Series(False, index=frames.index)
        squared = squared.where(known.groupby(keys).transform("any"), _squared_distances(frames, "final"))
    return squared.groupby(keys, sort=False).median() ** 0.5


def _squared_distances(frames: pd.DataFrame, target: str) -> pd.Series[float]:
    """Of every row; NaN where its position, its target or a proper covariance is missing."""
    names = [
        f"{target}_x",
        f"{target}_y",
        "online_x",
        "online_y",
        *(f"online_P_{of}" for of in ("xx", "xy", "yy")),
    ]
    if not set(names) <= set(frames.columns):
        return pd.Series(np.nan, index=frames.index)
    x, y, online_x, online_y, P_xx, P_xy, P_yy = (frames[name].to_numpy(dtype=float) for name in names)
    dx, dy, determinant = x - online_x, y - online_y, P_xx * P_yy - P_xy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (P_yy * dx**2 - 2.0 * P_xy * dx * dy + P_xx * dy**2) / determinant
    return pd.Series(np.where((determinant > 0) & np.isfinite(squared), squared, np.nan), index=frames.index)


def map_distances_in_sigmas(landmarks: pd.DataFrame) -> pd.Series[float]:
    """Median over each last map's landmarks of the Mahalanobis distance (x and y) to the truth or reference.

    By trial and label; NaN where neither knows them.
    """
    if not has_values(landmarks, ["true_x", "P_xx"]):
        return pd.Series(dtype=float)
    names = {f"P_{name}": f"online_P_{name}" for name in ("xx", "xy", "yy")}
    return distances_in_sigmas(landmarks.rename(columns={"x": "online_x", "y": "online_y", **names}))


def _warnings(results: Results) -> Caution | None:
    told = results.manifest.get("warnings", [])
    if not told:
        return None
    return Caution("The measurements are not what one might expect", f"{'; '.join(told)}.")


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


def _cut_short(results: Results) -> Caution | None:
    """Solutions after the last frame that had not come to rest."""
    if not has_values(results.trials, ["final_converged"]):
        return None
    moving = results.trials[results.trials["final_converged"] == 0.0]
    if moving.empty:
        return None
    counts = moving.groupby("label", sort=False).size()
    parts = "; ".join(f"{label}: {count} of its runs" for label, count in counts.items())
    return Caution(
        "Final solutions that were still moving",
        f"{parts}. Their iterations were cut short, so the final columns are not those of the optimum.",
    )


def _own_gates(results: Results) -> Caution | None:
    """The same stream, but not the same observations of it."""
    if not has_values(results.trials, ["own_gate"]):
        return None
    gates = {
        label: results.trials.loc[results.trials["label"] == label, "own_gate"] for label in labels(results)
    }
    gated = [label for label, found in gates.items() if found.notna().any()]
    plain = [label for label, found in gates.items() if found.isna().any()]
    text = (
        f"{', '.join(gated)}: each dropped, of the same stream, what its own covariance did not expect, so "
        "that rows with the same digest rest on different observations. A difference between them is that "
        "of estimator and gate together. NIS is taken over what passed and looks healthy whatever was "
        "dropped; times of updates include the gate."
    )
    if plain:
        text += f" Used every observation: {', '.join(plain)}."
    return Caution("Back ends chose their own observations", text)


def _healthy_but_far(results: Results) -> Caution | None:
    """Runs whose NIS passes while position or map is far off, or whose NEES over the runs tells it."""
    if not has_values(results.trials, ["nis_per_dof"]) or results.frames.empty:
        return None
    position = distances_in_sigmas(results.frames)
    in_map = map_distances_in_sigmas(results.landmarks)
    parts = []
    for point, label, own in runs_by_point(results):
        healthy = own[own["nis_per_dof"].between(*HEALTHY_NIS)]
        if healthy.empty:
            continue
        where = point_name(point)
        name = f"{label}{f' at {where}' if where else ''}: NIS/dof {healthy['nis_per_dof'].median():.2f}"
        told = [
            f"the {what} typically {far.median():.1f} of the claimed standard deviations away "
            f"({far.size} of {len(own)} runs)"
            for what, distances in (("online position is", position), ("last map's landmarks are", in_map))
            if (far := _far(healthy["trial"], label, distances)).size
            and bdtrc(far.size - 1, len(healthy), FAR_CHANCE) < FAR_BY_LUCK
        ]
        if not told:
            told = _average_tells(results, own, len(healthy))
        if told:
            parts.append(f"{name}, yet {' and '.join(told)}")
    if not parts:
        return None
    reference = reference_name(results)
    target = "its own final trajectory" if reference == "none" else f"the {reference}"
    if reference not in ("none", "truth"):
        target = f"the reference {reference}"
    return Caution(
        "A healthy NIS hides a wrong trajectory",
        f"{'; '.join(parts)}. Distances are to {target}. The innovations only test each step against the "
        "map the back end already has; they do not see that the map itself has drifted.",
    )


def _far(trials: pd.Series[Any], label: str, distances: pd.Series[float]) -> pd.Series[float]:
    """Of these trials the distances that a covariance cannot explain."""
    found = distances.reindex(pd.MultiIndex.from_product([trials, [label]]))
    return found[found > FAR_SIGMAS]


def _average_tells(results: Results, own: pd.DataFrame, healthy: int) -> list[str]:
    """Overconfidence too small to see in one run but plain over all: ANEES of the last frame."""
    dof = pose_dimension(results.frames)
    nees = last_frame_nees(results, own)
    if nees.runs < ENOUGH_SEEDS or 2 * healthy < len(own):
        return []
    limit = float(average_band(dof, nees.runs, SURE)[1])
    if nees.average <= limit:
        return []
    return [
        f"the last pose's NEES averages {nees.average:.1f} over {nees.runs} runs where a consistent back end "
        f"stays below {limit:.1f}"
    ]


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


def _borrowed_online_column(results: Results) -> Caution | None:
    """A batch solver that solves once has nothing of its own to say while frames come in."""
    borrowed = warm_started(results)
    if not borrowed:
        return None
    return Caution(
        f"{', '.join(borrowed)}: the online column is the warm start's",
        "This back end solves once, after the last frame. Until then it answers with its warm start (iSAM2, "
        "or dead reckoning), so its online column says nothing about batch; its own result is the final "
        "column, and the time of the final solution stands apart from the updates. every: 1 solves at each "
        "frame.",
    )


def _priors_in_body_axes(results: Results) -> Caution | None:
    """GTSAM's fixed lag is no measure of what a window of that length can know."""
    lags = priors_in_body_axes(results)
    if not lags:
        return None
    return Caution(
        f"{', '.join(lags)}: the prior of what left the lag stands in body axes",
        "GTSAM keeps what it marginalises in the axes of the point where that was linearised, and the "
        "estimate moves away from it: the covariance claims what no sensor saw, and is too small (pose "
        "NEES 8 in the world of dial.yaml, where 3 is expected and a sliding_window of the same length, "
        "with its prior in the world's axes, has 3.2). Its NEES is GTSAM's, and says nothing about "
        "windows.",
    )


def _in_session(results: Results) -> Caution | None:
    """A class of a notebook's cell has no file to be found again by."""
    session = results.manifest.get("in_session")
    if not session:
        return None
    return Caution(
        f"{', '.join(session)}: run in the session's own process",
        "No memory limit held there, the time limit was only looked at between frames, and times include "
        "what else the session did. The text of the class is in the manifest; put it into a file to have it "
        "run like the others.",
    )


def _no_times(results: Results) -> Caution | None:
    """Recording costs time between and inside the frames."""
    if not results.manifest.get("config", {}).get("record"):
        return None
    return Caution(
        "No times were taken",
        "This experiment records: each back end also tells what its linear system claims, or its whole "
        "posterior. That takes time and memory of its own, so neither is told. To compare times, run it "
        "without.",
    )


def _shared_machine(results: Results) -> Caution | None:
    """Jobs side by side disturb each other's times; errors and covariances they leave alone.

    How much they did is told by what a run waited: wall time over processor time.
    """
    jobs = results.manifest.get("jobs") or 1
    if results.manifest.get("config", {}).get("record"):
        return None
    ok = results.trials[results.trials["status"] == "ok"]
    alone = "timed_alone" in ok and bool(len(ok)) and bool(ok["timed_alone"].eq(True).all())
    waited = _waited(ok)
    if waited is not None and waited[0] > WAITED:
        typical, most, who = waited
        by = "Other programs" if alone or jobs < 2 else f"{jobs} jobs side by side"
        return Caution(
            f"{by} disturbed the times",
            f"In the median a run took {typical:.2f} times its own processor time ({who}: {most:.2f} times): "
            "the rest of it, it waited. Compare estimate_processor_s, or run with --times on a quiet "
            "machine.",
        )
    if jobs < 2 or alone:
        return None
    little = ""
    if waited is not None:
        little = (
            f"A run took {waited[0]:.2f} times its own processor time in the median, so hardly one waited "
            "for a core; memory and caches were shared all the same. "
        )
    return Caution(
        f"Times were measured with {jobs} jobs side by side",
        f"{little}They show orders of magnitude. To compare times, run with --times on a quiet machine.",
    )


def _waited(ok: pd.DataFrame) -> tuple[float, float, str] | None:
    """Wall time over processor time: its median over the runs, its largest, and whose that is."""
    if not {"estimate_wall_s", "estimate_processor_s"} <= set(ok.columns):
        return None
    known = ok[ok["estimate_processor_s"] > SHORTEST_S]
    if known.empty:
        return None
    ratios = (known["estimate_wall_s"] / known["estimate_processor_s"]).to_numpy(float)
    worst = known.iloc[int(ratios.argmax())]
    return float(np.median(ratios)), float(ratios.max()), f"{worst['label']}, trial {worst['trial']}"
