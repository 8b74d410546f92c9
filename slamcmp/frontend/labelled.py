"""The planar front end: labelled detections, checked one by one, frozen into a stream.

The Mahalanobis test (the course's third step) needs a prediction of where a landmark should appear. It must
not be a back end's, or the back ends would not share one stream: the front end keeps its own, one small
robot-centred filter a landmark (:class:`LandmarkTracks`).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from scipy.special import chdtri

from slamcmp.errors import UsageError
from slamcmp.frontend.landmark_tracks import LandmarkTracks
from slamcmp.registry import front_ends
from slamcmp.types import BoolArray, Detections, FloatArray, FrontEndReport, IntArray, Log, MeasurementStream
from slamcmp.types.columns import Columns, own_parts
from slamcmp.types.stream import frames_of

STAGES = ("not_finite", "unlabelled", "duplicate", "range", "field_of_view", "mahalanobis", "unconfirmed")


@front_ends.register("labelled")
def labelled(
    log: Log,
    seed: int,  # noqa: ARG001
    *,
    range_min_m: Annotated[float, Ge(0)] = 0.0,
    range_max_m: Annotated[float, Gt(0)] = float("inf"),
    field_of_view_deg: Annotated[float, Gt(0), Le(360)] = 360.0,
    gate_probability: Annotated[float, Gt(0), Lt(1)] | None = 0.9999,
    restart_after: Annotated[int, Ge(1)] = 5,
    min_sightings: Annotated[int, Ge(1), Le(2)] = 1,
) -> MeasurementStream:
    """Labelled detections that pass the range, field-of-view and Mahalanobis tests.

    Args:
        log: detections with ids (planar or spatial).
        seed: not used; nothing here is random.
        range_min_m: closer detections are dropped [m].
        range_max_m: farther detections are dropped [m].
        field_of_view_deg: full opening angle about the body's x axis [deg].
        gate_probability: share of correct detections that the Mahalanobis test lets through; None: no test.
        restart_after: so many rejections of one landmark in a row mean that the front end's own prediction
            is what is wrong; it starts again from the next detection.
        min_sightings: 2 holds a landmark back until a second detection agrees with the first; use it where
            detections may be outliers, since nothing else can test a first sighting.

    Returns:
        The stream; its report counts what each stage removed in each frame.

    Raises:
        UsageError: no range is between the smallest and the largest.
    """
    if range_min_m >= range_max_m:
        raise UsageError(
            f"range_min_m is {range_min_m:g} and range_max_m {range_max_m:g}: "
            "the largest range must be above the smallest"
        )
    sensor = log.problem.sensor
    threshold = np.inf if gate_probability is None else float(chdtri(sensor.dim, 1.0 - gate_probability))
    uses_tracks = gate_probability is not None or min_sightings > 1
    tracks = LandmarkTracks(sensor, threshold, restart_after, min_sightings) if uses_tracks else None
    sizes = np.array([each.ids.size for each in log.detections], dtype=np.int64)
    every = Detections(
        np.concatenate([each.z for each in log.detections]),
        np.concatenate([each.R for each in log.detections]),
        np.concatenate([each.ids for each in log.detections]),
    )
    frame_of = np.repeat(np.arange(sizes.size), sizes)
    passed, removed = _static_checks(
        every, frame_of, _body_points(log, every), range_min_m, range_max_m, field_of_view_deg
    )
    tracked = np.zeros((sizes.size, 2), dtype=np.int64)
    if tracks is not None:
        ends = np.cumsum(sizes)
        for k, (start, end) in enumerate(zip(ends - sizes, ends, strict=True)):
            tracks.predict(log.T_prev_body[k], log.Q[k])
            rows = start + np.flatnonzero(passed[start:end])
            verdict = tracks.test(every.ids[rows], every.z[rows], every.R[rows])
            tracked[k] = verdict.rejected.sum(), verdict.unconfirmed.sum()
            passed[rows[verdict.rejected | verdict.unconfirmed]] = False
    of_frames = [np.bincount(frame_of[each], minlength=sizes.size) for each in (*removed, passed)]
    counts = np.stack([sizes, *of_frames[:-1], *tracked.T, of_frames[-1]], axis=1)
    columns = Columns(
        np.arange(sizes.size),
        log.t,
        log.T_prev_body,
        log.Q,
        of_frames[-1],
        every.ids[passed],
        every.z[passed],
        every.R[passed],
    )
    related = {} if log.relative_poses is None else dict(enumerate(log.relative_poses))
    frames = frames_of(columns, relative_poses={k: each for k, each in related.items() if each is not None})
    report = FrontEndReport(STAGES, counts.astype(np.int64), tuple(own_parts(passed, sizes)))
    return MeasurementStream(log.problem, frames, report)


def _body_points(log: Log, detections: Detections) -> FloatArray:
    """Where each detection lies in the body frame, (m, n) [m]."""
    return log.problem.sensor.invert(np.eye(log.problem.sensor.space_dim + 1), detections.z)


def _static_checks(
    detections: Detections,
    frame_of: IntArray,
    body_points: FloatArray,
    range_min_m: float,
    range_max_m: float,
    field_of_view_deg: float,
) -> tuple[BoolArray, list[BoolArray]]:
    """The checks that need no memory, (M,) each; a detection is counted at the first one it fails."""
    ids = detections.ids
    finite = np.isfinite(detections.z).all(axis=1) & np.isfinite(detections.R).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        distance = np.linalg.norm(body_points, axis=1)
        off_axis = np.arctan2(np.linalg.norm(body_points[:, 1:], axis=1), body_points[:, 0])
        checks = (
            finite,
            ids >= 0,
            _first_of_frame(ids, frame_of) | (ids < 0),
            (distance >= range_min_m) & (distance <= range_max_m),
            off_axis <= np.radians(field_of_view_deg / 2.0),
        )
    passed = np.ones(ids.size, dtype=bool)
    removed = []
    for check in checks:
        removed.append(passed & ~check)
        passed &= check
    return passed, removed


def _first_of_frame(ids: IntArray, frame_of: IntArray) -> BoolArray:
    """Whether no earlier detection of the same frame bears that id, (M,)."""
    # Stable: of equal ones the first stands first.
    order = np.lexsort((ids, frame_of))
    first = np.ones(ids.size, dtype=bool)
    first[order[1:]] = (np.diff(frame_of[order]) != 0) | (np.diff(ids[order]) != 0)
    return first
