"""The motion that images show against the odometry's: clocks that are apart, and depths of another scale."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from slamcmp.datasets.images.seven_scenes import seven_scenes
from slamcmp.datasets.images.tum_rgbd import tum_rgbd
from slamcmp.frontend.vision.checks.seen_motion import Moved, SeenMotion, delay, scale_of
from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.image_pair import Features, extract_features
from slamcmp.frontend.vision.tracking.measuring import Noise, measuring
from slamcmp.geometry import exp
from slamcmp.models.camera import FORWARD_CAMERA, Camera, MonoCamera, StereoCamera
from tests.recorded_data import recorded

FRAMES = 70
INTRINSICS = {"fx_px": 400.0, "fy_px": 400.0, "cx_px": 320.0, "cy_px": 240.0}
MOUNTING = exp(np.array([0.0, 0.2, 0.1, 0.3, 0.1, 0.5])) @ FORWARD_CAMERA
SIGMAS = np.array([2e-3, 2e-3, 2e-3, 5e-3, 5e-3, 5e-3])
Images = list[tuple[Features, np.ndarray, np.ndarray]]


@cache
def drive(step_m: float, turn_rad: float, seed: int = 0) -> Images:
    """Features of points, their depths, and the odometry to each image of a hand-held camera."""
    rng = np.random.default_rng(seed)
    world = rng.uniform([1.5, -4.0, -2.0], [8.0, 4.0, 3.0], (1500, 3))
    looks = rng.integers(0, 256, (1500, 32), dtype=np.uint8)
    eye = MonoCamera(**INTRINSICS, T_body_camera=MOUNTING)
    images: Images = []
    T, increment, swing = np.eye(4), np.eye(4), np.zeros(6)
    for _ in range(FRAMES):
        points = eye.camera_point(T, world)
        pixels = eye.project(points)
        with np.errstate(invalid="ignore"):
            inside = (points[:, 2] > 0.5) & ((pixels > 0) & (pixels < [640, 480])).all(axis=1)
        shown = np.flatnonzero(inside)[:200]
        ones, nothing = np.ones(shown.size), Corners(np.empty((0, 2)), np.empty(0), 0, 0)
        xy = pixels[shown] + 0.3 * rng.standard_normal((shown.size, 2))
        told = np.eye(4) if not images else increment @ exp(SIGMAS * rng.standard_normal(6))
        images.append((Features(xy, ones, ones, looks[shown], nothing, {}, {}), points[shown, 2], told))
        swing = 0.5 * swing + rng.standard_normal(6) * [*[turn_rad] * 3, *[step_m] * 3]
        increment = exp(swing - 0.02 * np.array([0, 0, 0, *T[:3, 3]]))
        T = T @ increment
    return images


def said_of(
    images: Images, camera: Camera, late: int = 0, scale: float = 1.0, depths: bool = True
) -> list[str]:
    """What is said if the images came ``late`` frames after the odometry, with depths times ``scale``."""
    check = SeenMotion(camera)
    odometry = [told for *_, told in images]
    for k, (features, depth, _) in enumerate(images):
        of = min(max(k + late, 0), len(images) - 1)
        check.look(features, scale * depth if depths else None, (odometry[of], np.diag(SIGMAS**2)))
    return check.findings(0.05)


STEREO = StereoCamera(**INTRINSICS, baseline_m=0.1, T_body_camera=MOUNTING)
MONO = MonoCamera(**INTRINSICS, T_body_camera=MOUNTING)


@pytest.mark.parametrize(("step_m", "turn_rad"), [(0.02, 0.0005), (0.002, 0.01), (0.03, 0.01), (0.0, 0.0)])
def test_motion_as_the_odometry_says_is_not_spoken_of(step_m: float, turn_rad: float) -> None:
    for seed in (0, 1):
        images = drive(step_m, turn_rad, seed)
        assert said_of(images, STEREO) == []
        assert said_of(images, MONO, depths=False) == []


@pytest.mark.parametrize("late", [1, 4, -6])
def test_clocks_apart_are_told_where_the_camera_only_travels(late: int) -> None:
    (told,) = said_of(drive(0.02, 0.0005), STEREO, late)
    side = "earlier" if late < 0 else "later"
    assert f"best {abs(late)} frame(s) ({abs(late) * 0.05:.3g} s) {side}" in told
    assert "are the clocks of camera and odometry apart?" in told


@pytest.mark.parametrize("late", [2, -3])
def test_clocks_apart_are_told_by_a_single_camera_that_turns_a_little(late: int) -> None:
    """Half a degree an image, 4 px, in every direction, and steps of 3 cm."""
    (told,) = said_of(drive(0.03, 0.01), MONO, late, depths=False)
    assert f"best {abs(late)} frame(s)" in told


@pytest.mark.parametrize("factor", [10.0, 0.1, 1000.0, 4.0])
def test_depths_of_another_scale_are_told_without_parallax(factor: float) -> None:
    (told,) = said_of(drive(0.015, 0.003), STEREO, scale=factor)
    assert float(told.split("depths are ")[1].split(" times")[0]) == pytest.approx(factor, rel=0.25)
    assert "is a unit wrong, of the depth images, the baseline or the odometry?" in told


def moved_along(
    rng: np.random.Generator, scale: float, *, told_sigma: float, seen_sigma: float, seen_stated: float
) -> list[Moved]:
    """Displacements of unit size, the odometry's noise as large as they are or smaller."""
    moved = []
    for _ in range(32):
        true = rng.normal(0, 1, 3)
        seen = scale * true + rng.normal(0, seen_sigma, 3)
        told = true + rng.normal(0, told_sigma, 3)
        moved.append(Moved(seen, told, 3 * seen_stated**2, 3 * told_sigma**2))
    return moved


