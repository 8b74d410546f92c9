"""The stored run behind a row of the trials table: whole poses and covariances, which no table holds."""

from __future__ import annotations

import numpy as np
import pandas as pd

from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.geometry import translation
from slamcmp.registry import did_you_mean
from slamcmp.results.grid import labels, rows_of
from slamcmp.results.runs.run_file import load_run
from slamcmp.results.store import Results
from slamcmp.support.files.packed_files import names_in
from slamcmp.types import Run


def stored_run(results: Results, label: str | None = None, trial: int | None = None) -> Run:
    """The run of a back end on a trial; the only one of either need not be named.

    Raises:
        UsageError: no such label or trial, or there are several to choose from.
        DataError: that run failed before its first frame.
        MissingDataError: the folder's ``runs/`` no longer holds it.
    """
    known = labels(results)
    numbers = sorted({int(each) for each in results.trials["trial"]})
    if trial is not None and trial not in numbers:
        raise UsageError(f"{results.folder} has no trial {trial}: they are {numbers[0]} to {numbers[-1]}")
    if label is None and len(known) > 1:
        raise UsageError(f"{results.folder} holds runs of {', '.join(known)}: say which with --back-end")
    label = known[0] if label is None else label
    if label not in known:
        raise UsageError(f"{results.folder} has no back end {label!r}{did_you_mean(label, known)}")
    own = results.trials[results.trials["label"] == label]
    trials = [int(each) for each in own["trial"]]
    if trial is None and len(trials) > 1:
        raise UsageError(
            f"{label} ran on trials {trials[0]} to {trials[-1]} of {results.folder}: say which with --trial"
        )
    trial = trials[0] if trial is None else trial
    if trial not in trials:
        raise UsageError(
            f"{results.folder} has no trial {trial} of {label}: they are {trials[0]} to {trials[-1]}"
        )
    row = own[own["trial"] == trial].iloc[0]
    frames = rows_of(results.frames, trial, label)
    if frames.empty:
        raise DataError(f"{label}, trial {trial}: {row['status']} before the first frame; there are no poses")
    return _found(results, row, frames)


def _found(results: Results, row: pd.Series, frames: pd.DataFrame) -> Run:
    """The file whose run is the table's, to the last bit: others of the stream may lie beside it."""
    found: Run | None = None
    for name in sorted(names_in(results.folder / "runs")):
        stored = None if name.endswith(".posteriors.npz") else load_run(results.folder / "runs" / name)
        if stored is None or stored.run.digest != row["digest"]:
            continue
        run = stored.run
        positions = translation(run.online.T_world_body)
        columns = [f"online_{axis}" for axis in "xyz"[: positions.shape[1]]]
        final = ["final_x"] if run.final is not None and "final_x" in frames else []
        if len(frames) != len(positions) or not all(name in frames for name in columns):
            continue
        known = frames.sort_values("k")[[*columns, *final]].to_numpy(float)
        values = [positions, *([translation(run.final.T_world_body)[:, :1]] if final and run.final else [])]
        if np.array_equal(known, np.column_stack(values), equal_nan=True):
            if run.back_end == row["label"]:
                return run
            # A label may have changed since the run: it is no part of its key.
            found = run
    if found is None:
        raise MissingDataError(
            f"{results.folder / 'runs'}: has no file of {row['label']} on trial {row['trial']}; run it again"
        )
    return found
