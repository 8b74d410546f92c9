"""Runs and truths as npz files: arrays and a JSON header, no pickle."""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.npz import read_arrays
from slamcmp.support.files.packed_files import content
from slamcmp.types import Association, BoolArray, GroundTruth, IntArray, Landmarks, Run, Trajectory
from slamcmp.types.columns import parts

RUN_FORMAT = "slamcmp-run-1"
TRUTH_FORMAT = "slamcmp-truth-1"
RUN_HEADER = (
    "back_end",
    "parameters",
    "digest",
    "seed",
    "frames",
    "status",
    "message",
    "final_s",
    "final_diagnostics",
    "peak_memory_mb",
    "versions",
)
LATER = ("wall_s", "processor_s")
"""Numbers of a run's header that files of older versions do not have."""
SERIES = "diagnostics/"
Stored = TypeVar("Stored")


@dataclass(frozen=True)
class StoredRun:
    """A run with its scores against the truth."""

    run: Run
    scores: Mapping[str, float]
    completion: float
    """Kept apart from the run's own: of a killed worker only the number of frames is left."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """What was read beside what the key names, by path: digests."""
    scored_against: str = ""
    """Digest of the truth; the stream's own digest does not cover it."""
    timed_alone: bool = False
    """Whether no other job ran beside it."""


