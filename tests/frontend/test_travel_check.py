"""A camera that travels otherwise than the odometry says: the mounting, and the scale of the depths."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.datasets.images.kitti_odometry import kitti_odometry
from slamcmp.frontend.vision.checks.travel_check import TravelCheck
from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.image_pair import Features, extract_features
from slamcmp.geometry import exp, inverse
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera
from tests.recorded_data import recorded

FRAMES = 45
INTRINSICS = {"fx_px": 400.0, "fy_px": 400.0, "cx_px": 320.0, "cy_px": 240.0}
LOOKING_DOWN = exp(np.array([0.0, 0.3, 0.0, 0.4, 0.0, 0.8])) @ FORWARD_CAMERA
Q = np.diag([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2]) ** 2


def said_of(
    given: np.ndarray, true: np.ndarray = LOOKING_DOWN, *, depth: float = 1.0, step_m: float = 0.2
) -> list[str]:
    """What is said of a drive with a camera at ``true`` whose mounting is given as ``given``."""
    rng = np.random.default_rng(0)
    world = rng.uniform([0.0, -6.0, -3.0], [18.0, 6.0, 4.0], (1500, 3))
    looks = rng.integers(0, 256, (1500, 32), dtype=np.uint8)
    eye = MonoCamera(**INTRINSICS, T_body_camera=LOOKING_DOWN)
    check = TravelCheck(MonoCamera(**INTRINSICS, T_body_camera=given))
    T, increment = np.eye(4), np.eye(4)
    for _ in range(FRAMES):
        T = T @ increment
        points = eye.camera_point(T, world)
        pixels = eye.project(points)
        with np.errstate(invalid="ignore"):
            shown = np.flatnonzero((points[:, 2] > 1.0) & ((pixels > 0) & (pixels < [640, 480])).all(axis=1))[
                :250
            ]
        xy = pixels[shown] + 0.3 * rng.standard_normal((shown.size, 2))
        ones, nothing = np.ones(shown.size), Corners(np.empty((0, 2)), np.empty(0), 0, 0)
        features = Features(xy, ones, ones, looks[shown], nothing, {}, {})
        check.look(features, depth * points[shown, 2], (increment, Q))
        increment = exp(np.array([0.0, 0.0, 0.02 * rng.standard_normal(), step_m, 0.0, 0.0]))
    return check.findings()


def test_a_camera_that_travels_as_it_should_is_not_spoken_of() -> None:
    assert said_of(LOOKING_DOWN) == []
    # A step that the odometry's noise hides has no direction.
    assert said_of(inverse(LOOKING_DOWN), step_m=0.005) == []


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (inverse, "T_body_camera is inverted"),
        (lambda T: np.block([[T[:3, :3].T, T[:3, 3:]], [T[3:]]]), "T_body_camera is"),
        (lambda T: T @ inverse(FORWARD_CAMERA), "a camera whose x axis points forward"),
        (
            lambda T: T @ np.diag([-1.0, 1.0, -1.0, 1.0]),
            "looks the other way, or the odometry runs backwards",
        ),
    ],
)
def test_a_wrong_mounting_is_told_with_what_was_done_to_it(mistake, said: str) -> None:
    (told,) = said_of(mistake(LOOKING_DOWN))
    assert "beside where odometry and T_body_camera say" in told
    assert said in told
    assert "maps points of the camera (x right, y down, z forward) to the body" in told


@pytest.mark.parametrize("factor", [1000.0, 10.0, 0.1])
def test_depths_in_another_unit_than_the_odometry_are_told_with_their_factor(factor: float) -> None:
    (told,) = said_of(LOOKING_DOWN, depth=factor)
    number = float(told.split("depths are ")[1].split(" times")[0])
    assert abs(number / factor - 1.0) < 0.1
    assert "is a unit wrong, of the depth images, the baseline or the odometry?" in told


def test_on_recorded_images_only_a_wrong_mounting_is_spoken_of() -> None:
    log = kitti_odometry(0, folder=str(recorded("kitti06_first51")), steps=34)
    checks = {
        name: TravelCheck(MonoCamera(**{**log.problem.sensor.parameters(), "T_body_camera": mounting}))
        for name, mounting in (("right", FORWARD_CAMERA), ("inverted", inverse(FORWARD_CAMERA)))
    }
    for k in range(34):
        features = extract_features(log.images[k].image)
        for check in checks.values():
            check.look(features, None, (log.T_prev_body[k], log.Q[k]))
    assert checks["right"].findings() == []
    (told,) = checks["inverted"].findings()
    assert "90° beside" in told
    assert "T_body_camera is inverted" in told
