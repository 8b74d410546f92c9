"""What is wrong with a log in plain files, before anyone runs a filter on it.

Each finding is one line: what, where, how much. Facts are lines too, for those who know their robot. Offsets
and scales are estimated from yaw rates and speeds, which do not depend on where the two worlds lie.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcmp.datasets.plain.clock_offset import LARGE_S, ClockOffset, clock_offset
from slamcmp.datasets.plain.column_files import Table, read_table
from slamcmp.datasets.plain.plain_motion import KINDS, Motion, read_motion
from slamcmp.datasets.plain.plain_roles import Role, roles_of
from slamcmp.datasets.plain.seen_places import seen_places
from slamcmp.datasets.trajectories import poses_at, read_tum_trajectory
from slamcmp.errors import SlamcmpError
from slamcmp.geometry import se2, wrap
from slamcmp.types import FloatArray

GAP = 2.5
"""Times the usual step: from there on a step is a gap."""
LONG_GAP_S = 0.5
"""What is interpolated over a longer gap is compared with nothing."""
OFFSETS_S: FloatArray = np.linspace(-2.0, 2.0, 401)
"""Clock offsets that are tried."""
GRID_S = 0.02
"""Between the instants at which rates are compared."""
LARGE_SCALE = 0.02
"""Of odometry against truth: share of the distance, or of the turns."""
OUTLIER_SIGMAS = 5.0
LARGE_SHARE = 0.01
LARGE_BIAS = 0.25
"""Of a sensor's mean error, in its own standard deviations."""


@dataclass(frozen=True)
class AgainstTruth:
    """Odometry beside the truth."""

    offsets_s: FloatArray
    clock: ClockOffset
    """What each of them gives."""
    speeds: tuple[FloatArray, FloatArray]
    """The odometry's [m/s] and the truth's, at the same instants by that offset."""
    turns: tuple[FloatArray, FloatArray]
    """The yaw rates [rad/s], likewise."""


@dataclass(frozen=True)
class ComponentErrors:
    """Of one component of the detections the errors against truth, and what was made of them."""

    unit: str
    t: FloatArray
    errors: FloatArray
    middle: float
    sigma: float
    """Robust: of the median's absolute deviations."""


@dataclass
class Report:
    """What was found in a log, in words and as what a plot shows."""

    facts: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    """What is wrong, each in one line."""
    stamps: dict[str, FloatArray] = field(default_factory=dict)
    """By file name the instants (rows,) [s], in order."""
    against_truth: AgainstTruth | None = None
    sightings: dict[int, int] = field(default_factory=dict)
    """By landmark."""
    errors: dict[str, ComponentErrors] = field(default_factory=dict)
    """By component."""


@dataclass
class _Log:
    odometry: tuple[Table, Motion] | None = None
    detections: Table | None = None
    truth: tuple[Path, FloatArray, FloatArray] | None = None
    """Stamps (K,) and x, y, theta (K, 3)."""
    landmarks: Table | None = None


def check_files(
    paths: Sequence[Path], *, metres_per_tick: float | None = None, track_m: float | None = None
) -> Report:
    """Look into the files of one log; what each holds, its columns tell.

    Of two tables of ``t, x, y, theta`` their names tell which is the odometry (plain_roles.py).
    """
    report, log = Report(), _Log()
    tables: list[Table] = []
    for path in paths:
        try:
            if path.suffix == ".txt":
                told: list[str] = []
                stamps, T = read_tum_trajectory(path, told=told)
                report.findings += told
                planar = np.stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])], axis=1)
                log.truth = path, stamps, planar
            else:
                tables.append(read_table(path))
        except SlamcmpError as error:
            report.findings.append(str(error))
    roles = roles_of(tables, truth_is_known=log.truth is not None)
    for table, role in zip(tables, roles, strict=True):
        report.findings += table.warnings
        if "t" in table.columns:
            # Several detections of one instant are usual, and pauses between them; not so in other files.
            _stamps(table, report, alone=role != "detections")
        try:
            _sort_in(table, role, log, metres_per_tick, track_m)
        except SlamcmpError as error:
            report.findings.append(str(error))
    if log.odometry is not None and log.detections is not None:
        _outside(log.odometry[1].t, log.detections.columns["t"], log.detections.path.name, report)
    if log.odometry is not None and log.truth is not None:
        _outside(log.truth[1], log.odometry[1].t, log.odometry[0].path.name, report, of="truth")
        _against_truth(log.odometry[1], log.truth, report)
    if log.detections is not None:
        _landmarks(log.detections, log.landmarks, report)
    if log.detections is not None and log.truth is not None:
        _innovations(log.detections, log.truth, log.landmarks, report)
    return report


