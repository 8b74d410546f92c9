"""Planar worlds: exact truth, honest noise, independent seeds, limits that hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from slamcmp import geometry as g
from slamcmp.models.motion import Unicycle
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Log
from tests.worlds.planar_logs import ODOMETRY, WORLDS, as_stream, make

NO_NOISE = {
    "speed_sigma_m_s": 0.0,
    "turn_sigma_deg_s": 0.0,
    "lateral_sigma_m": 0.0,
    "steering_sigma_deg": 0.0,
    "wheel_sigma_m": 0.0,
    "prior_position_sigma_m": 0.0,
    "prior_heading_sigma_rad": 0.0,
    "resolution": 0.0,
}


def residuals(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Sensor errors of all detections that are not outliers, and the standard deviations."""
    sensor, errors, sigmas = log.problem.sensor, [], []
    for T, seen, wild in zip(log.truth.T_world_body, log.detections, log.truth.outliers, strict=True):
        expected = sensor.predict(T, log.truth.positions[seen.ids])
        errors.append(sensor.residual(seen.z, expected)[~wild])
        sigmas.append(np.sqrt(np.diagonal(seen.R, axis1=1, axis2=2))[~wild])
    return np.concatenate(errors), np.concatenate(sigmas)


def odometry_errors(log: Log) -> np.ndarray:
    """(K-1, 3): true increment seen from the measured one, in the body tangent."""
    T = log.truth.T_world_body
    return g.local(log.T_prev_body[1:], g.inverse(T[:-1]) @ T[1:])


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("odometry", ODOMETRY)
def test_without_noise_odometry_is_the_truth(name, odometry):
    log = make(name, odometry=odometry, steps=120, **NO_NOISE)
    path = g.dead_reckoning(log.problem.T_world_body, log.T_prev_body)
    np.testing.assert_allclose(path, log.truth.T_world_body, rtol=0, atol=1e-11)
    assert not log.Q.any()


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position"])
@pytest.mark.parametrize("name", WORLDS)
def test_as_noise_vanishes_detections_become_the_truth(name, sensor):
    log = make(name, sensor=sensor, steps=60, noise_scale=1e-12, resolution=0.0)
    errors, sigmas = residuals(log)
    assert len(errors) > 100
    assert np.abs(errors).max() < 1e-11
    assert sigmas.max() <= 0.1e-12


@pytest.mark.parametrize("name", WORLDS)
def test_defaults_make_a_classroom_example(name):
    log = make(name)
    counts = np.array([seen.ids.size for seen in log.detections])
    found = np.unique(np.concatenate([seen.ids for seen in log.detections]))
    assert 20 <= len(log.truth.ids) <= 100
    assert len(found) >= 0.9 * len(log.truth.ids)
    assert counts.mean() > 4
    assert np.count_nonzero(counts == 0) == 0
    # The robot comes back: some late pose lies within 3 m of where it was in its first quarter.
    p = log.truth.T_world_body[:, :2, 2]
    quarter = len(p) // 4
    gaps = np.linalg.norm(p[-quarter:, None] - p[None, :quarter], axis=-1)
    assert gaps.min() < 3.0
    # A positive definite Q is what factor graphs need.
    assert np.linalg.eigvalsh(log.Q[1:]).min() > 1e-6
    as_stream(log)


@pytest.mark.parametrize(
    ("name", "lap_m"),
    [
        ("circle", 2 * math.pi * 10),
        ("corridor", 2 * 60 + 2 * math.pi * 10),
        ("figure_eight", 4 * math.pi * 10),
        # Six lanes of 25 m, five half turns, two quarter turns, and 80 m along the side.
        ("lawnmower", 6 * 25 + 6 * math.pi * 10 + 80),
    ],
)
def test_closed_courses_close(name, lap_m):
    # One radian per second at 10 m/s is a bend of radius 10 m; each leg takes a whole number of steps of
    # at most 0.1 m, so the course closes exactly, a few steps after its length alone would say. Only the
    # circle has no legs: it passes within half a step.
    steps = math.ceil(lap_m / 0.1) + 40
    log = make(name, speed_m_s=10.0, turn_deg_s=math.degrees(1.0), time_step_s=0.01, steps=steps, landmarks=3)
    p = log.truth.T_world_body[:, :2, 2]
    later = p[steps - 60 :]
    closest = later[np.argmin(np.linalg.norm(later, axis=1))]
    np.testing.assert_allclose(closest, 0.0, rtol=0, atol=1e-9 if name != "circle" else 0.06)


