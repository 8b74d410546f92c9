"""Postponing the update of far landmarks changes no number: against the plain filter, flush after flush."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.covariances.covariance import FULL_LIMIT
from slamcmp.backends.filters.covariances.postponed import COMPRESS_AT, PostponedCovariance
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.types import MeasurementStream
from tests.backends.graph_streams import spatial_stream
from tests.toy_stream import toy_stream


class Counted:
    """The postponed filter, with the number of its flushes."""

    def __init__(self, stream: MeasurementStream, active: int, **parameters: Any) -> None:
        self.flushes = 0
        self.ekf = EkfSlam(stream.problem, active_landmarks=active, **parameters)
        covariance = self.ekf._P.storage
        assert isinstance(covariance, PostponedCovariance)
        flush = covariance._flush

        def counting(keep: int) -> None:
            self.flushes += 1
            flush(keep)

        covariance._flush = counting  # type: ignore[method-assign]
        self.covariance = covariance


def assert_same_run(stream: MeasurementStream, active: int, flushes: int, **parameters: Any) -> Counted:
    """Frame by frame and at the end; covariances to 1e-12 of the largest entry."""
    plain, postponed = EkfSlam(stream.problem, **parameters), Counted(stream, active, **parameters)
    for frame in stream.frames:
        plain.update(frame)
        postponed.ekf.update(frame)
        expected, found = plain.estimate(), postponed.ekf.estimate()
        np.testing.assert_allclose(found.T_world_body, expected.T_world_body, atol=1e-11)
        np.testing.assert_allclose(found.P, expected.P, rtol=0, atol=1e-12 * np.abs(expected.P).max())
        assert postponed.ekf.diagnostics() == pytest.approx(plain.diagnostics(), rel=1e-8, nan_ok=True)
    assert postponed.flushes >= flushes
    same_map(postponed.ekf, plain)
    return postponed


def same_map(one: EkfSlam, other: EkfSlam) -> None:
    # The map first: what it does to the postponed part must not disturb the joint covariance, and vice versa.
    here, there = one.landmarks(), other.landmarks()
    P = other.joint_covariance()
    scale = np.abs(P).max()
    np.testing.assert_array_equal(here.ids, there.ids)
    np.testing.assert_allclose(here.positions, there.positions, atol=1e-11)
    np.testing.assert_allclose(here.covariances, there.covariances, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(one.joint_covariance(), P, rtol=0, atol=1e-12 * scale)
    np.testing.assert_array_equal(one.joint_covariance(), one.joint_covariance().T)


@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
@pytest.mark.parametrize("active", [1, 6, 15])
def test_a_thousand_frames_with_hundreds_of_flushes(active: int, new_landmarks: str) -> None:
    """Any 4 of 40 landmarks a frame, so that far ones come back all the time."""
    stream, _, _ = toy_stream(frames=1000, landmarks=40, seen_at_once=4, seed=active)
    assert_same_run(stream, active, flushes=200, new_landmarks=new_landmarks)


def test_a_map_above_the_layout_limit() -> None:
    stream, _, _ = toy_stream(frames=300, landmarks=250, seen_at_once=6, sensor_name="relative_position")
    postponed = assert_same_run(stream, 90, flushes=10)
    assert postponed.covariance.size > FULL_LIMIT
    assert postponed.covariance._near.size > FULL_LIMIT


def test_a_long_stay_keeps_the_postponed_part_small() -> None:
    """Two regions of 8 landmarks in turn, 100 frames each: far more observations than extra states."""
    stream, _, _ = toy_stream(frames=400, landmarks=8, seen_at_once=3, seed=4)
    frames = tuple(replace(frame, ids=frame.ids + 100 * (frame.k // 100 % 2)) for frame in stream.frames)
    assert_same_run(MeasurementStream(stream.problem, frames), 8, flushes=2)
    postponed = Counted(stream, 8)
    for frame in frames[:395]:
        postponed.ekf.update(frame)
    rows, states = sum(map(len, postponed.covariance._V)), postponed.covariance._u.size
    assert states <= 3 + 2 * 16
    assert 0 < rows <= COMPRESS_AT * states < 6 * 90


def test_poses_and_landmarks_in_space() -> None:
    stream, _, _ = spatial_stream(frames=200, landmarks=30)
    assert_same_run(stream, 7, flushes=40)


def test_while_everything_is_near_it_is_the_plain_filter_to_the_bit(plain_filters: None) -> None:
    """To rounding where the plain one is compiled: ``assert_same_run`` of the others."""
    stream, _, _ = toy_stream(frames=100, landmarks=20)
    postponed = assert_same_run(stream, 20, flushes=0)
    plain = EkfSlam(stream.problem)
    for frame in stream.frames:
        plain.update(frame)
    np.testing.assert_array_equal(postponed.ekf.estimate().P, plain.estimate().P)
    np.testing.assert_array_equal(postponed.ekf.landmarks().positions, plain.landmarks().positions)


def test_asking_for_the_map_on_the_way_changes_nothing() -> None:
    stream, _, _ = toy_stream(frames=200, landmarks=30, seed=9)
    asked = EkfSlam(stream.problem, active_landmarks=8)
    plain = EkfSlam(stream.problem)
    for frame in stream.frames:
        asked.update(frame)
        plain.update(frame)
        if frame.k % 7 == 0:
            same_map(asked, plain)
    same_map(asked, plain)


@pytest.mark.slow
def test_a_thousand_landmarks_over_a_thousand_frames() -> None:
    stream, _, _ = toy_stream(frames=1500, landmarks=1000, seen_at_once=10, seed=1)
    assert_same_run(stream, 60, flushes=100)
