"""Each stage of the tracker by itself: one match is moved, hidden or changed, and its fate is known."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.frontend.vision.tracking import tracker as tracker_module
from slamcmp.frontend.vision.tracking.placing import Placed
from slamcmp.geometry import exp
from tests.frontend.given_features import (
    ALONG_THE_LINE,
    OFF_THE_LINE,
    PAIR,
    R_PAIR,
    SINGLE,
    SURE,
    TO_THE_LEFT,
    Following,
    Points,
    taken,
)

Patch = pytest.MonkeyPatch
TURNING = np.diag([1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2]) ** 2
"""Odometry whose rotation leaves three pixels open: a window takes in what lies ten away."""


def test_a_match_off_its_epipolar_line_is_rejected_though_its_window_is_wide(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, SINGLE)
    robot.see(points.view(robot.T))
    seen = robot.see(robot.drive(points).moved(7, 6.0 * OFF_THE_LINE), TO_THE_LEFT, TURNING)
    assert seen.event == ""
    assert taken(seen, "epipolar") == 1
    assert seen.matches is not None
    np.testing.assert_array_equal(np.flatnonzero(~seen.matches.epipolar), [7])
    np.testing.assert_array_equal(np.flatnonzero(~seen.matches.passed), [7])


def test_what_all_matches_say_together_sharpens_the_test_of_each(monkeypatch: Patch) -> None:
    """Odometry is off by two deviations; a match beside its place lies where odometry expected it."""
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    error = exp(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]))
    view = robot.drive(points, TO_THE_LEFT @ error)
    odd = np.array([20])
    # A turn to the left moves the picture to the right.
    seen = robot.see(view.moved(odd, -5.0 * ALONG_THE_LINE), TO_THE_LEFT, TURNING)
    assert seen.matches is not None
    assert seen.matches.epipolar.all()
    np.testing.assert_array_equal(np.flatnonzero(~seen.matches.passed), odd)
    assert taken(seen, "mahalanobis") == 1
    # The tracks have moved with the correction: the next image is expected where it is.
    again = robot.see(robot.drive(points), TO_THE_LEFT)
    assert taken(again, "mahalanobis") == 0
    assert again.detections.ids.size >= 55


def test_the_common_motion_is_asked_of_trusted_matches_only_and_of_enough(monkeypatch: Patch) -> None:
    asked = []

    def spy(y: np.ndarray, S: np.ndarray, H: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(S)
        return np.zeros(6), Q

    monkeypatch.setattr(tracker_module, "common_motion", spy)
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    before = robot.tracker._tracks.C.copy()
    view = robot.drive(points).moved(3, 6.0 * OFF_THE_LINE).moved(5, 3.4 * ALONG_THE_LINE).without_depth(9)
    robot.see(view, TO_THE_LEFT)
    others = np.delete(np.arange(60), [3, 5, 9])
    assert [len(S) for S in asked] == [len(others)]
    # Each innovation's own covariance: where the point was, and this measurement, without the step's doubt.
    _, H = PAIR.linearise_in_body(
        PAIR.invert(
            np.eye(4),
            np.stack([view.xy[:, 0], view.xy[:, 0] - view.disparity, view.xy[:, 1]], axis=1)[others],
        )
    )
    turn = TO_THE_LEFT[:3, :3].T
    own = H @ turn @ before[others] @ turn.T @ np.swapaxes(H, 1, 2) + R_PAIR
    np.testing.assert_allclose(asked[0], own, rtol=1e-3, atol=1e-4)
    few = Points(11)
    robot = Following(monkeypatch, PAIR)
    robot.see(few.view(robot.T))
    robot.see(robot.drive(few), TO_THE_LEFT)
    assert len(asked) == 1


def test_the_step_s_doubt_is_no_part_of_the_innovations_own(monkeypatch: Patch) -> None:
    asked = []

    def spy(y: np.ndarray, S: np.ndarray, H: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append((S, Q))
        return np.zeros(6), Q

    monkeypatch.setattr(tracker_module, "common_motion", spy)
    points = Points()
    for Q in (SURE, TURNING):
        robot = Following(monkeypatch, PAIR)
        robot.see(points.view(robot.T))
        robot.see(robot.drive(points), TO_THE_LEFT, Q)
    (of_sure, _), (of_turning, given) = asked
    np.testing.assert_allclose(of_turning, of_sure, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(given, TURNING)


@pytest.mark.parametrize(("probability", "rejected"), [(0.5, 1), (0.999, 0)])
def test_the_mahalanobis_test_has_the_share_that_was_asked_for(
    monkeypatch: Patch, probability: float, rejected: int
) -> None:
    """1.15 px in u and u_right: 1.15² / (2 · 0.25) = 2.6, between the limits 2.4 and 16.3."""
    points = Points()
    robot = Following(monkeypatch, PAIR, gate_probability=probability)
    robot.see(points.view(robot.T))
    seen = robot.see(points.view(robot.T).moved(7, 1.15 * ALONG_THE_LINE))
    assert taken(seen, "mahalanobis") == rejected
    assert seen.detections.ids.size == 60 - rejected


@pytest.mark.parametrize("depth", [True, False])
def test_a_candidate_a_little_outside_its_gate_is_a_match_that_fails(monkeypatch: Patch, depth: bool) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    view = robot.drive(points).moved(7, 3.4 * ALONG_THE_LINE)
    seen = robot.see(view if depth else view.without_depth(7), TO_THE_LEFT)
    assert taken(seen, "mahalanobis") == 1
    assert taken(seen, "unmatched") == 0
    assert 7 not in seen.detections.ids


def test_a_ray_outside_its_window_fails_without_any_epipolar_test(monkeypatch: Patch) -> None:
    few = Points(6)
    robot = Following(monkeypatch, SINGLE)
    robot.see(few.view(robot.T))
    seen = robot.see(robot.drive(few).moved(2, 3.2 * OFF_THE_LINE), TO_THE_LEFT)
    assert seen.event == "no epipolar test: too few"
    assert taken(seen, "mahalanobis") == 1
    assert taken(seen, "no_parallax") + taken(seen, "unconfirmed") == 5


def test_a_feature_outside_the_window_is_no_candidate(monkeypatch: Patch) -> None:
    """The same descriptor 30 px away: there it is another thing that looks alike."""
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    seen = robot.see(robot.drive(points).moved(7, 30.0 * ALONG_THE_LINE), TO_THE_LEFT)
    assert seen.matches is not None
    assert len(seen.matches.now) == 59


@pytest.mark.parametrize(("bits", "kept"), [(0, 59), (40, 60)])
def test_two_alike_candidates_in_one_window_are_no_match(monkeypatch: Patch, bits: int, kept: int) -> None:
    """The second one 4 bits or 44 bits from the first, the track 4 bits from the first."""
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    view = robot.drive(points)
    twin = view.only([7]).moved(0, 1.5 * ALONG_THE_LINE).unlike(0, 4 + bits)
    view = view.unlike(7, 4)
    both = type(view)(
        *(np.concatenate([getattr(view, n), getattr(twin, n)]) for n in ("xy", "disparity", "descriptors"))
    )
    seen = robot.see(both, TO_THE_LEFT)
    assert seen.matches is not None
    assert len(seen.matches.now) == kept


def test_two_tracks_do_not_share_one_feature(monkeypatch: Patch) -> None:
    """Where one of two alike points is hidden, the other one's feature is not taken for both."""
    points = Points()
    points.places[8] = points.places[7] + [0.0, 0.02, 0.0]
    points.descriptors[8] = points.view(np.eye(4)).unlike(7, 3).descriptors[7]
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    seen = robot.see(robot.drive(points).only(np.delete(np.arange(60), 8)), TO_THE_LEFT)
    assert seen.matches is not None
    places, times = np.unique(seen.matches.now, axis=0, return_counts=True)
    assert times.max() == 1
    assert len(places) == 59


