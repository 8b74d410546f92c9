"""Landmarks that enter once a hypothesis has won: rightly, honestly, once, and never by guessing."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.errors import UsageError
from slamcmp.frontend.delayed_start import STAGES, delayed_start
from slamcmp.frontend.labelled import labelled
from slamcmp.models.sensors import RangeBearing, make_sensor
from slamcmp.types import Detections, Log, MeasurementStream, Problem
from slamcmp.worlds.planar import circle
from slamcmp.worlds.planar import random as walk

SENSORS = ("range_only", "bearing_only")
ODOMETRY = np.diag([0.03, 0.01, 0.01]) ** 2


@functools.cache
def worlds(sensor: str) -> list[tuple[Log, MeasurementStream]]:
    made = []
    for seed in range(8):
        log = walk(seed, sensor=sensor, steps=120, landmarks=15, half_size_m=12.0, range_max_m=12.0)
        made.append((log, delayed_start(log, seed)))
    return made


def entry_errors(log: Log, stream: MeasurementStream) -> list[float]:
    """Squared Mahalanobis distance of each entry from what the true pose would measure, 2 on average."""
    assert log.truth is not None
    found = []
    for frame in stream.frames:
        if frame.entries is None:
            continue
        T, sensor = log.truth.T_world_body[frame.k], RangeBearing()
        error = sensor.residual(frame.entries.z, sensor.predict(T, log.truth.positions[frame.entries.ids]))
        found += [float(e @ np.linalg.solve(R, e)) for e, R in zip(error, frame.entries.R, strict=True)]
    return found


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_winner_is_right_and_its_covariance_honest(sensor: str) -> None:
    distances = np.array([each for log, stream in worlds(sensor) for each in entry_errors(log, stream)])
    seen = sum(np.unique(np.concatenate([d.ids for d in log.detections])).size for log, _ in worlds(sensor))
    assert distances.size > 0.9 * seen, "nearly every landmark that was seen enters"
    # Five sigmas: a mirror image, or the wrong end of a ray, is many more.
    assert (distances < 25.0).mean() >= 0.95
    # The odometry's share is stated larger than it is (a bound), so the mean may be below 2, and not far.
    assert 0.8 < distances.mean() < 2.4
    assert (distances < 5.99).mean() > 0.8


@pytest.mark.parametrize("sensor", SENSORS)
def test_each_sighting_is_used_once_and_a_landmark_enters_before_it_is_measured(sensor: str) -> None:
    for log, stream in worlds(sensor):
        report = stream.report
        assert report is not None
        assert report.columns == ("raw", *STAGES, "kept")
        np.testing.assert_array_equal(report.counts[:, 0], report.counts[:, 1:].sum(axis=1))
        entered: dict[int, int] = {}
        for frame, detections in zip(stream.frames, log.detections, strict=True):
            new = [] if frame.entries is None else frame.entries.ids.tolist()
            assert not set(new) & set(frame.ids.tolist()), "what made it enter is not measured again"
            assert set(frame.ids.tolist()) <= set(entered)
            assert not set(new) & set(entered)
            entered.update(dict.fromkeys(new, frame.k))
            for landmark, z in zip(frame.ids.tolist(), frame.z, strict=True):
                np.testing.assert_array_equal(detections.z[detections.ids == landmark][0], z)
            # All that was detected of a landmark after it entered is there.
            later = [i for i in detections.ids.tolist() if entered.get(i, frame.k) < frame.k]
            assert sorted(later) == sorted(frame.ids.tolist())


def straight(sensor: str, seed: int, steps: int = 60, turn: float = 0.0) -> Log:
    """Straight on, past five landmarks; with ``turn`` [rad a step] round a bend in the second half."""
    generator = np.random.default_rng([seed, 77])
    model = make_sensor(sensor, {})
    places = np.array([[8.0, 6.0], [20.0, -4.0], [25.0, 9.0], [12.0, -7.0], [30.0, 3.0]])
    T, frames, increments = np.eye(3), [], [np.eye(3)]
    poses = [T]
    sigma = 0.1
    for k in range(1, steps):
        step = g.exp(np.array([0.5, 0.0, turn if k > steps // 2 else 0.0]))
        increments.append(step @ g.exp(np.sqrt(np.diag(ODOMETRY)) * generator.normal(size=3)))
        T = T @ step
        poses.append(T)
    for T in poses:
        z = model.predict(T, places) + sigma * generator.normal(size=(5, 1))
        frames.append(Detections(z, np.tile([[sigma**2]], (5, 1, 1)), np.arange(5)))
    Q = np.tile(ODOMETRY, (steps, 1, 1))
    Q[0] = 0.0
    return Log("straight", Problem(np.eye(3), 1e-6 * np.eye(3), model), np.arange(steps, dtype=float),
               np.array(increments), Q, tuple(frames))  # fmt: skip


def test_on_a_straight_course_ranges_never_choose_a_side() -> None:
    """Whatever the noise of the wheels says: what it says is as likely under both images."""
    entered = 0
    for seed in range(20):
        stream = delayed_start(straight("range_only", seed), seed)
        entered += sum(0 if frame.entries is None else frame.entries.ids.size for frame in stream.frames)
        assert stream.report is not None
        (warning,) = stream.report.warnings
        assert "5 of 5 landmarks never entered the map (0, 1, 2, 3, 4)" in warning
        assert "A straight course cannot tell its two sides" in warning
    assert entered == 0


def test_a_bend_tells_the_side_and_the_right_one() -> None:
    places = np.array([[8.0, 6.0], [20.0, -4.0], [25.0, 9.0], [12.0, -7.0], [30.0, 3.0]])
    right = wrong = 0
    for seed in range(10):
        log = straight("range_only", seed, turn=0.1)
        T = np.eye(3)
        for frame in delayed_start(log, seed).frames:
            T = T @ frame.T_prev_body
            if frame.entries is not None:
                found = RangeBearing().invert(T, frame.entries.z)
                apart = np.linalg.norm(found - places[frame.entries.ids], axis=1)
                right += int((apart < 3.0).sum())
                wrong += int((apart >= 3.0).sum())
    assert right >= 40
    assert wrong == 0


def test_bearings_from_a_robot_at_rest_tell_no_distance() -> None:
    log = straight("bearing_only", 1, steps=30)
    still = Log(log.name, log.problem, log.t, np.tile(np.eye(3), (30, 1, 1)), 1e-9 * log.Q,
                (log.detections[0],) * 30)  # fmt: skip
    assert all(frame.entries is None for frame in delayed_start(still, 0).frames)


def test_a_first_range_that_was_wrong_is_given_up() -> None:
    log = straight("range_only", 3, turn=0.1)
    wrong = log.detections[0].z.copy()
    wrong += 9.0
    spoilt = (Detections(wrong, log.detections[0].R, log.detections[0].ids), *log.detections[1:])
    stream = delayed_start(Log(log.name, log.problem, log.t, log.T_prev_body, log.Q, spoilt), 0)
    entered = {i for frame in stream.frames if frame.entries is not None for i in frame.entries.ids.tolist()}
    assert len(entered) >= 4
    assert stream.report is not None
    assert stream.report.totals()["mahalanobis"] >= 10


def test_what_cannot_be_used_is_counted() -> None:
    log = straight("range_only", 0, steps=3)
    z = log.detections[0].z.copy()
    z[0], z[1] = np.nan, 40.0
    odd = Detections(z, log.detections[0].R, np.array([0, 1, -1, 3, 3]))
    stream = delayed_start(
        Log(log.name, log.problem, log.t, log.T_prev_body, log.Q, (odd, *log.detections[1:])),
        0,
        range_max_m=35.0,
    )
    assert stream.report is not None
    first = dict(zip(stream.report.columns, stream.report.counts[0].tolist(), strict=True))
    assert first == {
        "raw": 5, "not_finite": 1, "unlabelled": 1, "duplicate": 1, "range": 1, "mahalanobis": 0,
        "undecided": 1, "kept": 0,
    }  # fmt: skip


def test_who_may_use_it() -> None:
    with pytest.raises(
        UsageError, match=r"'range_bearing' is neither range_only nor bearing_only.*'labelled'"
    ):
        delayed_start(circle(0, steps=3), 0)
    ranges = circle(0, steps=3, sensor="range_only")
    with pytest.raises(UsageError, match=r"range_only: one measurement does not place .* 'delayed_start'"):
        labelled(ranges, 0)
    with pytest.raises(UsageError, match="the largest range must be above"):
        delayed_start(ranges, 0, range_min_m=3.0, range_max_m=2.0)


def test_the_worlds_measure_the_parts_of_the_same_readings() -> None:
    whole = circle(5, steps=20, outlier_fraction=0.2)
    for sensor, column in (("range_only", 0), ("bearing_only", 1)):
        part = circle(5, steps=20, outlier_fraction=0.2, sensor=sensor)
        assert part.problem.sensor.name == sensor
        for ours, both in zip(part.detections, whole.detections, strict=True):
            np.testing.assert_array_equal(ours.ids, both.ids)
            np.testing.assert_array_equal(ours.z[:, 0], both.z[:, column])
            np.testing.assert_array_equal(ours.R[:, 0, 0], both.R[:, column, column])
    assert math.isclose(whole.detections[0].R[0, 0, 0], 0.01)