def _stamps(table: Table, report: Report, *, alone: bool) -> None:
    """Steps back, repeated stamps, gaps."""
    t, name = table.columns["t"], table.path.name
    instants = np.unique(t)
    report.stamps[name] = instants
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0)
    if back.size:
        report.findings.append(
            f"{table.where(int(back[0]) + 1)}: time goes back by {-steps[back[0]]:.3g} s, the first of "
            f"{back.size} such rows"
        )
    repeated = t.size - instants.size
    if repeated and alone:
        first = int(np.flatnonzero(steps == 0)[0]) + 1 if (steps == 0).any() else 0
        report.findings.append(
            f"{table.where(first)}: a time stamp for the second time, the first of {repeated}"
        )
    if instants.size < 3:
        return
    usual = float(np.median(np.diff(instants)))
    report.facts.append(
        f"{name}: {t.size} rows over {instants[-1] - instants[0]:.6g} s, usually {usual:.3g} s apart"
    )
    if alone:
        wide = np.flatnonzero(np.diff(instants) > GAP * usual)
        if wide.size:
            longest = wide[np.argmax(np.diff(instants)[wide])]
            row = int(np.flatnonzero(t == instants[longest + 1])[0])
            report.findings.append(
                f"{table.where(row)}: a gap of {instants[longest + 1] - instants[longest]:.3g} s "
                "before this row, the longest "
                f"of {wide.size} above {GAP} times the usual {usual:.3g} s"
            )


def _sort_in(
    table: Table, role: Role, log: _Log, metres_per_tick: float | None, track_m: float | None
) -> None:
    if role == "detections":
        log.detections = table
    elif role == "landmarks":
        log.landmarks = table
    elif role == "truth" and log.truth is None and table.has("t", *KINDS["poses"]):
        order = np.unique(table.columns["t"], return_index=True)[1]
        poses = np.stack([table.columns[name][order] for name in KINDS["poses"]], axis=1)
        log.truth = table.path, table.columns["t"][order], poses
    else:
        order = (
            np.unique(table.columns["t"], return_index=True)[1] if "t" in table.columns else np.empty(0, int)
        )
        sorted_ = Table(
            table.path, {n: c[order] for n, c in table.columns.items()}, None, [table.lines[k] for k in order]
        )
        log.odometry = table, read_motion(sorted_, metres_per_tick=metres_per_tick, track_m=track_m)


def _outside(known: FloatArray, t: FloatArray, name: str, report: Report, of: str = "odometry") -> None:
    outside = int(((t < known.min()) | (t > known.max())).sum())
    if outside:
        report.findings.append(
            f"{name}: {outside} of {t.size} rows are outside the {of}'s time, {known.min():.9g} to "
            f"{known.max():.9g} s"
        )


