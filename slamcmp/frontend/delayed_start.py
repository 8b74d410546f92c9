"""The planar front end for sensors that do not place a landmark by one sighting: ranges, or bearings, alone.

Which landmark was detected the log's labels tell; where it is nobody knows before it was seen from several
places. So each landmark waits here, as several hypotheses (landmark_hypotheses.py), until one of them has
won and is narrow. At that frame it enters the stream, as an *entry*: range and bearing of the winner, with
their covariance. From the next frame on its sightings are measurements like any other.

This is decided once, here, and not by a back end: filters and smoothers get the same entry at the same
frame, and start from it. What was seen of a landmark before it entered is in its entry and nowhere else; a
smoother, which could go back to it, does not, or it would use it twice and know more than a filter.

The one approximation: an entry's covariance holds the odometry between its sightings, which the back ends
have too, and which landmarks that wait at the same time share. Taken for independent, their errors would seem
to average out. The odometry's share in a hypothesis is therefore stated as many times larger as there are
landmarks waiting (a bound: the covariance of m parts is at most m times that of the parts taken for
independent).
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Lt
from scipy.special import chdtri

from slamcmp.errors import UsageError
from slamcmp.frontend.landmark_hypotheses import Hypotheses, Measured, Winner
from slamcmp.models.sensors import BearingOnly, RangeOnly
from slamcmp.registry import front_ends
from slamcmp.types import BoolArray, Detections, FloatArray, Frame, FrontEndReport, Log, MeasurementStream

STAGES = ("not_finite", "unlabelled", "duplicate", "range", "mahalanobis", "undecided")
MOST_NAMED = 10
"""Landmarks that a warning names."""


@front_ends.register("delayed_start")
def delayed_start(
    log: Log,
    seed: int,  # noqa: ARG001
    *,
    hypotheses: Annotated[int, Ge(4)] = 36,
    win_probability: Annotated[float, Gt(0.5), Lt(1)] = 0.999,
    entry_spread: Annotated[float, Gt(0), Lt(1)] = 0.1,
    range_min_m: Annotated[float, Gt(0)] = 0.3,
    range_max_m: Annotated[float, Gt(0)] = float("inf"),
    gate_probability: Annotated[float, Gt(0), Lt(1)] = 0.9999,
    restart_after: Annotated[int, Ge(1)] = 5,
    forget_after: Annotated[int, Ge(1)] = 50,
) -> MeasurementStream:
    """Labelled ranges or bearings; a landmark enters once one of several hypotheses about it has won.

    Args:
        log: detections with ids, of the sensor ``range_only`` or ``bearing_only``.
        seed: not used; nothing here is random.
        hypotheses: Gaussians that a first sighting is spread over: round its ring, or along its ray.
        win_probability: share of the heaviest hypothesis with which it has won.
        entry_spread: largest standard deviation of its position, as a share of its distance, with which the
            winner enters.
        range_min_m: nearer ranges are dropped; of bearings, where the ray begins [m].
        range_max_m: farther ranges are dropped; of bearings, where the ray ends [m].
        gate_probability: share of right measurements that correct a hypothesis; one outside its gate leaves
            it as it is, and counts against it as if it were on the gate.
        restart_after: so many measurements in a row outside every hypothesis' gate mean that the first was
            wrong: the landmark starts again from the last of them.
        forget_after: a landmark that waits and was not seen for so many frames starts again when it is.

    Returns:
        The stream; its report counts what each stage removed, and says which landmarks never entered.

    Raises:
        UsageError: the log's sensor is another, or no range is between the smallest and the largest.
    """
    sensor = log.problem.sensor
    if not isinstance(sensor, RangeOnly | BearingOnly):
        raise UsageError(
            f"front end 'delayed_start': sensor {sensor.name!r} is neither range_only nor bearing_only; "
            "front end 'labelled' takes sensors that place a landmark by one measurement"
        )
    if range_min_m >= range_max_m:
        raise UsageError(
            f"range_min_m is {range_min_m:g} and range_max_m {range_max_m:g}: "
            "the largest range must be above the smallest"
        )
    waiting = _Waiting(
        "range" if isinstance(sensor, RangeOnly) else "bearing",
        hypotheses,
        win_probability,
        entry_spread,
        float(chdtri(1, 1.0 - gate_probability)),
        restart_after,
        forget_after,
        (range_min_m, range_max_m),
    )
    frames, kept, counts = [], [], []
    for k, detections in enumerate(log.detections):
        passed, removed = _usable(detections, sensor, range_min_m, range_max_m)
        waiting.move(log.T_prev_body[k], log.Q[k])
        entered: dict[int, Winner] = {}
        measured = passed.copy()
        outside = 0
        for row in np.flatnonzero(passed).tolist():
            landmark = int(detections.ids[row])
            if landmark in waiting.entered:
                continue
            measured[row] = False
            seen = waiting.see(landmark, float(detections.z[row, 0]), float(detections.R[row, 0, 0]))
            outside += not seen.inside
            if seen.winner is not None:
                entered[landmark] = seen.winner
            else:
                passed[row] = False
        undecided = detections.ids.size - sum(removed) - outside - int(passed.sum())
        counts.append([detections.ids.size, *removed, outside, undecided, int(passed.sum())])
        kept.append(passed)
        frames.append(
            Frame(
                k,
                float(log.t[k]),
                log.T_prev_body[k],
                log.Q[k],
                detections.ids[measured],
                detections.z[measured],
                detections.R[measured],
                _as_entries(entered),
                None if log.relative_poses is None else log.relative_poses[k],
            )
        )
    report = FrontEndReport(
        STAGES, np.array(counts, dtype=np.int64), tuple(kept), warnings=waiting.warnings(log.name)
    )
    return MeasurementStream(log.problem, tuple(frames), report)


def _usable(
    detections: Detections, sensor: RangeOnly | BearingOnly, range_min_m: float, range_max_m: float
) -> tuple[BoolArray, list[int]]:
    """Which detections can be used, (m,), and how many each of the first four stages removed."""
    ids = detections.ids
    first = np.zeros(ids.size, dtype=bool)
    first[np.unique(ids, return_index=True)[1]] = True
    checks = [
        np.isfinite(detections.z).all(axis=1) & np.isfinite(detections.R).all(axis=(1, 2)),
        ids >= 0,
        first | (ids < 0),
        np.ones(ids.size, dtype=bool),
    ]
    if isinstance(sensor, RangeOnly):
        with np.errstate(invalid="ignore"):
            checks[3] = (detections.z[:, 0] >= range_min_m) & (detections.z[:, 0] <= range_max_m)
    passed = np.ones(ids.size, dtype=bool)
    removed = []
    for check in checks:
        removed.append(int((passed & ~check).sum()))
        passed &= check
    return passed, removed


def _as_entries(entered: dict[int, Winner]) -> Detections | None:
    if not entered:
        return None
    winners = list(entered.values())
    return Detections(
        np.stack([each.z for each in winners]),
        np.stack([each.R for each in winners]),
        np.array(list(entered), dtype=np.int64),
    )


class _Seen(NamedTuple):
    """What came of a measurement of a landmark that waits."""

    inside: bool
    """Whether one of the hypotheses holds it in its gate."""
    winner: Winner | None


class _Waiting:
    """The landmarks that have been seen and have not entered."""

    def __init__(
        self,
        measured: Measured,
        count: int,
        win_probability: float,
        entry_spread: float,
        gate: float,
        restart_after: int,
        forget_after: int,
        ranges: tuple[float, float],
    ) -> None:
        self._measured: Measured = measured
        self._count, self._gate, self._ranges = count, gate, ranges
        self._win_probability, self._entry_spread = win_probability, entry_spread
        self._restart_after, self._forget_after = restart_after, forget_after
        self._hypotheses: dict[int, Hypotheses] = {}
        self._outside: dict[int, int] = {}
        self._unseen: dict[int, int] = {}
        self._sightings: Counter[int] = Counter()
        self.entered: set[int] = set()

    def move(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Carry all of them into the next body frame."""
        for landmark in [*self._unseen]:
            self._unseen[landmark] += 1
            if self._unseen[landmark] > self._forget_after:
                self._end(landmark)
        shared = Q * len(self._hypotheses)
        for each in self._hypotheses.values():
            each.move(T_prev_body, shared)

    def see(self, landmark: int, z: float, variance: float) -> _Seen:
        """Take in a measurement; a landmark that has a winner enters, and waits no more."""
        self._sightings[landmark] += 1
        self._unseen[landmark] = 0
        known = self._hypotheses.get(landmark)
        if known is None:
            self._start(landmark, z, variance)
            return _Seen(True, None)
        if not known.observe(z, variance):
            self._outside[landmark] += 1
            if self._outside[landmark] >= self._restart_after:
                self._start(landmark, z, variance)
            return _Seen(False, None)
        self._outside[landmark] = 0
        winner = known.winner()
        if winner.probability < self._win_probability or winner.spread > self._entry_spread:
            return _Seen(True, None)
        self._end(landmark)
        self.entered.add(landmark)
        return _Seen(True, winner)

    def warnings(self, log_name: str) -> tuple[str, ...]:
        """Which landmarks never entered."""
        never = sorted(set(self._sightings) - self.entered)
        if not never:
            return ()
        named = ", ".join(str(landmark) for landmark in never[:MOST_NAMED])
        more = f" and {len(never) - MOST_NAMED} more" if len(never) > MOST_NAMED else ""
        return (
            f"{log_name}: {len(never)} of {len(self._sightings)} landmarks never entered the map "
            f"({named}{more}): no place explains their {self._measured}s alone and well enough. A straight "
            "course cannot tell its two sides by ranges, and a short one no distance by bearings",
        )

    def _start(self, landmark: int, z: float, variance: float) -> None:
        nearest, farthest = self._ranges
        self._outside[landmark] = 0
        self._hypotheses[landmark] = Hypotheses.begin(
            self._measured,
            z,
            variance,
            count=self._count,
            gate=self._gate,
            nearest_m=nearest,
            farthest_m=farthest,
        )

    def _end(self, landmark: int) -> None:
        for of_each in (self._hypotheses, self._outside, self._unseen):
            of_each.pop(landmark)