def test_a_large_scale_is_told_through_the_odometry_s_noise_and_none_by_noise() -> None:
    """As on TUM fr1, where a slope of 8.8 had a deviation of 4: the noise of the odometry times the scale."""
    rng = np.random.default_rng(0)
    told = [
        scale_of(moved_along(rng, 10.0, told_sigma=1.0, seen_sigma=0.3, seen_stated=0.3)) for _ in range(100)
    ]
    assert sum(each > 2.5 for each in told) >= 97
    for scale, seen_sigma in ((1.0, 0.3), (1.0, 6.0), (0.0, 6.0), (1.6, 1.0)):
        wrong = sum(
            scale_of(moved_along(rng, scale, told_sigma=1.0, seen_sigma=seen_sigma, seen_stated=seen_sigma))
            != 1.0
            for _ in range(200)
        )
        assert wrong <= 2, (scale, seen_sigma)


@pytest.mark.parametrize("seed", [3])
def test_depths_ten_times_too_large_are_told_of_a_camera_that_mostly_turns(seed: int) -> None:
    log = tum_rgbd(seed, folder=str(recorded("tum_fr1_rpy_a")))
    sensor, measure = measuring(
        log.problem.sensor, Noise(0.5, 0.2, 0.002), features=300, levels=1, depth_min_m=0.3
    )
    assert isinstance(sensor, StereoCamera)
    as_recorded, too_large = SeenMotion(sensor), SeenMotion(sensor)
    for k in range(log.t.size):
        frame = log.images[k]
        assert frame.image is not None
        features = extract_features(frame.image, count=300)
        depth = sensor.depths(measure(frame, features).z)
        for check, factor in ((as_recorded, 1.0), (too_large, 10.0)):
            check.look(features, factor * depth, (log.T_prev_body[k], log.Q[k]))
    assert as_recorded.findings(0.1) == []
    assert any(
        "times what the camera's motion and the odometry say" in each for each in too_large.findings(0.1)
    )


def test_series_that_have_nothing_to_do_with_each_other_have_no_delay() -> None:
    """Noise of every smoothness, 450 pairs: 1 in 100 at most."""
    rng = np.random.default_rng(0)
    wrong = 0
    for trial in range(450):
        memory, count = (0.0, 0.6, 0.9)[trial % 3], (45, 100)[trial % 2]
        noise = rng.standard_normal((2, count + 40, 6))
        series = np.zeros_like(noise)
        for k in range(1, count + 40):
            series[:, k] = memory * series[:, k - 1] + noise[:, k]
        wrong += delay(series[0, 40:], series[1, 40:]) != 0
    assert wrong <= 4


def test_a_standing_robot_and_a_claim_that_nothing_moves_tell_no_delay() -> None:
    rng = np.random.default_rng(0)
    series = np.cumsum(rng.standard_normal((60, 6)), axis=0)
    assert delay(series, np.zeros((60, 6))) == 0
    # A ramp seen with another scale fits itself best moved by some images: no trend counts.
    ramp = np.linspace(0, 1, 60)[:, None] * np.ones(6)
    assert delay(1.2 * ramp + 1e-3 * rng.standard_normal((60, 6)), ramp) == 0


def test_a_hand_held_camera_in_a_kitchen() -> None:
    log = seven_scenes(0, folder=str(recorded("7scenes_redkitchen")), steps=60)
    sensor, measure = measuring(
        log.problem.sensor, Noise(0.5, 0.2, 0.002), features=300, levels=1, depth_min_m=0.3
    )
    assert isinstance(sensor, StereoCamera)
    images = []
    for k in range(60):
        frame = log.images[k]
        assert frame.image is not None
        features = extract_features(frame.image, count=300)
        images.append((features, sensor.depths(measure(frame, features).z), log.T_prev_body[k]))
    assert said_of(images, sensor) == []
    for late in (2, -5):
        (told,) = said_of(images, sensor, late)
        assert f"best {abs(late)} frame(s)" in told
    (told,) = said_of(images, sensor, scale=10.0)
    assert 7.0 < float(told.split("depths are ")[1].split(" times")[0]) < 13.0