def _against_truth(motion: Motion, truth: tuple[Path, FloatArray, FloatArray], report: Report) -> None:
    """Clock offset and scale of the odometry."""
    path, stamps, poses = truth
    grid = np.arange(max(motion.t[0], stamps[0]) + 2.5, min(motion.t[-1], stamps[-1]) - 2.5, GRID_S)
    apart = _far_from_gaps(grid, motion.t) & _far_from_gaps(grid, stamps)
    # A log that is nothing but gaps is compared as it is.
    grid = grid[apart] if apart.sum() >= 100 else grid
    if grid.size < 100 or stamps.size < 10:
        report.facts.append(
            f"{path.name}: too little in common with the odometry to compare clocks and scales"
        )
        return
    heading = np.unwrap(poses[:, 2])
    path_length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    turned, driven = (
        np.concatenate([[0.0], np.cumsum(column * np.diff(motion.t))])
        for column in (motion.twists[:, 2], np.hypot(motion.twists[:, 0], motion.twists[:, 1]))
    )
    half = 0.1

    def rates(t: FloatArray, at: FloatArray, total: FloatArray) -> FloatArray:
        """Means over 0.2 s, so that neither's noise or steps decide."""
        rate: FloatArray = (np.interp(at + half, t, total) - np.interp(at - half, t, total)) / (2 * half)
        return rate

    own = rates(motion.t, grid, turned), rates(motion.t, grid, driven)
    found = clock_offset(
        own,
        lambda offset: (
            rates(stamps, grid + offset, heading),
            rates(stamps, grid + offset, path_length),
        ),
        OFFSETS_S,
        grid.size * GRID_S,
        max(2 * half, float(np.median(np.diff(motion.t)))),
    )
    _tell_clock(found, path, report)
    offset = found.offset_s
    theirs = rates(stamps, grid + offset, heading), rates(stamps, grid + offset, path_length)
    report.against_truth = AgainstTruth(OFFSETS_S, found, (own[1], theirs[1]), (own[0], theirs[0]))
    for what, a, b in zip(("turns", "distances"), own, theirs, strict=True):
        if not a.std() > 1e-6:
            continue
        scale = float(a @ b / (a @ a))
        report.facts.append(
            f"odometry against {path.name}: true {what} are {scale:.3f} times the measured ones"
        )
        if abs(scale - 1) > LARGE_SCALE:
            report.findings.append(
                f"odometry: true {what} are {scale:.3f} times the measured ones, where 1 is expected"
            )


def _tell_clock(found: ClockOffset, path: Path, report: Report) -> None:
    what = f"odometry against {path.name}: clock offset"
    if not found.tells:
        report.facts.append(f"{what} not known: speed and yaw rate vary too little to compare clocks")
        return
    hidden = LARGE_S <= abs(found.offset_s) < found.resolved_s
    within = f", which such steps do not resolve (from {found.resolved_s:.2f} s on)" if hidden else ""
    report.facts.append(f"{what} {found.offset_s:+.2f} s{within}")
    if found.is_large:
        who = "leads" if found.offset_s > 0 else "lags"
        report.findings.append(
            f"odometry {who} the truth by {abs(found.offset_s):.2f} s (from yaw rate and speed): set "
            f"odometry_offset_s to {found.offset_s:+.2f}"
        )


def _far_from_gaps(grid: FloatArray, known: FloatArray) -> NDArray[np.bool_]:
    """Which instants, moved by any of the offsets, lie where something was recorded: (grid,)."""
    steps = np.diff(known)
    wide = np.flatnonzero(steps > max(GAP * float(np.median(steps)), LONG_GAP_S))
    far = np.ones(grid.size, dtype=bool)
    reach = float(OFFSETS_S[-1]) + 0.5
    for k in wide.tolist():
        far &= (grid < known[k] - reach) | (grid > known[k + 1] + reach)
    return far


