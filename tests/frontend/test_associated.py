"""The front end that is told no labels: its own map, ghosts, and what it makes of worlds."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.frontend.associated import associated
from slamcmp.frontend.candidates import Candidates
from slamcmp.frontend.own_map import OwnMap
from slamcmp.geometry import inverse, se2, transform
from slamcmp.metrics.association import association_scores
from slamcmp.models.camera import MonoCamera
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, FloatArray, Log, Problem
from slamcmp.worlds.planar import figure_eight

SENSOR = make_sensor("relative_position", {"space_dim": 2})


def standing(points: list[list[tuple[float, float]]], labels: list[list[int]] | None = None) -> Log:
    """A robot that does not move and sees these points in the body frame, to 5 cm."""
    frames = len(points)
    detections = tuple(
        Detections(
            np.array(each, dtype=float).reshape(-1, 2),
            np.tile(0.05**2 * np.eye(2), (len(each), 1, 1)),
            np.full(len(each), -1) if labels is None else np.array(labels[k], dtype=np.int64),
        )
        for k, each in enumerate(points)
    )
    Q = np.tile(1e-8 * np.eye(3), (frames, 1, 1))
    Q[0] = 0.0
    return Log(
        "standing",
        Problem(np.eye(3), np.zeros((3, 3)), SENSOR),
        np.arange(frames, dtype=float),
        np.tile(np.eye(3), (frames, 1, 1)),
        Q,
        detections,
    )


A, B, GHOST = (2.0, 0.0), (0.0, 3.0), (-4.0, 1.0)


def test_a_landmark_is_confirmed_by_k_of_n_sightings_and_a_ghost_is_deleted() -> None:
    """A in frames 0, 1, 3 is confirmed at 3 (3 of 4); the ghost in 0 and 5 never is."""
    log = standing([[A, GHOST], [A], [B], [A], [A], [B, GHOST], [A]])
    stream = associated(log, 0, confirm_sightings=3, confirm_frames=4)
    assert [frame.ids.tolist() for frame in stream.frames] == [[], [], [], [0], [0], [], [0]]
    late = associated(log, 0, confirm_sightings=3, confirm_frames=4, held_back="inserted")
    assert [frame.ids.tolist() for frame in late.frames] == [[0], [0], [], [0], [0], [], [0]]


def test_one_frame_fewer_makes_it_a_ghost() -> None:
    log = standing([[A], [A], [B], [A], [B]])
    assert [f.ids.size for f in associated(log, 0, confirm_sightings=3, confirm_frames=3).frames] == [0] * 5
    kept = associated(log, 0, confirm_sightings=3, confirm_frames=4)
    assert [frame.ids.tolist() for frame in kept.frames] == [[], [], [], [0], []]


def test_frames_without_detections_do_not_count() -> None:
    log = standing([[A], [], [], [], [A], [A]])
    stream = associated(log, 0, confirm_sightings=2, confirm_frames=2)
    assert [frame.ids.tolist() for frame in stream.frames] == [[], [], [], [], [0], [0]]


def test_candidates_leave_last_first() -> None:
    candidates = Candidates(2, 2)
    for frame in range(3):
        candidates.add(frame, (frame, 0))
    candidates.see(candidates.rows[1], (1, 0))
    assert candidates.ghosts(3) == [2, 0]
    assert [each.name for each in candidates.rows] == [0]


def test_labels_decide_nothing() -> None:
    """The same log with labels, with wrong ones and with none gives one stream."""
    points = [[A, B], [A, B], [B, A]]
    logs = [standing(points, labels) for labels in (None, [[7, 8], [7, 8], [8, 7]], [[1, 2], [2, 1], [5, 5]])]
    assert len({associated(log, 0).digest for log in logs}) == 1


def test_the_same_stream_each_time() -> None:
    log = figure_eight(0, steps=40)
    assert associated(log, 0).digest == associated(log, 0).digest


def test_what_lies_between_the_gates_is_left_out() -> None:
    """0.25 m from a landmark known to 0.05/√2 after two sightings: neither its own nor new."""
    log = standing([[A], [A], [(2.25, 0.0)], [A]])
    stream = associated(log, 0, gate_probability=0.99, new_probability=1 - 1e-12)
    assert [frame.ids.tolist() for frame in stream.frames] == [[], [0], [], [0]]
    assert stream.report is not None
    assert stream.report.totals()["not_clear"] == 1


def test_a_detection_that_could_be_of_two_landmarks_is_left_out() -> None:
    near, far, between = (2.0, 0.0), (2.3, 0.0), (2.15, 0.0)
    log = standing([[near, far], [near, far], [between]])
    strict = associated(log, 0, gate_probability=0.999999, new_probability=1 - 1e-12)
    assert strict.frames[2].ids.size == 0
    every = associated(log, 0, gate_probability=0.999999, new_probability=1 - 1e-12, least_probability=None)
    assert every.frames[2].ids.size == 1


def test_not_finite_and_too_far_are_counted_and_harm_nothing() -> None:
    log = standing([[A, (np.nan, 1.0)], [A, (50.0, 0.0)], [A]])
    report = associated(log, 0, range_max_m=10.0).report
    assert report is not None
    assert report.counts.tolist() == [[2, 1, 0, 0, 1, 0], [2, 0, 1, 0, 0, 1], [1, 0, 0, 0, 0, 1]]


@pytest.mark.parametrize("method", ["nearest_neighbour", "maximum_likelihood", "joint_compatibility"])
@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_a_planar_world_with_hidden_labels(method: str, outliers: float) -> None:
    log = figure_eight(1, steps=120, outlier_fraction=outliers)
    report = associated(log, 0, method=method).report  # type: ignore[arg-type]
    assert report is not None
    assert report.association is not None
    scores = association_scores(report.association)
    assert scores["association_precision"] >= 0.98
    assert scores["association_recall"] >= 0.9


def test_the_own_map_is_the_kalman_filter_of_its_definition() -> None:
    """One step and one correction against matrices written out, at fixed scales."""
    rng = np.random.default_rng(0)
    own = OwnMap(2, 0.0)
    q = rng.normal(size=(3, 2)) * 3
    for row in q:
        own.add(row, 0.01 * np.eye(2))
    T, Q = se2(0.5, 0.1, 0.3), np.diag([0.01, 0.002, 0.003])
    own.predict(T, Q)
    moved = transform(inverse(T), q)
    J = np.array([[0.0, -1.0], [1.0, 0.0]])
    H = np.concatenate([np.hstack([-np.eye(2), -(J @ each)[:, None]]) for each in moved])
    P = 0.01 * np.eye(6) + H @ Q @ H.T
    assert own.q == pytest.approx(moved)
    assert own.P[2:, 2:] == pytest.approx(P)
    x, N = moved[[2, 0]] + 0.05, np.tile(0.04 * np.eye(2), (2, 1, 1))
    select = np.zeros((4, 6))
    select[[0, 1, 2, 3], [4, 5, 0, 1]] = 1.0
    K = P @ select.T @ np.linalg.inv(select @ P @ select.T + 0.04 * np.eye(4))
    own.correct(np.array([2, 0]), x, N)
    assert own.q.ravel() == pytest.approx(moved.ravel() + K @ np.full(4, 0.05))
    assert own.P[2:, 2:] == pytest.approx(P - K @ select @ P)


def test_a_wrong_odometer_is_found() -> None:
    """It tells 10 % too much of everything; landmarks are seen from two sides."""
    rng = np.random.default_rng(1)
    places = rng.uniform(-4, 4, (8, 2))
    own, T = OwnMap(2, 0.2), np.eye(3)
    sigma = 0.02
    for k in range(120):
        if k:
            v, turn = 0.2, 0.1 * np.cos(0.05 * k)
            T = T @ se2(v, 0.0, turn)
            own.predict(_increment(1.1 * v, 1.1 * turn), np.diag([1e-6, 1e-8, 1e-7]))
        x = transform(inverse(T), places) + sigma * rng.normal(size=places.shape)
        N = np.tile(sigma**2 * np.eye(2), (8, 1, 1))
        if k:
            own.correct(np.arange(8), x, N)
        else:
            for point in x:
                own.add(point, sigma**2 * np.eye(2))
    # 1 / 1.1 - 1.
    assert own.a == pytest.approx([-0.0909, -0.0909], abs=4 * np.sqrt(np.diag(own.P)[:2]).max())
    assert np.sqrt(np.diag(own.P)[:2]).max() < 0.02


def _increment(v: float, turn: float) -> FloatArray:
    return se2(v, 0.0, turn)


def test_a_sensor_that_places_nothing_is_refused() -> None:
    camera = MonoCamera(fx_px=500.0, fy_px=500.0, cx_px=320.0, cy_px=240.0)
    nothing = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, np.int64))
    log = Log(
        "camera",
        Problem(np.eye(4), np.eye(6), camera),
        np.zeros(1),
        np.eye(4)[None],
        np.zeros((1, 6, 6)),
        (nothing,),
    )
    with pytest.raises(UsageError, match="does not place a landmark; range_bearing or relative_position"):
        associated(log, 0)


def test_k_that_do_not_fit_into_n_are_refused() -> None:
    with pytest.raises(UsageError, match="confirm_frames is 2 and confirm_sightings 3"):
        associated(standing([[A]]), 0, confirm_sightings=3, confirm_frames=2)