@pytest.mark.parametrize(("hidden", "bits", "found"), [(9, 40, True), (10, 40, False), (10, 30, True)])
def test_after_a_while_out_of_sight_only_a_sure_likeness_counts(
    monkeypatch: Patch, hidden: int, bits: int, found: bool
) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    others = np.delete(np.arange(60), 7)
    for _ in range(hidden):
        robot.see(points.view(robot.T).only(others))
    seen = robot.see(points.view(robot.T).unlike(7, bits))
    assert seen.matches is not None
    assert len(seen.matches.now) == 59 + found
    assert taken(seen, "unmatched") in (0, 1)


def test_a_track_looks_like_its_last_sighting(monkeypatch: Patch) -> None:
    """25 bits change from image to image; after six of them the first descriptor is far away."""
    points = Points()
    robot = Following(monkeypatch, PAIR)
    view = points.view(robot.T)
    robot.see(view)
    for k in range(1, 7):
        bits = np.unpackbits(view.descriptors, axis=1)
        bits[:, 25 * k : 25 * k + 25] ^= 1
        view = type(view)(view.xy, view.disparity, np.packbits(bits, axis=1))
        seen = robot.see(view)
        assert seen.detections.ids.size == 60
    np.testing.assert_array_equal(np.sort(seen.detections.ids), np.arange(60))