@dataclass(frozen=True)
class StoredTruth:
    """What is known about the stream of a stream job, and the truth if its log has one."""

    digest: str
    frames: int
    truth: GroundTruth | None
    """Its ``outliers`` mark the stream's observations, not the log's detections."""
    front_end: Mapping[str, int]
    """Totals of the front end's report."""
    error: tuple[str, str] | None = None
    """Type and message, where the stream could not be made."""
    warnings: tuple[str, ...] = ()
    """Of the log."""
    own_ids: IntArray | None = None
    """The recording's own names of the landmarks 0 … L - 1, where they have others."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """What was read beside what the key names, by path: digests."""
    association: Association | None = None
    """What a front end decided that was told no labels."""


def save_run(stored: StoredRun, path: Path) -> None:
    """Write one run; the joint covariance is not kept (its scores are)."""
    run = stored.run
    header = {
        "format": RUN_FORMAT,
        **{name: getattr(run, name) for name in (*RUN_HEADER, *LATER)},
        "timed_alone": stored.timed_alone,
        "scores": dict(stored.scores),
        "completion": stored.completion,
        "inputs": dict(stored.inputs),
        "scored_against": stored.scored_against,
    }
    arrays: dict[str, Any] = {"update_s": run.update_s, "estimate_s": run.estimate_s}
    for name, trajectory in (("online", run.online), ("final", run.final)):
        if trajectory is not None:
            arrays[f"{name}_t"], arrays[f"{name}_T"] = trajectory.t, trajectory.T_world_body
            if trajectory.P is not None:
                arrays[f"{name}_P"] = trajectory.P
    if run.landmarks is not None:
        arrays["ids"] = run.landmarks.ids
        arrays["positions"] = run.landmarks.positions
        arrays["covariances"] = run.landmarks.covariances
    if run.kept_observations is not None:
        arrays |= _joined("kept", run.kept_observations)
    arrays.update({SERIES + name: column for name, column in run.diagnostics.items()})
    _save(path, header, arrays)


def load_run(path: Path) -> StoredRun | None:
    """The stored run, or None where there is none that can be read: it has to be computed again."""
    return _load(path, RUN_FORMAT, _rebuild_run)


def truth_digest(truth: GroundTruth | None) -> str:
    """sha256 over a truth; empty where there is none."""
    if truth is None:
        return ""
    hasher = hashlib.sha256()
    for array in (truth.t, truth.T_world_body, truth.ids, truth.positions):
        hasher.update(_named(array.shape, array.dtype.str) + np.ascontiguousarray(array).tobytes())
    masks = () if truth.outliers is None else truth.outliers
    hasher.update(b"".join(_named(mask.shape, mask.dtype.str) + mask.tobytes() for mask in masks))
    return hasher.hexdigest()


@functools.cache
def _named(shape: tuple[int, ...], kind: str) -> bytes:
    return repr((shape, kind)).encode()


def relabelled(stored: StoredRun, label: str) -> StoredRun:
    """The same under the label the experiment now gives the back end: labels are no part of a key."""
    return replace(stored, run=replace(stored.run, back_end=label))


def save_truth(stored: StoredTruth, path: Path) -> None:
    """Write what a stream job found out."""
    header = {
        "format": TRUTH_FORMAT,
        "digest": stored.digest,
        "frames": stored.frames,
        "front_end": dict(stored.front_end),
        "error": stored.error,
        "warnings": list(stored.warnings),
        "inputs": dict(stored.inputs),
    }
    arrays: dict[str, Any] = {}
    truth = stored.truth
    if truth is not None:
        arrays = {"t": truth.t, "T": truth.T_world_body, "ids": truth.ids, "positions": truth.positions}
        if truth.outliers is not None:
            arrays |= _joined("outliers", truth.outliers)
        if truth.P is not None:
            arrays["P"] = truth.P
    if stored.own_ids is not None:
        arrays["own_ids"] = stored.own_ids
    if stored.association is not None:
        arrays |= _association_arrays(stored.association)
    _save(path, header, arrays)


def load_truth(path: Path) -> StoredTruth | None:
    """What a stream job found out, or None where there is nothing that can be read."""
    return _load(path, TRUTH_FORMAT, _rebuild_truth)


def _rebuild_run(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> StoredRun:
    landmarks = None
    if "ids" in arrays:
        landmarks = Landmarks(arrays["ids"], arrays["positions"], arrays["covariances"])
    online = _trajectory("online", arrays)
    assert online is not None
    run = Run(
        **{name: header[name] for name in RUN_HEADER},
        **{name: header.get(name, math.nan) for name in LATER},
        online=online,
        final=_trajectory("final", arrays),
        update_s=arrays["update_s"],
        estimate_s=arrays["estimate_s"],
        landmarks=landmarks,
        kept_observations=_masks("kept", arrays),
        diagnostics={
            name.removeprefix(SERIES): array for name, array in arrays.items() if name.startswith(SERIES)
        },
    )
    return StoredRun(
        run,
        header["scores"],
        header["completion"],
        header.get("inputs", {}),
        header.get("scored_against", ""),
        header.get("timed_alone", False),
    )


def _rebuild_truth(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> StoredTruth:
    truth = None
    if "t" in arrays:
        outliers = _masks("outliers", arrays)
        truth = GroundTruth(
            arrays["t"], arrays["T"], arrays["ids"], arrays["positions"], outliers, arrays.get("P")
        )
    error = tuple(header["error"]) if header["error"] else None
    warnings = tuple(header["warnings"])
    return StoredTruth(
        header["digest"],
        header["frames"],
        truth,
        header["front_end"],
        error,
        warnings,
        arrays.get("own_ids"),
        header.get("inputs", {}),
        _association(arrays),
    )


def _association_arrays(association: Association) -> dict[str, Any]:
    sizes = np.array([ids.size for ids in association.ids], dtype=np.int64)
    columns = {name: getattr(association, name) for name in ("ids", "labels", "points")}
    joined = {f"association_{name}": np.concatenate(column) for name, column in columns.items()}
    return {"association_sizes": sizes, **joined}


def _association(arrays: Mapping[str, Any]) -> Association | None:
    if "association_sizes" not in arrays:
        return None
    columns = (arrays[f"association_{name}"] for name in ("ids", "labels", "points"))
    return Association(*(tuple(parts(column, arrays["association_sizes"])) for column in columns))


def _trajectory(name: str, arrays: Mapping[str, Any]) -> Trajectory | None:
    if f"{name}_t" not in arrays:
        return None
    return Trajectory(arrays[f"{name}_t"], arrays[f"{name}_T"], arrays.get(f"{name}_P"))


def _joined(name: str, masks: Sequence[BoolArray]) -> dict[str, Any]:
    """Masks of different lengths as two arrays."""
    sizes = np.array([mask.size for mask in masks], dtype=np.int64)
    return {name: np.concatenate([np.empty(0, dtype=bool), *masks]), f"{name}_sizes": sizes}


def _masks(name: str, arrays: Mapping[str, Any]) -> tuple[BoolArray, ...] | None:
    if name not in arrays:
        return None
    return tuple(parts(arrays[name], arrays[f"{name}_sizes"]))


def _json(value: Any) -> Any:
    """Mappings that are not dicts and numpy's scalars, as JSON knows them."""
    return dict(value) if isinstance(value, Mapping) else float(value)


def _save(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    text = np.frombuffer(json.dumps(header, default=_json).encode(), dtype=np.uint8)
    write_atomically(path, lambda file: np.savez(file, header=text, **arrays))


def _load(
    path: Path, expected: str, rebuild: Callable[[Mapping[str, Any], Mapping[str, Any]], Stored]
) -> Stored | None:
    try:
        arrays: dict[str, Any] = read_arrays(content(path))
        header = json.loads(arrays.pop("header").tobytes())
        return rebuild(header, arrays) if header["format"] == expected else None
    except MemoryError:
        # The file is as good as before.
        raise
    except Exception:
        # A damaged or older file is a result that has to be computed again, not an error; a changed byte
        # surfaces as whatever zipfile, zlib, numpy or json meet first, up to NotImplementedError (an
        # unknown compression) and RuntimeError ("encrypted").
        return None
