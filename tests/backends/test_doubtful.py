"""A landmark that begins with a ghost starts anew, in all robust back ends at the same frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.doubtful import DoubtfulLandmarks
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.filters.variants import FirstEstimatesEkf, ObservabilityConstrainedEkf
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.gtsam_smoothers.isam2 import Isam2
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.types import MeasurementStream
from tests.backends.spoilt import spoilt, without
from tests.toy_stream import toy_stream

EXACT: list[tuple[Any, dict[str, Any], float]] = [
    (EkfSlam, {}, 1e-11),
    (FirstEstimatesEkf, {}, 1e-11),
    (ObservabilityConstrainedEkf, {}, 1e-11),
    (UkfSlam, {}, 1e-9),
    (RobocentricEkf, {}, 1e-11),
    (SlidingWindow, {"window": 4}, 1e-6),
    (SlidingWindow, {"window": 4, "linearisation": "fej"}, 1e-6),
    (SlidingWindow, {"window": None}, 1e-6),
    (Batch, {}, 1e-6),
    (FixedLag, {"lag_frames": 5, "mode": "batch"}, 1e-4),
    (Isam2, {"relinearize_skip": 1, "relinearize_threshold": 0.0, "extra_updates": 3}, 1e-6),
]


def first_sight(stream: MeasurementStream, k: int) -> int:
    """Row of frame k's first measurement of a landmark that no frame before has seen."""
    before = {int(i) for frame in stream.frames[:k] for i in frame.ids}
    return next(row for row, i in enumerate(stream.frames[k].ids.tolist()) if i not in before)


def stream_with_ghost() -> tuple[MeasurementStream, MeasurementStream, int]:
    """A landmark's first sighting is 3 m off; the same without that sighting; and who it is."""
    clean, _, _ = toy_stream(frames=20, landmarks=14, seed=4)
    k, row = 1, first_sight(clean, 1)
    stream = spoilt(clean, {(k, row): clean.frames[k].z[row] + [3.0, 0.5]})
    return stream, without(clean, [(k, row)]), int(clean.frames[k].ids[row])


@pytest.mark.parametrize(("kind", "parameters", "tolerance"), EXACT)
def test_after_the_second_sighting_the_ghost_never_was(
    kind: Any, parameters: dict[str, Any], tolerance: float
) -> None:
    """Pose and map as of a run that did not get it: the old landmark goes by exact marginalisation."""
    stream, never, landmark = stream_with_ghost()
    ours, theirs = (kind(each.problem, robust="huber", **parameters) for each in (stream, never))
    for ours_frame, theirs_frame in zip(stream.frames, never.frames, strict=True):
        ours.update(ours_frame)
        theirs.update(theirs_frame)
    if kind is Batch:
        ours.trajectory(), theirs.trajectory()
    np.testing.assert_allclose(ours.estimate().T_world_body, theirs.estimate().T_world_body, atol=tolerance)
    np.testing.assert_allclose(ours.estimate().P, theirs.estimate().P, atol=tolerance)
    map_ours, map_theirs = ours.landmarks(), theirs.landmarks()
    assert sorted(map_ours.ids.tolist()) == sorted(map_theirs.ids.tolist())
    places = dict(zip(map_theirs.ids.tolist(), map_theirs.positions, strict=True))
    for i, place in zip(map_ours.ids.tolist(), map_ours.positions, strict=True):
        np.testing.assert_allclose(place, places[i], atol=10 * tolerance)
    assert landmark in places
    if hasattr(ours, "joint_covariance") and not isinstance(ours, ErrorStateEkf | EkfSlam):
        assert ours.joint_covariance().shape == theirs.joint_covariance().shape


@pytest.mark.parametrize("kind", [Isam2, Batch])
def test_a_ghost_has_no_part_in_the_degrees_of_freedom(kind: Any) -> None:
    stream, never, _ = stream_with_ghost()
    told = []
    for each in (stream, never):
        back_end = kind(each.problem, robust="huber")
        for frame in each.frames:
            back_end.update(frame)
        back_end.trajectory()
        told.append(back_end.diagnostics())
    assert told[0]["dof"] == told[1]["dof"]
    assert told[0]["chi2"] == pytest.approx(told[1]["chi2"], rel=0.02)


def test_only_a_first_sighting_is_doubted() -> None:
    """An outlier of a landmark that two sightings agree on restarts nothing, nor does a right one."""
    clean, _, _ = toy_stream(frames=60, landmarks=14, seed=4)
    doubtful, known = DoubtfulLandmarks(clean.problem.sensor), set()
    for frame in clean.frames:
        assert doubtful.contradicted(frame, known) == []
        known.update(frame.ids.tolist())
    wrong = spoilt(clean, {(50, 0): clean.frames[50].z[0] + [5.0, 0.5]})
    doubtful, known = DoubtfulLandmarks(clean.problem.sensor), set()
    for frame in wrong.frames:
        assert doubtful.contradicted(frame, known) == []
        known.update(frame.ids.tolist())


def test_right_second_sightings_are_seldom_taken_for_wrong() -> None:
    """1 in 10 000 by the threshold; here none of 1400, over seeds that the test did not choose by outcome."""
    second = restarts = 0
    for seed in range(100):
        stream, _, _ = toy_stream(frames=12, landmarks=14, seed=seed)
        doubtful, known = DoubtfulLandmarks(stream.problem.sensor), set()
        times: dict[int, int] = {}
        for frame in stream.frames:
            restarts += len(doubtful.contradicted(frame, known))
            for i in frame.ids.tolist():
                times[i] = times.get(i, 0) + 1
                second += times[i] == 2
            known.update(frame.ids.tolist())
    assert second > 1000
    assert restarts <= 1