@pytest.mark.parametrize("why", ["hidden", "bad image"])
@pytest.mark.parametrize(("frames", "remembered"), [(4, True), (5, False)])
def test_a_landmark_is_remembered_for_so_many_frames_and_no_longer(
    monkeypatch: Patch, why: str, frames: int, remembered: bool
) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR, memory=4)
    first = robot.see(points.view(robot.T))
    for _ in range(frames):
        robot.see(None if why == "bad image" else points.view(robot.T).only(np.arange(1, 60)))
    robot.see(points.view(robot.T))
    # A new track is a landmark from its second sighting on.
    second = robot.see(points.view(robot.T))
    old = first.detections.ids[first.detections.z[:, 0].argsort()]
    new = second.detections.ids[second.detections.z[:, 0].argsort()]
    assert old.size == new.size == 60
    forgotten = 0 if remembered else (60 if why == "bad image" else 1)
    assert np.setdiff1d(new, old).size == forgotten
    # Ids are never used again.
    assert not forgotten or np.setdiff1d(new, old).min() == 60


def test_a_ray_must_be_seen_in_every_image(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, SINGLE)
    robot.see(points.view(robot.T))
    robot.see(points.view(robot.T).only(np.arange(1, 60)))
    assert len(robot.tracker._tracks) == 59


def test_a_gap_of_bad_images_is_bridged_by_the_odometry_of_all_of_them(monkeypatch: Patch) -> None:
    """Four turns of 15 px: where the last one alone would lead nothing is found."""
    points = Points()
    turn = exp(np.array([0.0, 0.0, -0.05, 0.0, 0.02, 0.0]))
    for camera in (SINGLE, PAIR):
        robot = Following(monkeypatch, camera)
        robot.see(points.view(robot.T))
        for _ in range(3):
            robot.drive(points, turn)
            assert robot.see(None, turn).event == "no image"
        view = robot.drive(points, turn)
        inside = (view.xy > 5).all(axis=1) & (view.xy < [315, 235]).all(axis=1)
        seen = robot.see(view, turn)
        assert seen.matches is not None
        assert inside.sum() > 45
        assert len(seen.matches.now) >= inside.sum() - 2
        assert seen.matches.passed.mean() > 0.95


@pytest.mark.parametrize(("rejections", "same"), [(2, True), (3, False)])
def test_three_rejections_in_a_row_end_a_track(monkeypatch: Patch, rejections: int, same: bool) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    for _ in range(rejections):
        robot.see(points.view(robot.T).moved(7, 3.4 * ALONG_THE_LINE))
    for _ in range(2):
        seen = robot.see(points.view(robot.T))
    at_seven = np.linalg.norm(seen.detections.z[:, [0, 2]] - points.view(robot.T).xy[7], axis=1).argmin()
    assert bool(seen.detections.ids[at_seven] == 7) is same
    # A sighting in between makes amends.
    for _ in range(2):
        for moved in (3.4, 3.4, 0.0):
            seen = robot.see(points.view(robot.T).moved(9, moved * ALONG_THE_LINE))
    assert 9 in seen.detections.ids


def test_a_point_is_a_landmark_from_its_stated_sighting_on(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR, min_sightings=3)
    # Without landmarks to hold the pose, all points count at once …
    assert robot.see(points.view(robot.T).only(np.arange(30))).detections.ids.size == 30
    assert taken(robot.see(points.view(robot.T).only(np.arange(30))), "unconfirmed") == 30
    # … with them, new ones wait.
    sizes = [robot.see(points.view(robot.T)).detections.ids.size for _ in range(4)]
    assert sizes == [30, 30, 60, 60]