def _landmarks(table: Table, sites: Table | None, report: Report) -> None:
    names = table.ids or [None] * len(table.lines)
    counts = Counter(name for name in names if name is not None)
    unnamed = sum(name is None for name in names)
    report.sightings = {name: counts[name] for name in sorted(counts)}
    if counts:
        numbers = sorted(counts.values())
        report.facts.append(
            f"{table.path.name}: {len(counts)} landmarks, seen {numbers[0]} to {numbers[-1]} times, "
            f"median {numbers[len(numbers) // 2]}"
        )
    if unnamed:
        report.findings.append(f"{table.path.name}: {unnamed} of {len(names)} detections have no id")
    once = sorted(name for name, count in counts.items() if count == 1)
    if once:
        report.findings.append(
            f"{table.path.name}: {len(once)} landmarks are seen only once, the first is {once[0]}"
        )
    if "t" in table.columns:
        pairs = Counter(zip(table.columns["t"].tolist(), names, strict=True))
        twice = [
            k
            for k, pair in enumerate(zip(table.columns["t"].tolist(), names, strict=True))
            if pair[1] is not None and pairs[pair] > 1
        ]
        if twice:
            report.findings.append(
                f"{table.where(twice[0])}: landmark {names[twice[0]]} stands more than once at one "
                "instant, in the first of "
                f"{len(twice)} such rows"
            )
    if sites is not None and sites.ids is not None:
        missing = sorted(set(counts) - set(sites.ids) - {None})
        if missing:
            report.findings.append(
                f"{sites.path.name}: has no landmark {missing[0]}, nor {len(missing) - 1} others that "
                "are seen"
            )


def _innovations(
    table: Table, truth: tuple[Path, FloatArray, FloatArray], sites: Table | None, report: Report
) -> None:
    """Errors of each component against true poses and landmarks, or against where they were seen."""
    if table.ids is None or "t" not in table.columns:
        return
    _, stamps, poses = truth
    spatial = np.tile(np.eye(4), (stamps.size, 1, 1))
    spatial[:, :2, :2] = se2(*poses.T)[:, :2, :2]
    spatial[:, :2, 3] = poses[:, :2]
    at = poses_at(table.columns["t"], stamps, spatial)
    if sites is None:
        place = seen_places(table, at)
        told = ", landmarks placed by their own sightings"
    elif sites.ids is not None and sites.has("x", "y"):
        places = np.stack([sites.columns["x"], sites.columns["y"]], axis=1)
        named = zip(sites.ids, places, strict=True)
        place, told = {name: xy for name, xy in named if name is not None}, ""
    else:
        return
    rows = np.array(
        [k for k, name in enumerate(table.ids) if name in place and np.isfinite(at[k]).all()], dtype=np.int64
    )
    if rows.size < 20:
        return
    away = np.stack([place[table.ids[k]] for k in rows.tolist()]) - at[rows, :2, 3]
    body = np.einsum("kji,kj->ki", at[rows, :2, :2], away)
    expected = {
        "range": np.hypot(*body.T),
        "bearing": np.arctan2(body[:, 1], body[:, 0]),
        "x": body[:, 0],
        "y": body[:, 1],
    }
    for name, unit in (("range", "m"), ("bearing", "rad"), ("x", "m"), ("y", "m")):
        if name not in table.columns:
            continue
        error = table.columns[name][rows] - expected[name]
        error = wrap(error) if name == "bearing" else error
        middle = float(np.median(error))
        sigma = 1.4826 * float(np.median(np.abs(error - middle)))
        report.errors[name] = ComponentErrors(unit, table.columns["t"][rows], error, middle, sigma)
        report.facts.append(
            f"{name}: error {middle:+.3g} {unit}, sigma {sigma:.3g} {unit} (robust), {rows.size} "
            f"detections{told}"
        )
        # Of the median of n normal errors the standard error is 1.25 sigma / sqrt(n).
        if abs(middle) > max(LARGE_BIAS, 5 * 1.25 / np.sqrt(rows.size)) * sigma > 0:
            report.findings.append(
                f"{name}: measured {middle:+.3g} {unit} off in the median, at a sigma of {sigma:.3g} {unit}"
            )
        outliers = np.flatnonzero(np.abs(error - middle) > OUTLIER_SIGMAS * sigma)
        if outliers.size > LARGE_SHARE * rows.size:
            worst = int(rows[outliers[np.argmax(np.abs(error - middle)[outliers])]])
            report.findings.append(
                f"{table.where(worst)}: {name} is the farthest of {outliers.size} outliers "
                f"({100 * outliers.size / rows.size:.1f} %) "
                f"beyond {OUTLIER_SIGMAS:g} sigma"
            )