def test_circle_ring_is_the_published_layout():
    # ukfm's planar SLAM benchmark: 20 landmarks on a circle of radius v/w + 3 about (0, v/w).
    log = make("circle", speed_m_s=0.25, turn_deg_s=1.5, layout="ring", landmarks=20, steps=10)
    radius = 0.25 / math.radians(1.5)
    offsets = log.truth.positions - [0.0, radius]
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), radius + 3.0)
    np.testing.assert_allclose(np.diff(np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0]))), math.pi / 10)
    centre = log.truth.T_world_body[:, :2, 2] - [0.0, radius]
    np.testing.assert_allclose(np.linalg.norm(centre, axis=1), radius)


def test_annulus_keeps_its_distances():
    log = make("circle", landmarks=400, annulus_min_m=1.0, annulus_max_m=4.0, steps=2)
    radius = 1.0 / math.radians(6.0)
    gaps = np.linalg.norm(log.truth.positions - [0.0, radius], axis=1) - radius
    assert (np.abs(gaps) >= 1.0 - 1e-12).all()
    assert (np.abs(gaps) <= 4.0 + 1e-12).all()
    # 400 fair coins: 3.3 sigma is 33.
    assert abs(np.count_nonzero(gaps > 0) - 200) < 33


def chi2_bounds(dof: int, probability: float = 1e-4) -> tuple[float, float]:
    """Two-sided bounds that chi-squared with ``dof`` degrees of freedom keeps but for ``probability``."""
    return float(chdtri(dof, 1 - probability / 2)), float(chdtri(dof, probability / 2))


@pytest.mark.parametrize("odometry", ODOMETRY)
def test_odometry_noise_has_the_covariance_it_states(odometry):
    # Small noise keeps the covariance's first order exact enough; 4000 steps, bounds at 1e-4.
    log = make("random", odometry=odometry, steps=4001, landmarks=1, noise_scale=0.05)
    errors = odometry_errors(log)
    nees = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(log.Q[1:]), errors)
    low, high = chi2_bounds(3 * len(errors))
    assert low < nees.sum() < high
    whitened = np.linalg.solve(np.linalg.cholesky(log.Q[1:]), errors[..., None])[..., 0]
    for axis in range(3):
        low, high = chi2_bounds(len(errors))
        assert low < np.sum(whitened[:, axis] ** 2) < high
    # Means of 4000 unit normals stay within 4 / sqrt(4000); white in time likewise.
    bound = 4 / math.sqrt(len(errors))
    assert np.abs(whitened.mean(axis=0)).max() < bound
    assert np.abs((whitened[1:] * whitened[:-1]).mean(axis=0)).max() < bound
    assert abs((whitened[:, 0] * whitened[:, 1]).mean()) < bound


@pytest.mark.parametrize("odometry", ODOMETRY)
def test_parts_of_a_step_give_full_rank_and_the_covariance_they_state(odometry):
    log = make(
        "random",
        odometry=odometry,
        steps=3001,
        landmarks=1,
        noise_scale=0.01,
        lateral_sigma_m=0.0,
        process_substeps=3,
        resolution=0.0,
    )
    errors = odometry_errors(log)
    low, high = chi2_bounds(len(errors))
    whitened = np.linalg.solve(np.linalg.cholesky(log.Q[1:]), errors[..., None])[..., 0]
    for axis in range(3):
        assert low < np.sum(whitened[:, axis] ** 2) < high


def test_parts_of_a_step_keep_its_total_variance():
    """Straight ahead, speed and turn noise of the parts add up to those of one step."""
    whole, parts = (
        make("corridor", steps=3, speed_sigma_m_s=0.2, turn_sigma_deg_s=1.0, process_substeps=count)
        for count in (1, 4)
    )
    diagonals = np.diagonal(parts.Q[1], axis1=0, axis2=1), np.diagonal(whole.Q[1], axis1=0, axis2=1)
    np.testing.assert_allclose(diagonals[0][[0, 2]], diagonals[1][[0, 2]], rtol=1e-2)
    assert diagonals[0][1] > 1.5 * diagonals[1][1]