def test_without_depth_a_sighting_is_no_measurement_but_narrows_its_track(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    before = np.trace(robot.tracker._tracks.C, axis1=1, axis2=2)
    seen = robot.see(points.view(robot.T).without_depth(7), None, 1e-6 * SURE)
    after = np.trace(robot.tracker._tracks.C, axis1=1, axis2=2)
    assert taken(seen, "no_depth") == 1
    assert 7 not in seen.detections.ids
    assert seen.detections.ids.size == 59
    assert np.isfinite(seen.detections.z).all()
    # A second equal measurement halves the variance; a pixel alone leaves most of the depth's.
    np.testing.assert_allclose(after[:7] / before[:7], 0.5, rtol=1e-3)
    assert 0.5 < after[7] / before[7] < 0.999


def test_so_many_points_are_followed_at_a_time_spread_over_the_image(monkeypatch: Patch) -> None:
    points = Points(108)
    left = points.view(np.eye(4)).xy[:, 0] < 160
    order = np.concatenate([np.flatnonzero(left), np.flatnonzero(~left)])
    robot = Following(monkeypatch, PAIR, followed=40)
    # All corners of the left half are stronger than those of the right.
    first = robot.see(points.view(robot.T).only(order))
    assert first.detections.ids.size == 40
    assert (first.detections.z[:, 0] > 160).sum() >= 15
    again = robot.see(points.view(robot.T).only(order))
    np.testing.assert_array_equal(np.sort(again.detections.ids), np.arange(40))
    assert len(robot.tracker._tracks) == 40


def test_new_points_keep_away_from_those_that_are_followed(monkeypatch: Patch) -> None:
    points = Points(30)
    extra = Points(30, seed=1)
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    now, more = points.view(robot.T), extra.view(robot.T).only([0, 1])
    # One beside a followed point, one far from all.
    more.xy[0], more.xy[1] = now.xy[4] + [6.0, 6.0], now.xy.max(axis=0) + np.array([20.0, 20.0])
    both = type(now)(
        *(np.concatenate([getattr(now, n), getattr(more, n)]) for n in ("xy", "disparity", "descriptors"))
    )
    robot.see(both)
    assert len(robot.tracker._tracks) == 31
    np.testing.assert_array_equal(robot.tracker._tracks.pixel[30], more.xy[1])


def test_where_nothing_is_known_well_nothing_is_looked_for(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, PAIR)
    robot.see(points.view(robot.T))
    seen = robot.see(points.view(robot.T), None, np.diag([0.3, 0.3, 0.3, 1e-3, 1e-3, 1e-3]) ** 2)
    assert seen.matches is not None
    assert len(seen.matches.now) == 0
    assert seen.detections.ids.size == 60
    assert seen.detections.ids.min() == 60


def test_rays_that_no_point_explains_are_dropped_at_once(monkeypatch: Patch) -> None:
    points = Points()
    robot = Following(monkeypatch, SINGLE)
    robot.see(points.view(robot.T))
    nobody = np.empty(0, np.int64)

    def contradicted(tracks: object, rows: np.ndarray, *_: object, **__: object) -> Placed:
        return Placed(nobody, np.empty((0, 3)), np.empty((0, 3, 3)), rows[:5])

    monkeypatch.setattr(tracker_module, "place_rays", contradicted)
    robot.see(robot.drive(points), TO_THE_LEFT)
    assert len(robot.tracker._tracks) == 55


def test_a_ray_outlives_the_history_of_poses(monkeypatch: Patch) -> None:
    monkeypatch.setattr(tracker_module, "_HISTORY", 4)
    points = Points()
    robot = Following(monkeypatch, SINGLE, parallax_min_deg=80.0)
    step = exp(np.array([0.0, 0.0, 0.0, 0.0, 0.02, 0.0]))
    robot.see(points.view(robot.T))
    for _ in range(8):
        seen = robot.see(robot.drive(points, step), step)
    assert taken(seen, "no_parallax") > 50
