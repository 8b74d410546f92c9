"""Worlds that are asked for a number of landmarks in sight have it, whatever the lap or the range."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtri

from slamcmp import geometry as g
from slamcmp.errors import UsageError
from slamcmp.models.camera import StereoCamera
from slamcmp.types import Log
from slamcmp.worlds.planar import circle
from slamcmp.worlds.stereo_loop import stereo_loop


def seen(log: Log) -> float:
    return float(np.mean([detections.ids.size for detections in log.detections]))


@pytest.mark.parametrize("lap_s", [20, 80])
@pytest.mark.parametrize("in_view", [3.0, 10.0])
@pytest.mark.parametrize("view_deg", [360.0, 120.0])
def test_as_many_landmarks_are_in_sight_on_a_circle(lap_s: int, in_view: float, view_deg: float) -> None:
    """Of 20 maps a relative 12 %: a map of 9 landmarks, each seen a third of the time, varies by 15 %."""
    of_maps = [
        seen(circle(seed, steps=lap_s, turn_deg_s=360 / lap_s, in_view=in_view, range_max_m=5.0,
                    field_of_view_deg=view_deg))
        for seed in range(20)
    ]  # fmt: skip
    assert np.mean(of_maps) == pytest.approx(in_view, rel=0.12)


def test_a_ring_stands_outside_only() -> None:
    assert seen(circle(0, layout="ring", steps=60, in_view=4.0)) == pytest.approx(4.0, rel=0.06)


@pytest.mark.parametrize("lap_steps", [20, 80])
def test_as_many_points_are_in_sight_of_a_camera(lap_steps: int) -> None:
    of_maps = [seen(stereo_loop(seed, steps=lap_steps, lap_steps=lap_steps)) for seed in range(12)]
    assert np.mean(of_maps) == pytest.approx(12.0, rel=0.12)


def test_what_can_never_be_seen_is_refused() -> None:
    with pytest.raises(UsageError, match="no landmark would ever be in sight"):
        circle(0, in_view=3.0, annulus_min_m=4.0, annulus_max_m=5.0, range_max_m=1.0)
    with pytest.raises(UsageError, match="no landmark would ever be in sight"):
        stereo_loop(0, gap_min_m=30.0, gap_max_m=31.0)
    with pytest.raises(UsageError, match="depth_min_m is 5 and depth_max_m 4"):
        stereo_loop(0, depth_min_m=5.0, depth_max_m=4.0)


def test_poor_wheels_are_the_wheels_alone() -> None:
    """The same draws, the covariance 9 times as large, the detections as they were."""
    good, poor = circle(3, steps=50), circle(3, steps=50, odometry_scale=3.0)
    np.testing.assert_allclose(poor.Q[1:, 2, 2], 9.0 * good.Q[1:, 2, 2], rtol=1e-9)
    assert good.truth is not None
    true = g.inverse(good.truth.T_world_body[:-1]) @ good.truth.T_world_body[1:]
    off, more = (
        g.se2_coordinates(log.T_prev_body[1:])[:, 2] - g.se2_coordinates(true)[:, 2] for log in (good, poor)
    )
    np.testing.assert_allclose(g.wrap(more), 3.0 * g.wrap(off), atol=1e-8)
    for one, other in zip(good.detections, poor.detections, strict=True):
        np.testing.assert_array_equal(one.z, other.z)
    same = circle(3, steps=50, speed_sigma_m_s=0.09, turn_sigma_deg_s=1.5, lateral_sigma_m=0.015)
    np.testing.assert_allclose(same.T_prev_body, poor.T_prev_body, atol=2e-9)


def test_errors_of_wheels_and_pixels_are_what_the_log_says() -> None:
    """Whitened by the log's own covariances the errors are chi-square; bounds at 5e-5."""
    log = stereo_loop(1, steps=200, odometry_scale=2.0)
    assert log.truth is not None
    true = g.inverse(log.truth.T_world_body[:-1]) @ log.truth.T_world_body[1:]
    error = g.log(g.inverse(true) @ log.T_prev_body[1:])
    squared = np.einsum("ki,kij,kj->k", error, np.linalg.inv(log.Q[1:]), error)
    assert chdtri(squared.size * 6, 1 - 5e-5) < squared.sum() < chdtri(squared.size * 6, 5e-5)
    assert math.degrees(math.sqrt(log.Q[1, 0, 0])) == pytest.approx(0.6)
    total, count = 0.0, 0
    for T, frame in zip(log.truth.T_world_body, log.detections, strict=True):
        off = frame.z - log.problem.sensor.predict(T, log.truth.positions[frame.ids])
        total += np.einsum("mi,mij,mj->", off, np.linalg.inv(frame.R), off)
        count += off.size
    assert count > 3000
    assert chdtri(count, 1 - 5e-5) < total < chdtri(count, 5e-5)


def test_the_camera_sees_what_is_in_front_of_it_and_a_lap_ends_where_it_began() -> None:
    log = stereo_loop(2, steps=61, lap_steps=60)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth.T_world_body[60], np.eye(4), atol=1e-12)
    steps = np.linalg.norm(np.diff(log.truth.T_world_body[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], atol=1e-12)
    camera = log.problem.sensor
    assert isinstance(camera, StereoCamera)
    for T, frame in zip(log.truth.T_world_body, log.detections, strict=True):
        depth = camera.camera_point(T, log.truth.positions[frame.ids])[:, 2]
        assert ((depth >= 1.0) & (depth <= 12.0)).all()


def test_outliers_are_marked_and_are_anywhere_in_sight() -> None:
    """A fifth of some 2000 measurements; the bound is 5 standard deviations of a binomial count."""
    log = stereo_loop(4, steps=160, outlier_fraction=0.2)
    assert log.truth is not None
    assert log.truth.outliers is not None
    wild = np.concatenate(log.truth.outliers)
    assert abs(wild.sum() - 0.2 * wild.size) < 5 * math.sqrt(wild.size * 0.2 * 0.8)
    clean = stereo_loop(4, steps=160)
    z, z_clean = (np.concatenate([frame.z for frame in each.detections]) for each in (log, clean))
    np.testing.assert_array_equal(z[~wild], z_clean[~wild])
    assert np.median(np.linalg.norm((z - z_clean)[wild], axis=1)) > 100.0
    depth = 320.0 * 0.3 / (z - 0.0)[wild][:, :2].dot([1.0, -1.0])
    assert (depth > 0.8).all()
    assert (depth < 20.0).all()
