"""Which earlier image the epipolar test takes, what it lets through, and when it is not made."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from slamcmp.frontend.vision.geometry.triangulation import PoseHistory
from slamcmp.frontend.vision.tracking.epipolar_test import epipolar_test
from slamcmp.frontend.vision.tracking.track_table import TrackTable
from slamcmp.geometry import exp, inverse
from tests.frontend.given_features import OFF_THE_LINE, SINGLE, Points

SIDEWAYS = np.array([0.0, 0.0, 0.0, 0.0, 0.6, 0.0])
TURN = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])


def seen_from(
    points: Points, steps: Sequence[np.ndarray], first_view: np.ndarray | None = None
) -> tuple[TrackTable, PoseHistory, np.ndarray]:
    """Tracks of all points after the steps (tangents), each from its first view on, and the last pixels."""
    poses = [np.eye(4)]
    for step in steps:
        poses.append(poses[-1] @ exp(step))
    views = [points.view(T) for T in poses]
    history = PoseHistory(20)
    history.advance(np.eye(4), np.zeros((6, 6)))
    for before, after in pairwise(poses):
        history.advance(inverse(before) @ after, np.zeros((6, 6)))
    count = len(points.places)
    begin = np.zeros(count, int) if first_view is None else first_view
    tracks = TrackTable.empty()
    tracks.add(points.descriptors, views[0].xy)
    for back, view in enumerate(reversed(views[:-1]), start=1):
        number = len(steps) - back
        shown = begin <= number
        tracks.view_pixel[shown, -back] = view.xy[shown]
        tracks.view_back[shown, -back] = back
        tracks.view_back[~shown, -back] = -1
    return tracks, history, views[-1].xy


def test_a_match_off_its_line_fails_and_all_others_pass() -> None:
    points = Points()
    tracks, history, now = seen_from(points, [SIDEWAYS])
    now[5] += 3.0 * OFF_THE_LINE
    for threshold, expected in ((1.5, [5]), (6.0, [])):
        allowed, event = epipolar_test(
            tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=threshold
        )
        assert event == ""
        np.testing.assert_array_equal(np.flatnonzero(~allowed), expected)


def test_tracks_that_the_earlier_image_does_not_show_pass() -> None:
    points = Points()
    begin = np.zeros(60, int)
    begin[50:] = 5
    tracks, history, now = seen_from(points, [SIDEWAYS], begin)
    now[[5, 55]] += 9.0 * OFF_THE_LINE
    allowed, _ = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=1.5)
    np.testing.assert_array_equal(np.flatnonzero(~allowed), [5])


def test_an_older_image_is_taken_where_the_last_one_has_no_parallax() -> None:
    """The robot has turned on the spot: 15 px of motion in the last image, but none of it is parallax."""
    points = Points()
    tracks, history, now = seen_from(points, [SIDEWAYS, TURN])
    now[5] += 4.0 * OFF_THE_LINE
    allowed, event = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=1.5)
    assert event == ""
    np.testing.assert_array_equal(np.flatnonzero(~allowed), [5])


def test_the_last_image_is_taken_where_it_has_parallax() -> None:
    points = Points()
    begin = np.zeros(60, int)
    begin[5] = 1
    tracks, history, now = seen_from(points, [SIDEWAYS, SIDEWAYS], begin)
    # What only the last image shows is tested as well.
    now[5] += 4.0 * OFF_THE_LINE
    allowed, _ = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=1.5)
    assert not allowed[5]


def test_an_older_image_that_shows_less_than_half_is_not_taken() -> None:
    points = Points()
    begin = np.ones(60, int)
    begin[:25] = 0
    # Some pixels of parallax: one would like an older image.
    tracks, history, now = seen_from(points, [0.25 * SIDEWAYS, 0.25 * SIDEWAYS], begin)
    now[50] += 3.0 * OFF_THE_LINE
    allowed, event = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=0.4)
    assert event == ""
    np.testing.assert_array_equal(np.flatnonzero(~allowed), [50])


def test_without_a_geometry_all_pass_and_the_calibration_names_the_reason() -> None:
    points = Points()
    for steps, name in (([TURN, TURN], "pure rotation"), ([0.0 * TURN], "no motion")):
        tracks, history, now = seen_from(points, steps)
        now[5] += 20.0 * OFF_THE_LINE
        allowed, event = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=1.5)
        assert event == f"no epipolar test: {name}"
        assert allowed.all()
    wall = Points()
    wall.places[:, 0] = 5.0
    tracks, history, now = seen_from(wall, [SIDEWAYS])
    _, event = epipolar_test(tracks, np.arange(60), now, SINGLE, history, seed=0, threshold_px=1.5)
    assert event == "no epipolar test: planar scene"
    _, event = epipolar_test(tracks, np.arange(60)[:12], now[:12], SINGLE, history, seed=0, threshold_px=1.5)
    assert event == "no epipolar test: too few"
    assert epipolar_test(tracks, np.arange(0), now[:0], SINGLE, history, seed=0, threshold_px=1.5)[1] == ""
