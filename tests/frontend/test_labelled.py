"""The planar front end: what each stage removes, and what its own Mahalanobis test lets through."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

from slamcmp import geometry
from slamcmp.errors import UsageError
from slamcmp.frontend.labelled import STAGES, labelled
from slamcmp.frontend.landmark_tracks import LandmarkTracks
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, Log, Problem
from slamcmp.worlds.planar import circle

R_ONE = np.diag([0.1, 0.02]) ** 2


def log_of(*frames: list[tuple[int, float, float]], Q: np.ndarray | None = None) -> Log:
    """A standing robot's log from (id, range, bearing) triples."""
    detections = []
    for frame in frames:
        rows = np.array(frame, dtype=float).reshape(-1, 3)
        detections.append(
            Detections(rows[:, 1:], np.broadcast_to(R_ONE, (len(rows), 2, 2)), rows[:, 0].astype(np.int64))
        )
    K = len(frames)
    increments = np.broadcast_to(np.eye(3), (K, 3, 3))
    noise = np.zeros((K, 3, 3))
    noise[1:] = 1e-6 * np.eye(3) if Q is None else Q
    problem = Problem(np.eye(3), 1e-6 * np.eye(3), make_sensor("range_bearing", {}))
    return Log("hand-made", problem, np.arange(K, dtype=float), increments, noise, tuple(detections))


def test_each_stage_counts_what_it_removes() -> None:
    log = log_of(
        [
            (1, 2.0, 0.0),
            (-1, 2.0, 0.1),
            (1, 2.1, 0.0),
            (2, 0.2, 0.0),
            (3, 9.0, 0.0),
            (4, 3.0, 2.0),
            (5, np.nan, 0),
        ]
    )
    stream = labelled(log, 0, range_min_m=0.5, range_max_m=8.0, field_of_view_deg=180.0)
    assert stream.frames[0].ids.tolist() == [1]
    assert stream.report is not None
    assert dict(zip(stream.report.columns, stream.report.counts[0].tolist(), strict=True)) == {
        "raw": 7,
        "not_finite": 1,
        "unlabelled": 1,
        "duplicate": 1,
        "range": 2,
        "field_of_view": 1,
        "mahalanobis": 0,
        "unconfirmed": 0,
        "kept": 1,
    }
    assert stream.report.kept[0].tolist() == [True, False, False, False, False, False, False]
    assert len(STAGES) + 2 == stream.report.counts.shape[1]


def test_field_of_view_is_the_full_opening_angle() -> None:
    log = log_of([(1, 2.0, 0.78), (2, 2.0, 0.79), (3, 2.0, -0.78), (4, 2.0, -0.79)])
    assert labelled(log, 0, field_of_view_deg=90.0).frames[0].ids.tolist() == [1, 3]


def test_gate_sits_at_the_chi2_quantile() -> None:
    """Second sighting of a landmark by a standing robot: innovation covariance is R + R + a little."""
    threshold = float(chdtri(2, 1 - 0.99))
    sigma = np.sqrt(2) * 0.1
    inside, outside = (2.0 + sigma * np.sqrt(threshold * share) for share in (0.98, 1.02))
    still = 1e-12 * np.eye(3)
    for distance, kept in ((inside, 1), (outside, 0)):
        log = log_of([(1, 2.0, 0.0)], [(1, distance, 0.0)], Q=still)
        assert labelled(log, 0, gate_probability=0.99).frames[1].ids.size == kept


def test_bearings_are_wrapped_in_the_test() -> None:
    log = log_of([(1, 5.0, np.pi - 0.005)], [(1, 5.0, -np.pi + 0.005)])
    assert labelled(log, 0).frames[1].ids.tolist() == [1]


def test_without_a_gate_everything_in_range_is_kept() -> None:
    log = log_of([(1, 2.0, 0.0)], [(1, 7.0, 1.0)])
    assert labelled(log, 0, gate_probability=None).frames[1].ids.tolist() == [1]
    assert labelled(log, 0).frames[1].ids.tolist() == []


def test_starts_again_after_many_rejections_in_a_row() -> None:
    elsewhere = [(1, 7.0, 1.0)]
    log = log_of([(1, 2.0, 0.0)], *[elsewhere] * 5)
    kept = [frame.ids.size for frame in labelled(log, 0, restart_after=3).frames]
    # Three rejections, the third restarts the track there, and the next two agree with it.
    assert kept == [1, 0, 0, 0, 1, 1]


def test_an_outlying_first_sighting_is_never_passed_on_when_two_must_agree() -> None:
    true = [(1, 2.0, 0.0)]
    log = log_of([(1, 7.0, 1.0)], true, true, true)
    kept = [frame.ids.size for frame in labelled(log, 0, min_sightings=2).frames]
    assert kept == [0, 0, 1, 1]
    log = log_of(true, true, true)
    assert [frame.ids.size for frame in labelled(log, 0, min_sightings=2).frames] == [0, 1, 1]


