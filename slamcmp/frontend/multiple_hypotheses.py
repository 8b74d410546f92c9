"""The planar front end without labels that takes decisions back: several hypotheses, each with its own map.

After a long way without a sighting a detection may be of one landmark, of its neighbour or of neither, and
only what is seen next can tell. So each possibility goes on by itself (multiple hypothesis tracking, Reid
1979; for maps Cox and Leonard 1994): a map in the robot's frame (polar_map.py), the joint density of all
its innovations so far, and what it decided. That is joint compatibility over as many frames as it takes.
What becomes of a frame:

1. each hypothesis moves its map with the odometry;
2. it branches into the assignments of the frame's detections (association/assignments.py);
3. the likeliest are kept, of those that agree about what is on the map and what was decided last only one;
4. landmarks that were not confirmed in time are deleted, two that must be one are joined.

A landmark never seen is a priori as likely as in a Dirichlet process: α of n + α detections are of new
ones, spread evenly over what the sensor sees. That makes a second copy of an old landmark dear after an
hour and a first landmark cheap in the first second. What the likeliest hypothesis at the end has decided is
the stream, so all its decisions are made with hindsight: a robot would have them after a lag.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Lt

from slamcmp.association.assignments import Choice, assignments
from slamcmp.association.compatibility import NOBODY, gate
from slamcmp.errors import UsageError
from slamcmp.frontend.associated import Seen, decided_stream, usable
from slamcmp.frontend.polar_map import NEAREST_M, PolarMap
from slamcmp.registry import front_ends
from slamcmp.types import FloatArray, IntArray, Log, MeasurementStream
from slamcmp.types.association import NO_LANDMARK

STAGES = ("not_finite", "range", "unconfirmed")
JOINED = -1
"""In place of a frame: two landmarks were found to be one."""
RECENT = 8
"""Frames with detections in which two hypotheses have to agree to be one."""
NARROWEST = math.radians(5.0)
"""No sensor is taken to see less to each side, however few landmarks it found."""
LOG_ODDS_NEW = 2.0
"""A landmark never seen is weighed beside a known one that is likelier by less than this."""
LOG_ODDS_JOINED = 3.0
"""Two landmarks are joined where one at both places is likelier than two by this."""


@front_ends.register("multiple_hypotheses")
def multiple_hypotheses(
    log: Log,
    seed: int,  # noqa: ARG001
    *,
    hypotheses: Annotated[int, Ge(1)] = 60,
    kept_odds: Annotated[float, Gt(1)] = 1e6,
    gate_probability: Annotated[float, Gt(0), Lt(1)] = 0.9999,
    new_landmarks: Annotated[float, Gt(0)] = 2.0,
    confirm_sightings: Annotated[int, Ge(1)] = 2,
    confirm_frames: Annotated[int, Ge(1)] = 5,
    range_max_m: Annotated[float, Gt(0)] = float("inf"),
    odometry_scale_sigma: Annotated[float, Ge(0)] = 0.0,
) -> MeasurementStream:
    """Detections without labels in the plane, by the likeliest of several hypotheses at the end of the log.

    Args:
        log: detections; their ids are not looked at, other than to score.
        seed: not used; nothing here is random.
        hypotheses: so many are followed at most.
        kept_odds: one that is less likely than the likeliest by this factor is given up.
        gate_probability: share of right pairs that the gate holds.
        new_landmarks: α, how readily a detection is of a landmark never seen: in n detections about
            α log(1 + n / α) are.
        confirm_sightings: k, sightings that confirm a landmark; 1 believes every first one.
        confirm_frames: n, frames with detections within which it has to be confirmed, else it is deleted.
        range_max_m: farther detections are dropped [m].
        odometry_scale_sigma: of the shares by which odometry may be too long or turn too far, which are
            estimated by each hypothesis; 0 trusts it.

    Returns:
        The stream; its report counts what each stage removed and holds decisions and labels.

    Raises:
        UsageError: one detection of the log's sensor does not place a landmark in the plane, or k sightings
            do not fit into n frames.
    """
    sensor = log.problem.sensor
    if sensor.dim != sensor.space_dim or sensor.space_dim != 2:
        raise UsageError(
            f"front end 'multiple_hypotheses': one measurement of sensor {sensor.name!r} does not place a "
            "landmark in the plane; range_bearing or relative_position of a planar log is needed"
        )
    if confirm_frames < confirm_sightings:
        raise UsageError(
            f"confirm_frames is {confirm_frames} and confirm_sightings {confirm_sightings}: "
            "a landmark is seen at most once a frame"
        )
    seen, removed = zip(*(usable(sensor, each, range_max_m) for each in log.detections), strict=True)
    tree = _Tree(
        _Hypothesis(PolarMap(odometry_scale_sigma)),
        hypotheses,
        Choice(gate_probability, 0.0, math.log(kept_odds), LOG_ODDS_NEW),
        new_landmarks,
        _view(np.concatenate([each.x for each in seen])),
        (confirm_sightings, confirm_frames),
    )
    for k, each in enumerate(seen):
        tree.move(log.T_prev_body[k], log.Q[k])
        if each.rows.size:
            tree.branch(k, each)
    return decided_stream(log, STAGES, tree.decided(seen), removed, [each.all_points for each in seen])


def _view(points: FloatArray) -> float:
    """Area that the sensor sees (m²): the sector that holds nearly all that it detected."""
    if not len(points):
        return 1.0
    r = float(np.percentile(np.linalg.norm(points, axis=1), 99.0))
    half = float(np.percentile(np.abs(np.arctan2(points[:, 1], points[:, 0])), 99.0))
    return max(half, NARROWEST) * max(r, NEAREST_M) ** 2


class _Landmark(NamedTuple):
    name: int
    born: int
    """The number of frames with detections before it."""
    sightings: int = 1
    beside: frozenset[int] = frozenset()
    """Names of landmarks that were seen in one frame with it: none of them is the same."""


class _Step(NamedTuple):
    """What a hypothesis decided last, and before that."""

    before: _Step | None
    frame: int
    names: tuple[int, ...]
    """Of each usable detection; of JOINED the two landmarks, the first of which stays."""


class _Hypothesis(NamedTuple):
    own_map: PolarMap
    landmarks: tuple[_Landmark, ...] = ()
    """Row by row of the map."""
    log_weight: float = 0.0
    last: _Step | None = None
    recent: tuple[tuple[int, ...], ...] = ()


class _Tree:
    def __init__(
        self,
        root: _Hypothesis,
        most: int,
        choice: Choice,
        alpha: float,
        view_m2: float,
        confirmed: tuple[int, int],
    ) -> None:
        self.hypotheses = [root]
        self._most, self._choice = most, choice
        self._alpha, self._view = alpha, view_m2
        self._sightings, self._within = confirmed
        self._joined_gate = gate(2, choice.probability)
        self._frames = self._detections = self._names = 0

    def move(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Move every map with the odometry."""
        for each in self.hypotheses:
            each.own_map.predict(T_prev_body, Q)

    def branch(self, k: int, seen: Seen) -> None:
        """Take in the detections of frame k."""
        count = seen.rows.size
        self._detections += count
        log_new = math.log(self._alpha / (self._detections + self._alpha) / self._view)
        choice = replace(self._choice, log_new=log_new)
        new = tuple(range(self._names, self._names + count))
        self._names += count
        leaves = [
            (parent.log_weight + weight, parent, given)
            for parent in self.hypotheses
            for weight, given in self._assignments(parent, seen, choice)
        ]
        leaves.sort(key=lambda leaf: -leaf[0])
        top = leaves[0][0]
        kept: dict[object, _Hypothesis] = {}
        for weight, parent, given in leaves:
            if top - weight > choice.log_odds or len(kept) >= self._most:
                break
            names = tuple(
                new[i] if row == NOBODY else parent.landmarks[row].name for i, row in enumerate(given)
            )
            recent = (*parent.recent, names)[-RECENT:]
            on_map = frozenset(each.name for each in parent.landmarks) | frozenset(names)
            if (on_map, recent) not in kept:
                grown = parent._replace(
                    log_weight=weight - top, last=_Step(parent.last, k, names), recent=recent
                )
                kept[on_map, recent] = self._joined(self._corrected(grown, given, names, seen), log_new)
        self.hypotheses = list(kept.values())
        self._frames += 1

    def _assignments(
        self, parent: _Hypothesis, seen: Seen, choice: Choice
    ) -> list[tuple[float, tuple[int, ...]]]:
        if not parent.landmarks:
            return [(seen.rows.size * choice.log_new, (NOBODY,) * seen.rows.size)]
        rows = np.arange(len(parent.landmarks))
        return assignments(parent.own_map.innovations(seen.x, seen.N, rows), choice)

    def _corrected(
        self, hypothesis: _Hypothesis, given: tuple[int, ...], names: tuple[int, ...], seen: Seen
    ) -> _Hypothesis:
        """With the detections in its map, and without the landmarks that were not confirmed in time."""
        own_map, landmarks = hypothesis.own_map.copy(), list(hypothesis.landmarks)
        rows = np.array(given, dtype=np.int64)
        paired = np.flatnonzero(rows != NOBODY)
        own_map.correct(rows[paired], seen.x[paired], seen.N[paired])
        for i, row in enumerate(given):
            beside = frozenset(names) - {names[i]}
            if row == NOBODY:
                own_map.add(seen.x[i], seen.N[i])
                landmarks.append(_Landmark(names[i], self._frames, 1, beside))
            else:
                known = landmarks[row]
                landmarks[row] = known._replace(
                    sightings=known.sightings + 1, beside=known.beside | beside if beside else known.beside
                )
        for row in range(len(landmarks) - 1, -1, -1):
            late = self._frames - landmarks[row].born + 1 >= self._within
            if late and landmarks[row].sightings < self._sightings:
                own_map.drop(row)
                del landmarks[row]
        return hypothesis._replace(own_map=own_map, landmarks=tuple(landmarks))

    def _joined(self, hypothesis: _Hypothesis, log_new: float) -> _Hypothesis:
        """With the two landmarks joined that are likeliest one, where any are.

        That one landmark is where both are has the density of their difference at zero, against that of a
        further landmark. The weight stays: a hypothesis does not gain by having started a landmark twice.
        """
        known = hypothesis.landmarks
        if len(known) < 2:
            return hypothesis
        y, S = hypothesis.own_map.separations()
        a, b = np.triu_indices(len(known), 1)
        det = np.linalg.det(S[a, b])
        distance = np.einsum("mi,mij,mj->m", y[a, b], np.linalg.inv(S[a, b]), y[a, b])
        gain = -0.5 * (distance + np.log(det)) - math.log(2.0 * math.pi) - log_new
        for i in np.argsort(-gain):
            if gain[i] <= LOG_ODDS_JOINED:
                break
            one, other = known[int(a[i])], known[int(b[i])]
            if (
                distance[i] > self._joined_gate
                or min(one.sightings, other.sightings) < self._sightings
                or other.name in one.beside
            ):
                continue
            own_map = hypothesis.own_map.copy()
            own_map.join(int(a[i]), int(b[i]))
            left = [_renamed(each, other.name, one.name) for each in known if each is not other]
            left[int(a[i])] = one._replace(
                sightings=one.sightings + other.sightings, beside=one.beside | other.beside
            )
            return hypothesis._replace(
                own_map=own_map,
                landmarks=tuple(left),
                last=_Step(hypothesis.last, JOINED, (one.name, other.name)),
            )
        return hypothesis

    def decided(self, seen: tuple[Seen, ...]) -> list[IntArray]:
        """Of each frame's detections the ids by the likeliest hypothesis, in order of appearance."""
        best = max(self.hypotheses, key=lambda each: each.log_weight)
        confirmed = {each.name for each in best.landmarks if each.sightings >= self._sightings}
        now: dict[int, int] = {}
        ids = [np.full(len(each.all_points), NO_LANDMARK, dtype=np.int64) for each in seen]
        step = best.last
        while step is not None:
            if step.frame == JOINED:
                stays, goes = step.names
                now[goes] = now.get(stays, stays)
            else:
                ids[step.frame][seen[step.frame].rows] = [now.get(name, name) for name in step.names]
            step = step.before
        order: dict[int, int] = {}
        for frame in ids:
            for i, name in enumerate(frame.tolist()):
                frame[i] = order.setdefault(name, len(order)) if name in confirmed else NO_LANDMARK
        return ids


def _renamed(landmark: _Landmark, old: int, new: int) -> _Landmark:
    if old not in landmark.beside:
        return landmark
    return landmark._replace(beside=landmark.beside - {old} | {new})
