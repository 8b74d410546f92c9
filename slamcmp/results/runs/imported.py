"""Trajectories that other programs estimated, as runs in a results folder like any other.

Every pose of an estimate is scored against the truth at its own instant: the truth's position linear between
its neighbours, its rotation by SLERP, nothing outside its span and in gaps above a tolerance. Runs on one
truth are one trial, for their digest is that of the truth. What is not known of such a run is missing, never
zero: times and memory, landmarks, and without a covariance every NEES.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from slamcmp.datasets.trajectories import MAX_GAP_S, poses_at
from slamcmp.datasets.trajectory_files import ReadTrajectory, TrajectoryFormat, read_trajectory
from slamcmp.errors import DataError, UsageError
from slamcmp.metrics import frame_table, landmark_table, score_run
from slamcmp.results.runs.of_runs import outcome
from slamcmp.results.runs.run_file import StoredRun, load_run, save_run
from slamcmp.results.store import IMPORTED, MANIFEST, Results, load_results, save_results
from slamcmp.support.files.paths import is_file
from slamcmp.types import FloatArray, GroundTruth, Run, Trajectory

SAME_STAMP_S = 1e-6
"""Within which the stamps of an online and a final trajectory are those of one run."""
Which = Literal["online", "final"]


@dataclass(frozen=True)
class Import:
    """One trajectory to take in."""

    file: Path
    truth: Path
    label: str
    which: Which
    """Whether the poses are what was known at their time, or with hindsight: nothing in a file tells."""
    repetition: int = 0
    """Of several runs of one system on one truth its number."""
    format: TrajectoryFormat | None = None
    truth_format: TrajectoryFormat | None = None
    times: Path | None = None
    """Stamps of KITTI's poses."""
    max_gap_s: float = MAX_GAP_S
    time_offset_s: float = 0.0
    """Added to the estimate's stamps."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """What the system was set to, as configurations show it."""


def import_runs(folder: Path, imports: list[Import], *, replaced: bool = False) -> Results:
    """Take trajectories into ``folder``, beside what was imported there before.

    A label that the folder has on the same truth gets its other trajectory (online, final) where the stamps
    are the same; ``replaced`` lets it take the place of one that is there.

    Raises:
        UsageError: the folder holds an experiment's results, or the run is there already.
        MissingDataError: a file is not there.
        DataError: a file is of no known format, no stamp lies within the truth, or spaces differ.
    """
    known = _known(folder)
    entries = {} if known is None else {str(e["label"]): e for e in known.manifest["config"]["back_ends"]}
    tables = [] if known is None else [[known.trials, known.frames, known.landmarks]]
    about = [] if known is None else list(known.manifest["imports"])
    for each in imports:
        added, note = _read(each, folder, about, replaced=replaced)
        tables = [[_without(table, added) for table in group] for group in tables] + [_tables(added)]
        save_run(StoredRun(added.run, {}, 1.0), _run_path(folder, added))
        about = [old for old in about if _identity(old) != _identity(note)] + [note]
        entries[each.label] = {
            "name": IMPORTED, "label": each.label, **entries.get(each.label, {}), **each.parameters
        }  # fmt: skip
    joined = [pd.concat(part, ignore_index=True) for part in zip(*tables, strict=True)]
    trials = joined[0].astype({"seed": "Int64"})
    seeds = sorted({int(seed) for seed in trials["seed"]})
    manifest = {
        "name": folder.name,
        "question": "",
        "config": {
            "name": folder.name,
            "source": {"name": IMPORTED, "truth": sorted({each["truth"] for each in about})},
            "back_ends": list(entries.values()),
            "sweep": {},
            "seeds": seeds,
        },
        "seeds": seeds,
        "imports": about,
        "warnings": [_sentence(each) for each in about],
        "jobs_missing": 0,
    }
    results = Results(folder, manifest, trials, joined[1], joined[2])
    save_results(results)
    return results


@dataclass(frozen=True)
class _Added:
    """A run with the truth at its own stamps."""

    run: Run
    truth: GroundTruth

    @property
    def key(self) -> tuple[str, str, int]:
        assert self.run.seed is not None
        return self.run.digest, self.run.back_end, self.run.seed


def _known(folder: Path) -> Results | None:
    if not is_file(folder / MANIFEST):
        return None
    found = load_results(folder)
    if "imports" not in found.manifest:
        raise UsageError(
            f"{folder} holds the results of an experiment; imported runs need a folder of their own "
            "(--results), and 'slamcmp compare' holds the two against each other"
        )
    return found


def _read(
    each: Import, folder: Path, about: list[dict[str, Any]], *, replaced: bool
) -> tuple[_Added, dict[str, Any]]:
    """The run, and what the manifest says about where it is from."""
    estimate = read_trajectory(each.file, each.format, times=each.times)
    kind = each.truth_format
    times = each.times if kind in (None, "kitti") and estimate.format == "kitti" else None
    truth = _read_truth(each.truth, kind, times)
    if estimate.stamped != truth.stamped:
        raise DataError(
            f"{each.file if not estimate.stamped else each.truth}: has no time stamps, and the other has; "
            "--times names a file with one stamp a line"
        )
    if not estimate.stamped and estimate.trajectory.t.size != truth.trajectory.t.size:
        raise DataError(
            f"{each.file}: {estimate.trajectory.t.size} poses without stamps, and {truth.trajectory.t.size} "
            "of the truth: without stamps (--times) pose k belongs to pose k"
        )
    trajectory = estimate.trajectory
    t = trajectory.t + each.time_offset_s
    moved = Trajectory(t, trajectory.T_world_body, trajectory.P)
    true = _truth_at(each, moved, truth, stamped=estimate.stamped)
    digest = _digest(truth.trajectory)
    seed = _sample(about, digest, each.repetition)
    run = _run(each, moved, digest, seed)
    added = _completed(_Added(run, true), each, folder, replaced=replaced)
    inside = int(true.known().sum())
    note = {
        "label": each.label,
        "seed": seed,
        "digest": digest,
        "repetition": each.repetition,
        "trajectory": each.which,
        "file": str(each.file),
        "format": estimate.format,
        "truth": str(each.truth),
        "truth_format": truth.format,
        "interpolation": "linear and SLERP" if estimate.stamped else "none: pose k belongs to pose k",
        "max_gap_s": each.max_gap_s,
        "time_offset_s": each.time_offset_s,
        "poses": int(t.size),
        "poses_with_truth": inside,
        "covariance": trajectory.P is not None,
        "told": [*estimate.told, *truth.told],
    }
    return added, note


def _read_truth(path: Path, kind: TrajectoryFormat | None, times: Path | None) -> ReadTrajectory:
    if times is None:
        return read_trajectory(path, kind)
    try:
        return read_trajectory(path, kind, times=times)
    except DataError:
        # A truth with stamps of its own, for poses that got theirs from the file of times.
        if kind == "kitti":
            raise
        found = read_trajectory(path, kind)
        if not found.stamped:
            raise
        return found


def _truth_at(each: Import, moved: Trajectory, truth: ReadTrajectory, *, stamped: bool) -> GroundTruth:
    poses = truth.trajectory.T_world_body
    if poses.shape[-1] != moved.T_world_body.shape[-1]:
        dims = [shape - 1 for shape in (moved.T_world_body.shape[-1], poses.shape[-1])]
        raise DataError(
            f"{each.file}: poses in {dims[0]} dimensions, and {each.truth} has {dims[1]}; both must be alike"
        )
    n = poses.shape[-1] - 1
    if stamped:
        poses = _poses_at(moved.t, truth.trajectory, each.max_gap_s)
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        stamps = truth.trajectory.t
        raise DataError(
            f"{each.file}: no stamp, {moved.t[0]:.9g} to {moved.t[-1]:.9g} s, has a truth; {each.truth} is "
            f"from {stamps[0]:.9g} to {stamps[-1]:.9g} s and is interpolated over gaps up to "
            f"{each.max_gap_s:g} s: another clock (--time-offset), or sparser poses (--max-gap)?"
        )
    return GroundTruth(moved.t, poses, np.empty(0, np.int64), np.empty((0, n)))


def _poses_at(t: FloatArray, truth: Trajectory, max_gap_s: float) -> FloatArray:
    """The truth at other instants; planar poses through space, where the interpolation is written."""
    from slamcmp.datasets.trajectory_files import in_space

    found = poses_at(t, truth.t, in_space(truth.T_world_body), max_gap_s=max_gap_s)
    if truth.T_world_body.shape[-1] == 4:
        return found
    rows = np.array([0, 1, 3])
    planar: FloatArray = found[:, rows[:, None], rows]
    return planar


def _digest(truth: Trajectory) -> str:
    """Of the truth: what runs of the same trial have in common."""
    hasher = hashlib.sha256(b"imported")
    for array in (truth.t, truth.T_world_body):
        hasher.update(repr((array.shape, array.dtype.str)).encode() + np.ascontiguousarray(array).tobytes())
    return hasher.hexdigest()


def _sample(about: list[dict[str, Any]], digest: str, repetition: int) -> int:
    """The number of the sample and of its trial: that of the same truth and repetition, or a new one."""
    same = [note["seed"] for note in about if (note["digest"], note["repetition"]) == (digest, repetition)]
    return int(same[0]) if same else 1 + max((int(note["seed"]) for note in about), default=-1)


def _run(each: Import, moved: Trajectory, digest: str, seed: int) -> Run:
    frames = moved.t.size
    unknown = np.full(frames, math.nan)
    online, final = moved, None
    if each.which == "final":
        online, final = Trajectory(moved.t, np.full_like(moved.T_world_body, math.nan)), moved
    return Run(
        each.label, dict(each.parameters), digest, seed, frames, "ok", "",
        online=online, final=final, update_s=unknown, estimate_s=unknown, final_s=math.nan,
    )  # fmt: skip


def _run_path(folder: Path, added: _Added) -> Path:
    name = hashlib.sha256("\0".join(map(str, added.key)).encode("utf-8", "surrogatepass")).hexdigest()[:24]
    return folder / "runs" / f"{IMPORTED}-{name}.npz"


def _completed(added: _Added, each: Import, folder: Path, *, replaced: bool) -> _Added:
    """With the other trajectory of the same run, where the folder has it."""
    stored = load_run(_run_path(folder, added))
    if stored is None:
        return added
    old, new = stored.run, added.run
    had = {"online": bool(np.isfinite(old.online.T_world_body).all()), "final": old.final is not None}
    if had[each.which] and not replaced:
        raise UsageError(
            f"{folder} has the {each.which} trajectory of {each.label!r} (run {new.seed}) already; "
            "--replace puts this one in its place, another --as beside it"
        )
    other: Which = "final" if each.which == "online" else "online"
    same = old.online.t.size == new.online.t.size and np.allclose(
        old.online.t, new.online.t, rtol=0.0, atol=SAME_STAMP_S
    )
    if not had[other]:
        return added
    if not same:
        raise DataError(
            f"{each.file}: its stamps are not those of the {other} trajectory of {each.label!r}; as another "
            "run they need another --as"
        )
    if each.which == "online":
        assert old.final is not None
        final = Trajectory(new.online.t, old.final.T_world_body, old.final.P)
        return replace(added, run=replace(new, final=final))
    return replace(
        added, run=replace(new, online=Trajectory(new.online.t, old.online.T_world_body, old.online.P))
    )


def _without(table: pd.DataFrame, added: _Added) -> pd.DataFrame:
    digest, label, seed = added.key
    return table[~((table["digest"] == digest) & (table["label"] == label) & (table["seed"] == seed))]


def _tables(added: _Added) -> list[pd.DataFrame]:
    run, truth = added.run, added.truth
    keys: dict[str, Any] = {
        "trial": run.seed,
        "label": run.back_end,
        "back_end": IMPORTED,
        "seed": run.seed,
        "digest": run.digest,
        "own_gate": math.nan,
    }
    row = {**keys, **score_run(run, truth), **outcome(run, 1.0, "truth")}
    # Nobody has timed it, and a sum over nothing would read as fast.
    row |= dict.fromkeys(("update_s", "estimate_s", "final_s", "final_solution_s"), math.nan)
    frames = frame_table(run, truth, taken=keys).assign(**keys)
    return [pd.DataFrame([row]), frames, landmark_table(run, truth).assign(**keys)]


def _identity(note: Mapping[str, Any]) -> tuple[Any, ...]:
    return note["label"], note["seed"], note["trajectory"], note["truth"]


def _sentence(note: Mapping[str, Any]) -> str:
    """How it was associated, as a reader of the table must know it."""
    if note["interpolation"].startswith("none"):
        how = "pose by pose"
    else:
        offset = f", its stamps {note['time_offset_s']:+g} s" if note["time_offset_s"] else ""
        how = (
            f"interpolated ({note['interpolation']}) at its stamps{offset}, over gaps up to "
            f"{note['max_gap_s']:g} s"
        )
    told = "".join(f"; {each}" for each in note["told"])
    without = "" if note["covariance"] else "; no covariance, so no NEES"
    run = f" (run {note['seed']})" if note["seed"] else ""
    return (
        f"imported: {note['label']}{run}, {note['trajectory']}: {note['poses_with_truth']} of "
        f"{note['poses']} poses have a truth, {how}{without}{told}"
    )