def test_a_map_seed_fixes_the_map_and_nothing_else():
    first, second = (make("random", seed=seed, map_seed=2026, steps=30) for seed in (1, 2))
    np.testing.assert_array_equal(first.truth.positions, second.truth.positions)
    assert not np.array_equal(first.T_prev_body, second.T_prev_body)
    free = make("random", seed=1, steps=30)
    np.testing.assert_array_equal(first.T_prev_body, free.T_prev_body)
    assert not np.array_equal(first.truth.positions, free.truth.positions)


def test_the_sensor_looks_from_the_first_look_on():
    late, always = make("circle", first_look=3, steps=10), make("circle", steps=10)
    assert [seen.ids.size for seen in late.detections[:3]] == [0, 0, 0]
    for seen, full in zip(late.detections[3:], always.detections[3:], strict=True):
        np.testing.assert_array_equal(seen.z, full.z)


def test_odometry_covariance_knows_only_what_was_measured():
    """Q belongs to the noisy controls, which the increment gives away where there is no side slip."""
    log = make("random", steps=50, lateral_sigma_m=0.0, speed_sigma_m_s=0.2, turn_sigma_deg_s=10.0)
    twist = g.log(log.T_prev_body[1:])
    np.testing.assert_allclose(twist[:, 1], 0.0, rtol=0, atol=2e-9)
    noise = np.diag([0.2, math.radians(10.0)]) ** 2
    G = Unicycle().jacobian(twist[:, [0, 2]], 1.0)
    expected = G @ noise @ np.swapaxes(G, 1, 2)
    np.testing.assert_allclose(log.Q[1:], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position"])
def test_sensor_noise_has_the_covariance_it_states(sensor):
    log = make("random", sensor=sensor, steps=1500, range_min_m=2.0)
    errors, sigmas = residuals(log)
    white = errors / sigmas
    for axis in range(2):
        low, high = chi2_bounds(len(white))
        assert low < np.sum(white[:, axis] ** 2) < high
    assert np.abs(white.mean(axis=0)).max() < 4 / math.sqrt(len(white))
    assert abs((white[:, 0] * white[:, 1]).mean()) < 4 / math.sqrt(len(white))


def test_the_prior_is_drawn_from_its_covariance():
    # 1500 seeds, three components each.
    total = 0.0
    for seed in range(1500):
        log = make(
            "circle", seed, steps=2, landmarks=1, prior_position_sigma_m=0.3, prior_heading_sigma_rad=0.1
        )
        error = g.local(log.problem.T_world_body, log.truth.T_world_body[0])
        total += error @ np.linalg.solve(log.problem.P, error)
    low, high = chi2_bounds(4500)
    assert low < total < high


@pytest.mark.parametrize("name", WORLDS)
def test_range_and_field_of_view_hold_and_nothing_visible_is_missed(name):
    log = make(name, range_min_m=1.5, range_max_m=6.0, field_of_view_deg=120.0, range_sigma_m=0.01)
    sensor = RangeBearing()
    for T, seen in zip(log.truth.T_world_body, log.detections, strict=True):
        r, b = sensor.predict(T, log.truth.positions).T
        visible = (r >= 1.5) & (r <= 6.0) & (np.abs(b) <= math.radians(60))
        np.testing.assert_array_equal(seen.ids, np.flatnonzero(visible))


def common(first: Log, second: Log):
    """Pairs of detections of the same landmark in the same frame."""
    for a, b in zip(first.detections, second.detections, strict=True):
        both, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
        if both.size:
            yield a.z[i], b.z[j]


def test_changing_one_source_of_noise_leaves_the_others_alone():
    base = make("figure_eight", steps=80)
    quiet = make("figure_eight", steps=80, turn_sigma_deg_s=0.1, speed_sigma_m_s=0.2)
    np.testing.assert_array_equal(base.truth.positions, quiet.truth.positions)
    for a, b in zip(base.detections, quiet.detections, strict=True):
        np.testing.assert_array_equal(a.z, b.z)

    louder = make("figure_eight", steps=80, range_sigma_m=0.2)
    np.testing.assert_array_equal(base.T_prev_body, louder.T_prev_body)
    truth = RangeBearing()
    for T, a, b in zip(base.truth.T_world_body, base.detections, louder.detections, strict=True):
        z = truth.predict(T, base.truth.positions[a.ids])
        np.testing.assert_allclose(b.z[:, 0] - z[:, 0], 2 * (a.z[:, 0] - z[:, 0]), rtol=0, atol=3e-9)
        np.testing.assert_array_equal(a.z[:, 1], b.z[:, 1])

    for change in ({"range_max_m": 12.0}, {"field_of_view_deg": 90.0}, {"range_min_m": 3.0}):
        other = make("figure_eight", steps=80, **change)
        pairs = list(common(base, other))
        assert sum(len(a) for a, _ in pairs) > 50
        for a, b in pairs:
            np.testing.assert_array_equal(a, b)

    spoilt = make("figure_eight", steps=80, outlier_fraction=0.2)
    np.testing.assert_array_equal(base.T_prev_body, spoilt.T_prev_body)
    for a, b, wild in zip(base.detections, spoilt.detections, spoilt.truth.outliers, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_array_equal(a.z[~wild], b.z[~wild])

    longer = make("figure_eight", steps=120)
    np.testing.assert_array_equal(longer.T_prev_body[:80], base.T_prev_body)
    for a, b in zip(base.detections, longer.detections[:80], strict=True):
        np.testing.assert_array_equal(a.z, b.z)


def test_noise_scale_multiplies_noise_and_prior_together():
    one = make("lawnmower", steps=60, resolution=0.0, noise_scale=1e-3)
    half = make("lawnmower", steps=60, resolution=0.0, noise_scale=0.5e-3)
    np.testing.assert_allclose(odometry_errors(one), 2 * odometry_errors(half), rtol=0, atol=2e-7)
    np.testing.assert_allclose(residuals(one)[0], 2 * residuals(half)[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.Q, 4 * half.Q, rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(one.problem.P, 4 * half.problem.P, rtol=1e-12)
    np.testing.assert_allclose(one.detections[3].R, 4 * half.detections[3].R, rtol=1e-12)


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_position"])
def test_outliers_are_uniform_in_view_and_recorded(sensor):
    log = make(
        "random",
        sensor=sensor,
        steps=2500,
        outlier_fraction=0.3,
        field_of_view_deg=180.0,
        range_min_m=1.0,
        range_max_m=9.0,
    )
    wild = np.concatenate(log.truth.outliers)
    z = np.concatenate([seen.z for seen in log.detections])[wild]
    count, total = len(z), len(wild)
    assert abs(count - 0.3 * total) < 4 * math.sqrt(0.3 * 0.7 * total)
    r, b = (z[:, 0], z[:, 1]) if sensor == "range_bearing" else RangeBearing().predict(np.eye(3), z).T
    assert r.min() >= 1.0 - 1e-8
    assert r.max() <= 9.0 + 1e-8
    assert np.abs(b).max() <= math.pi / 2 + 1e-8
    for value, low, high in ((r, 1.0, 9.0), (b, -math.pi / 2, math.pi / 2)):
        observed, _ = np.histogram(value, bins=10, range=(low, high))
        statistic = np.sum((observed - count / 10) ** 2) / (count / 10)
        assert statistic < chi2_bounds(9)[1]
    none = make("random", steps=20)
    assert not np.concatenate(none.truth.outliers).any()


def test_known_heading_makes_the_problem_linear():
    log = make(
        "random",
        sensor="relative_position",
        turn_sigma_deg_s=0.0,
        prior_heading_sigma_rad=0.0,
        lateral_sigma_m=0.05,
        steps=100,
    )
    assert not log.Q[:, 2, :].any()
    assert not log.Q[:, :, 2].any()
    assert log.problem.P[2, 2] == 0.0
    assert np.linalg.eigvalsh(log.Q[1:, :2, :2]).min() > 1e-5
    path = g.dead_reckoning(log.problem.T_world_body, log.T_prev_body)
    np.testing.assert_allclose(
        g.wrap(g.heading(path) - g.heading(log.truth.T_world_body)), 0.0, rtol=0, atol=100 * 1e-9
    )


def test_bearings_stay_in_the_half_open_interval():
    log = make("circle", bearing_sigma_deg=30.0)
    b = np.concatenate([seen.z for seen in log.detections])[:, 1]
    assert b.min() > -math.pi
    assert b.max() <= math.pi
    assert b.max() > 3.0


def test_ranges_stay_positive_under_coarse_noise():
    log = make("random", range_sigma_m=2.0, range_min_m=0.1)
    assert min(seen.z[:, 0].min(initial=1.0) for seen in log.detections) > 0


def test_logs_are_frozen():
    log = make("circle", steps=5)
    with pytest.raises(ValueError, match="read-only"):
        log.detections[0].z[...] = 0
    assert replace(log, name="other").name == "other"
