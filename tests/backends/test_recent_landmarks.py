"""Smoothers with a window that let go of what they saw long ago."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import slamcmp
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.backends.recent_landmarks import RecentLandmarks
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.types import Frame, MeasurementStream


@pytest.fixture(scope="module")
def corridor() -> MeasurementStream:
    """There and never back: what is out of sight stays so."""
    stream = slamcmp.make_stream("corridor", length_m=100.0, steps=80, landmarks=60, range_max_m=4.0)
    seen: dict[int, list[int]] = {}
    for frame in stream.frames:
        for landmark in frame.ids.tolist():
            seen.setdefault(landmark, []).append(frame.k)
    assert len(seen) > 12
    assert max(np.diff(each).max(initial=1) for each in seen.values()) < 6
    return stream


WINDOWS = {"sliding_window": (SlidingWindow, {"window": 6}), "fixed_lag": (FixedLag, {"lag_frames": 6})}


@pytest.mark.parametrize("name", WINDOWS)
def test_what_is_never_seen_again_leaves_without_a_trace(corridor: MeasurementStream, name: str) -> None:
    """A marginal prior keeps all that a landmark out of sight says of the others."""
    make, parameters = WINDOWS[name]
    everything: Any = make(corridor.problem, **parameters, most_landmarks=None)
    some: Any = make(corridor.problem, **parameters, most_landmarks=5)
    held = []
    for frame in corridor.frames:
        everything.update(frame)
        some.update(frame)
        held.append(some.diagnostics()["landmarks"])
        one, other = everything.estimate(), some.estimate()
        np.testing.assert_allclose(other.T_world_body, one.T_world_body, rtol=0, atol=1e-7)
        np.testing.assert_allclose(other.P, one.P, rtol=1e-5, atol=1e-12)
    assert max(held) < everything.diagnostics()["landmarks"]
    assert held[-1] < 12
    if name == "fixed_lag":
        # Those that left stand in the map as they were then.
        assert some.landmarks().ids.tolist() == everything.landmarks().ids.tolist()


@pytest.mark.parametrize("name", WINDOWS)
def test_the_default_keeps_all_of_a_small_map(corridor: MeasurementStream, name: str) -> None:
    make, parameters = WINDOWS[name]
    answers = []
    for more in ({}, {"most_landmarks": None}):
        back_end: Any = make(corridor.problem, **parameters, **more)
        for frame in corridor.frames[:40]:
            back_end.update(frame)
        answers.append(back_end.estimate())
    np.testing.assert_array_equal(answers[0].T_world_body, answers[1].T_world_body)
    np.testing.assert_array_equal(answers[0].P, answers[1].P)


@pytest.mark.parametrize("name", WINDOWS)
def test_what_comes_back_starts_anew(name: str) -> None:
    """Laps past more landmarks than are kept: no failure, and no landmark twice in the map."""
    stream = slamcmp.make_stream("circle", steps=130, landmarks=15, range_max_m=4.0)
    make, parameters = WINDOWS[name]
    back_end: Any = make(stream.problem, **parameters, most_landmarks=4)
    for frame in stream.frames:
        back_end.update(frame)
    assert stream.truth is not None
    off = back_end.estimate().T_world_body[:2, 2] - stream.truth.T_world_body[-1, :2, 2]
    sigma = np.sqrt(np.trace(back_end.estimate().P[:2, :2]))
    assert np.linalg.norm(off) < 5.0 * sigma
    ids = back_end.landmarks().ids.tolist()
    assert len(ids) == len(set(ids))


def test_the_longest_unseen_go_and_only_those_out_of_sight() -> None:
    recent = RecentLandmarks(2)
    for k, ids in enumerate([[7, 3], [5], [3, 9], [9]]):
        z, R = np.zeros((len(ids), 2)), np.tile(np.eye(2), (len(ids), 1, 1))
        recent.see(Frame(k, float(k), np.eye(3), np.eye(3) * (k > 0), np.array(sorted(ids)), z, R))
    held = [7, 3, 5, 9]
    assert recent.too_many(held, unseen_since=3) == [7, 5]
    assert recent.too_many([3, 9], unseen_since=3) == []
    assert recent.too_many([3, 5, 9], unseen_since=1) == [5]
