"""A planar log as the recording's own files: odometry, detections, truth, landmarks, and a source of them.

What the source ``recording`` reads of them is the log again: numbers are written so that they read back to
the same bits, and increments carry their covariances. What the files cannot hold is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slamcmp.datasets.plain.plain_motion import COVARIANCE
from slamcmp.datasets.plain.plain_recording import MEASURED, TOLD_BY_COLUMNS
from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import se2_coordinates
from slamcmp.support.files.atomic import write_atomically
from slamcmp.types import GroundTruth, Log

_UNITS = {"range": "m", "bearing": "rad", "x": "m", "y": "m", "theta": "rad"}
_COVARIANCE_TITLES = tuple(
    f"{name}_{unit}"
    for name, unit in zip(COVARIANCE, ("m2", "m2", "m_rad", "m2", "m_rad", "rad2"), strict=True)
)


@dataclass
class Written:
    """The files of a log, and what they do not hold."""

    files: list[Path] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def write_recording(log: Log, folder: Path, *, kind: str = "csv") -> Written:
    """Write the files into ``folder``, as ``csv`` or ``parquet``, and ``experiment.yaml`` that runs them.

    Raises:
        UsageError: the log is not planar, has images or loop closures, or a sensor without columns here.
        DataError: noise of detections that is correlated.
        StorageError: the disk is full or the folder cannot be written.
    """
    sensor = log.problem.sensor
    if sensor.space_dim != 2 or sensor.name not in MEASURED:
        raise UsageError(
            f"{log.name}: a recording's files hold planar logs of {', '.join(MEASURED)}, not of {sensor.name}"
        )
    if log.images is not None or any(each is not None for each in log.relative_poses or ()):
        raise UsageError(f"{log.name}: a recording's files hold neither images nor loop closures")
    written = Written()
    tables = {"odometry": _odometry(log), "detections": _detections(log, MEASURED[sensor.name])}
    if log.truth is not None:
        tables |= {"truth": _truth(log.truth, written.left_out), "landmarks": _landmarks(log)}
    tables = {name: table for name, table in tables.items() if table[1]}
    source = ["source:", "  name: recording", *(f"  {name}: {name}.{kind}" for name in tables)]
    source += _settings(log, written.left_out)
    for name, (titles, rows) in tables.items():
        path = folder / f"{name}.{kind}"
        data = _parquet(titles, rows) if kind == "parquet" else _csv(titles, rows)
        _write(path, data)
        written.files.append(path)
    if log.problem.sensor.name not in TOLD_BY_COLUMNS:
        source.append("front_end: {name: delayed_start}")
    text = "\n".join([*source, "back_ends: [{name: ekf_slam}, {name: batch}, {name: dead_reckoning}]", ""])
    _write(folder / "experiment.yaml", text.encode())
    written.files.append(folder / "experiment.yaml")
    return written


Rows = list[list[float | int | None]]


def _write(path: Path, data: bytes) -> None:
    write_atomically(path, lambda file: file.write(data))


def _odometry(log: Log) -> tuple[list[str], Rows]:
    upper = np.triu_indices(3)
    steps = se2_coordinates(log.T_prev_body)
    rows: Rows = np.column_stack([log.t, steps, log.Q[:, upper[0], upper[1]]]).tolist()
    return ["t_s", "dx_m", "dy_m", "dtheta_rad", *_COVARIANCE_TITLES], rows


def _detections(log: Log, columns: Sequence[str]) -> tuple[list[str], Rows]:
    titles = ["t_s", "id", *(f"{name}_{_UNITS[name]}" for name in columns)]
    titles += [f"sigma_{name}_{_UNITS[name]}" for name in columns]
    rows: Rows = []
    for t, seen in zip(log.t.tolist(), log.detections, strict=True):
        if np.abs(seen.R * (1 - np.eye(len(columns)))).max(initial=0.0) > 0:
            raise DataError(
                f"{log.name}: at {t:.9g} s the noise of a detection is correlated; the files hold sigmas"
            )
        sigmas = np.sqrt(np.diagonal(seen.R, axis1=1, axis2=2))
        for label, z, sigma in zip(seen.ids.tolist(), seen.z.tolist(), sigmas.tolist(), strict=True):
            rows.append([t, None if label < 0 else _name(log, label), *z, *sigma])
    return titles, rows


def _name(log: Log, label: int) -> int:
    return label if log.own_ids is None else int(log.own_ids[label])


def _truth(truth: GroundTruth, left_out: list[str]) -> tuple[list[str], Rows]:
    known = truth.known()
    columns = [truth.t[known], *se2_coordinates(truth.T_world_body[known]).T]
    titles = ["t_s", "x_m", "y_m", "theta_rad"]
    if truth.P is not None:
        R = truth.T_world_body[known, :2, :2]
        P = truth.P[known].copy()
        P[:, :2, :2] = R @ P[:, :2, :2] @ np.swapaxes(R, 1, 2)
        diagonal = np.diagonal(P, axis1=1, axis2=2)
        if np.abs(P - diagonal[:, :, None] * np.eye(3)).max(initial=0.0) > 1e-9 * np.abs(P).max(initial=1.0):
            left_out.append("correlations of the truth's own covariance")
        columns += list(np.sqrt(diagonal).T)
        titles += ["sigma_x_m", "sigma_y_m", "sigma_theta_rad"]
    return titles, np.column_stack(columns).tolist()


def _landmarks(log: Log) -> tuple[list[str], Rows]:
    assert log.truth is not None
    pairs = zip(log.truth.ids.tolist(), log.truth.positions.tolist(), strict=True)
    return ["id", "x_m", "y_m"], [[_name(log, label), *place] for label, place in pairs]


def _settings(log: Log, left_out: list[str]) -> list[str]:
    """What the source needs beside the files."""
    P, first = log.problem.P, log.problem.T_world_body
    sigmas = np.sqrt(np.diagonal(P))
    if np.abs(P - np.diag(np.diagonal(P))).max() > 0 or sigmas[0] != sigmas[1]:
        left_out.append("the prior's covariance beyond one sigma of position and one of heading")
    x, y, theta = se2_coordinates(first).tolist()
    sensor = log.problem.sensor.name
    return [
        *([] if sensor in TOLD_BY_COLUMNS else [f"  sensor: {sensor}"]),
        "  frames: odometry",
        f"  start_pose: [{x!r}, {y!r}, {theta!r}]",
        f"  prior_position_sigma_m: {float(sigmas[:2].max())!r}",
        f"  prior_heading_sigma_rad: {float(sigmas[2])!r}",
        # It stands at each frame that it knows: nothing is interpolated, and its gaps stay gaps.
        *([] if log.truth is None else ["  truth_max_gap_s: 1.0e-6"]),
    ]


def _csv(titles: list[str], rows: Rows) -> bytes:
    # repr is the shortest text that reads back to the same bits.
    lines = [",".join(titles), *(",".join("" if x is None else repr(x) for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _parquet(titles: list[str], rows: Rows) -> bytes:
    import io

    import pandas as pd

    buffer = io.BytesIO()
    frame = pd.DataFrame(rows, columns=titles)
    if "id" in frame:
        frame["id"] = frame["id"].astype("Int64")
    frame.to_parquet(buffer)
    return buffer.getvalue()
