"""The planar front end for detections without labels: it decides itself whose each one is.

It keeps a small map of its own (own_map.py), so every back end gets one stream with one digest, and a
difference between back ends is theirs. Labels that a log has are not looked at; they score the decisions
(metrics/association.py). What becomes of a frame:

1. the map moves with the odometry;
2. detections are paired with landmarks that their gate holds: the nearest, the likeliest, or as many as
   are compatible together;
3. pairs that are not clearly of one landmark are left out;
4. paired detections correct the map; those far from every landmark start a new one, a ghost until it is
   confirmed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Lt

from slamcmp.association.compatibility import NOBODY, Innovations, gate
from slamcmp.association.hypotheses import marginals
from slamcmp.association.jcbb import joint_compatibility
from slamcmp.association.single import maximum_likelihood, nearest_neighbour
from slamcmp.errors import UsageError
from slamcmp.frontend.candidates import Candidates
from slamcmp.frontend.own_map import OwnMap
from slamcmp.registry import front_ends
from slamcmp.types import (
    Association,
    BoolArray,
    Detections,
    FloatArray,
    Frame,
    FrontEndReport,
    IntArray,
    Log,
    MeasurementStream,
    SensorModel,
)
from slamcmp.types.association import NO_LANDMARK, NOT_KNOWN

STAGES = ("not_finite", "range", "not_clear", "unconfirmed")
UNKNOWN_PER_M2 = 1e-4
"""Density of what is not on the map, where pairs are weighed: low, for a gate has judged them before."""

Method = Literal["nearest_neighbour", "maximum_likelihood", "joint_compatibility"]
METHODS: dict[Method, Callable[[Innovations, float], IntArray]] = {
    "nearest_neighbour": nearest_neighbour,
    "maximum_likelihood": maximum_likelihood,
    "joint_compatibility": joint_compatibility,
}


@front_ends.register("associated")
def associated(
    log: Log,
    seed: int,  # noqa: ARG001
    *,
    method: Method = "joint_compatibility",
    gate_probability: Annotated[float, Gt(0), Lt(1)] = 0.99,
    new_probability: Annotated[float, Gt(0), Lt(1)] = 0.9999,
    least_probability: Annotated[float, Gt(0), Lt(1)] | None = 0.9,
    confirm_sightings: Annotated[int, Ge(1)] = 2,
    confirm_frames: Annotated[int, Ge(1)] = 5,
    held_back: Literal["dropped", "inserted"] = "dropped",
    range_max_m: Annotated[float, Gt(0)] = float("inf"),
    odometry_scale_sigma: Annotated[float, Ge(0)] = 0.0,
    sightings_as_one: Annotated[float, Ge(1)] = 1.0,
) -> MeasurementStream:
    """Detections without labels, each given to a landmark of the front end's own map.

    Args:
        log: detections; their ids are not looked at, other than to score.
        seed: not used; nothing here is random.
        method: how detections are paired with landmarks.
        gate_probability: share of right pairs that the gate holds.
        new_probability: a detection outside the gate of this share of every landmark starts a new one; one
            between the two gates is left out.
        least_probability: pairs less probable than this, against the other landmarks, are left out; None
            keeps every pair.
        confirm_sightings: k, sightings that confirm a landmark; 1 believes every first one.
        confirm_frames: n, frames with detections within which it has to be confirmed.
        held_back: whether sightings before the confirmation are missing in the stream, as they are on a
            robot, or inserted where they were made, as after a lag.
        range_max_m: farther detections are dropped [m].
        odometry_scale_sigma: of the shares by which odometry may be too long or turn too far, which are
            estimated; 0 trusts it.
        sightings_as_one: so many sightings of a landmark are worth one where a sensor's error is the same
            from one to the next; 1 for errors that are independent.

    Returns:
        The stream; its report counts what each stage removed and holds decisions and labels.

    Raises:
        UsageError: one detection of the log's sensor does not place a landmark, or k sightings do not fit
            into n frames.
    """
    sensor = log.problem.sensor
    if sensor.dim != sensor.space_dim:
        raise UsageError(
            f"front end 'associated': one measurement of sensor {sensor.name!r} does not place a landmark; "
            "range_bearing or relative_position is needed"
        )
    if confirm_frames < confirm_sightings:
        raise UsageError(
            f"confirm_frames is {confirm_frames} and confirm_sightings {confirm_sightings}: "
            "a landmark is seen at most once a frame"
        )
    associator = _Associator(
        OwnMap(sensor.space_dim, odometry_scale_sigma),
        Candidates(confirm_sightings, confirm_frames),
        METHODS[method],
        gate_probability,
        gate(sensor.space_dim, new_probability),
        least_probability,
        sightings_as_one,
    )
    ids, unusable, clear, points = [], [], [], []
    for k, detections in enumerate(log.detections):
        seen, removed = usable(sensor, detections, range_max_m)
        associator.move(log.T_prev_body[k], log.Q[k])
        decided = associator.decide(k, seen)
        ids.append(decided.ids)
        unusable.append(removed)
        clear.append(decided.clear)
        points.append(seen.all_points)
    if held_back == "inserted":
        for candidate in associator.candidates.rows:
            for frame, row in candidate.sightings:
                ids[frame][row] = NO_LANDMARK if candidate.name is None else candidate.name
    left_out = [[*each, int((~sure).sum())] for each, sure in zip(unusable, clear, strict=True)]
    return decided_stream(log, STAGES, ids, left_out, points)


def decided_stream(
    log: Log,
    stages: tuple[str, ...],
    ids: Sequence[IntArray],
    left_out: Sequence[Sequence[int]],
    points: Sequence[FloatArray],
) -> MeasurementStream:
    """The stream of a front end that decided by itself whose each detection is, with its report.

    Args:
        log: what was detected.
        stages: names of the report's stages; the last counts what is without a landmark in the end.
        ids: (m,) of each frame's detections, ``NO_LANDMARK`` where one is not used.
        left_out: of each frame, how many each stage before the last removed.
        points: (m, n) of each frame, where its detections are in the body frame [m].
    """
    frames, kept, counts = [], [], []
    for k, detections in enumerate(log.detections):
        passed = ids[k] != NO_LANDMARK
        without = detections.ids.size - sum(left_out[k]) - int(passed.sum())
        counts.append([detections.ids.size, *left_out[k], without, int(passed.sum())])
        kept.append(passed)
        frames.append(
            Frame(
                k,
                float(log.t[k]),
                log.T_prev_body[k],
                log.Q[k],
                ids[k][passed],
                detections.z[passed],
                detections.R[passed],
                relative_poses=None if log.relative_poses is None else log.relative_poses[k],
            )
        )
    report = FrontEndReport(
        stages,
        np.array(counts, dtype=np.int64),
        tuple(kept),
        association=Association(tuple(ids), true_labels(log), tuple(points)),
    )
    return MeasurementStream(log.problem, tuple(frames), report)


def true_labels(log: Log) -> tuple[IntArray, ...]:
    """Whose each detection of the log is, as far as the log knows."""
    spoilt = None if log.truth is None else log.truth.outliers
    labels = []
    for k, detections in enumerate(log.detections):
        of_frame = np.where(detections.ids >= 0, detections.ids, NOT_KNOWN)
        labels.append(of_frame if spoilt is None else np.where(spoilt[k], NO_LANDMARK, of_frame))
    return tuple(labels)


class Seen(NamedTuple):
    """The usable detections of a frame, as points in the body frame."""

    rows: IntArray
    """(u,): which of the frame's m detections they are."""
    x: FloatArray
    """(u, n) [m]."""
    N: FloatArray
    """Their covariances, (u, n, n)."""
    all_points: FloatArray
    """Of every detection of the frame, (m, n); NaN where it is not finite."""