def test_prediction_is_exact_kalman_algebra() -> None:
    """One landmark, one noisy move: mean and covariance against finite differences of the body point."""
    sensor = make_sensor("relative_position", {"space_dim": 2})
    tracks = LandmarkTracks(sensor, np.inf, 5, 1)
    z, R = np.array([[3.0, 1.0]]), np.diag([0.04, 0.09])[None]
    tracks.test(np.array([7]), z, R)
    increment, Q = geometry.se2(0.5, 0.1, 0.3), np.diag([0.01, 0.02, 0.003])
    tracks.predict(increment, Q)

    def moved(q: np.ndarray, xi: np.ndarray) -> np.ndarray:
        return geometry.transform(geometry.inverse(geometry.retract(increment, xi)), q)

    h = 1e-6
    J_q = np.stack(
        [(moved(z[0] + h * e, np.zeros(3)) - moved(z[0] - h * e, np.zeros(3))) / (2 * h) for e in np.eye(2)],
        -1,
    )
    J_xi = np.stack([(moved(z[0], h * e) - moved(z[0], -h * e)) / (2 * h) for e in np.eye(3)], -1)
    np.testing.assert_allclose(tracks._q[0], moved(z[0], np.zeros(3)), atol=1e-14)
    np.testing.assert_allclose(tracks._C[0], J_q @ R[0] @ J_q.T + J_xi @ Q @ J_xi.T, atol=1e-9)


@pytest.mark.parametrize("gate", [0.95, 0.99, 0.999])
def test_false_rejections_come_at_the_stated_rate(gate: float) -> None:
    """No outliers, nearly linear: the share rejected lies within 4.5 sigma of 1 - gate.

    The tests of one landmark share its prediction; 1.5 on sigma allows for their correlation.
    """
    rejected = tested = 0
    for seed in range(10):
        log = circle(seed, steps=200, landmarks=30, sensor="relative_position", turn_sigma_deg_s=0.05)
        report = labelled(log, seed, gate_probability=gate).report
        assert report is not None
        totals = report.totals()
        rejected += totals["mahalanobis"]
        tested += totals["raw"] - 30
    expected = 1.0 - gate
    assert abs(rejected / tested - expected) < 4.5 * 1.5 * np.sqrt(expected * gate / tested)


def test_outliers_are_found_with_stated_precision_and_recall() -> None:
    true_positive = flagged = outliers = 0
    for seed in range(5):
        log = circle(seed, steps=150, landmarks=30, outlier_fraction=0.2)
        stream = labelled(log, seed, min_sightings=2)
        assert stream.report is not None
        assert log.truth is not None
        assert log.truth.outliers is not None
        column = stream.report.columns.index("mahalanobis")
        flagged += int(stream.report.counts[:, column].sum())
        for kept, bad in zip(stream.report.kept, log.truth.outliers, strict=True):
            true_positive += int((bad & ~kept).sum())
            outliers += int(bad.sum())
    # A uniform outlier falls into a gate of about a square metre, of a field of about 200, now and then.
    assert true_positive / outliers > 0.95
    assert flagged < 1.3 * outliers


@pytest.mark.parametrize("space_dim", [2, 3])
def test_works_in_the_plane_and_in_space(space_dim: int) -> None:
    rng = np.random.default_rng(0)
    sensor = make_sensor("relative_position", {"space_dim": space_dim})
    tracks = LandmarkTracks(sensor, float(chdtri(space_dim, 1e-4)), 5, 1)
    p = 3 if space_dim == 2 else 6
    world = rng.uniform(-5, 5, size=(6, space_dim))
    T = np.eye(space_dim + 1)
    rejected = 0
    for _ in range(50):
        step = rng.normal(size=p) * 0.1
        tracks.predict(geometry.exp(step), 1e-8 * np.eye(p))
        T = geometry.retract(T, step)
        z = sensor.predict(T, world) + 0.01 * rng.normal(size=world.shape)
        R = np.broadcast_to(1e-4 * np.eye(space_dim), (6, space_dim, space_dim))
        rejected += int(tracks.test(np.arange(6), z, R).rejected.sum())
    # 300 tests at a false rejection rate of 1e-4: more than one has probability 5e-4.
    assert rejected <= 1


@pytest.mark.parametrize("largest", [2.0, 1.5])
def test_ranges_that_leave_nothing_are_refused(largest: float) -> None:
    with pytest.raises(UsageError, match=rf"range_min_m is 2 and range_max_m {largest:g}: "):
        labelled(log_of([(1, 2.0, 0.0)]), 0, range_min_m=2.0, range_max_m=largest)