def usable(sensor: SensorModel, detections: Detections, range_max_m: float) -> tuple[Seen, list[int]]:
    """The detections that can be used, and how many were removed as not finite and as too far."""
    origin = np.eye(sensor.space_dim + 1)
    finite = np.isfinite(detections.z).all(axis=1) & np.isfinite(detections.R).all(axis=(1, 2))
    points = np.full((detections.ids.size, sensor.space_dim), np.nan)
    points[finite] = sensor.invert(origin, detections.z[finite])
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(points, axis=1) <= range_max_m
    rows = np.flatnonzero(finite & near)
    x = points[rows]
    _, H = sensor.jacobians(origin, x)
    J = np.linalg.inv(H)
    N = J @ detections.R[rows] @ np.swapaxes(J, 1, 2)
    return Seen(rows, x, N, points), [int((~finite).sum()), int((finite & ~near).sum())]


class _Decided(NamedTuple):
    ids: IntArray
    """Of each of the frame's detections, (m,)."""
    clear: BoolArray
    """(m,): False where a detection is near a landmark, but not clearly of one."""


class _Associator:
    def __init__(
        self,
        own_map: OwnMap,
        candidates: Candidates,
        pair: Callable[[Innovations, float], IntArray],
        gate_probability: float,
        new_gate: float,
        least_probability: float | None,
        sightings_as_one: float,
    ) -> None:
        self.candidates = candidates
        self._map = own_map
        self._pair = pair
        self._gate_probability, self._new_gate = gate_probability, new_gate
        self._least_probability = least_probability
        self._sightings_as_one = sightings_as_one
        self._frames = 0

    def move(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        self._map.predict(T_prev_body, Q)

    def decide(self, k: int, seen: Seen) -> _Decided:
        ids = np.full(len(seen.all_points), NO_LANDMARK, dtype=np.int64)
        clear = np.ones(ids.size, dtype=bool)
        if not seen.rows.size:
            return _Decided(ids, clear)
        given, new = self._pairs(seen)
        paired = np.flatnonzero(given != NOBODY)
        clear[seen.rows[(given == NOBODY) & ~new]] = False
        self._map.correct(given[paired], seen.x[paired], seen.N[paired] * self._sightings_as_one)
        for i in paired.tolist():
            candidate = self.candidates.rows[given[i]]
            self.candidates.see(candidate, (k, int(seen.rows[i])))
            if candidate.name is not None:
                ids[seen.rows[i]] = candidate.name
        for i in np.flatnonzero(new).tolist():
            self._map.add(seen.x[i], seen.N[i])
            candidate = self.candidates.add(self._frames, (k, int(seen.rows[i])))
            if candidate.name is not None:
                ids[seen.rows[i]] = candidate.name
        for row in self.candidates.ghosts(self._frames):
            self._map.drop(row)
        self._frames += 1
        return _Decided(ids, clear)

    def _pairs(self, seen: Seen) -> tuple[IntArray, BoolArray]:
        """The map's row of each detection or NOBODY, (u,), and which of those are of something new, (u,)."""
        count = len(self.candidates.rows)
        if not count:
            return np.full(seen.rows.size, NOBODY, dtype=np.int64), np.ones(seen.rows.size, dtype=bool)
        innovations = self._map.innovations(seen.x, seen.N, np.arange(count))
        given = self._pair(innovations, self._gate_probability)
        far = np.asarray((innovations.squared_distances > self._new_gate).all(axis=1))
        paired = np.flatnonzero(given != NOBODY)
        if self._least_probability is not None and paired.size:
            each = marginals(innovations, self._gate_probability, UNKNOWN_PER_M2)
            doubtful = paired[each[paired, given[paired]] < self._least_probability]
            given[doubtful] = NOBODY
        return given, far & (given == NOBODY)
