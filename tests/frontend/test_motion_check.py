"""A camera that turns before a wide picture: clocks that are apart and an inverted mounting are told."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.checks.motion_check import MotionCheck
from slamcmp.geometry import exp, inverse
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera

FRAMES = 40
FOCAL = 150.0


@cache
def panorama() -> np.ndarray:
    rough = np.random.default_rng(0).uniform(0, 255, (300, 900)).astype(np.float32)
    smooth = cv2.GaussianBlur(rough, (0, 0), 4.0)
    return np.clip((smooth - smooth.mean()) * 12 + 128, 0, 255).astype(np.uint8)


def turning(
    rates_rad: np.ndarray, mounting: np.ndarray | None = None, delay: int = 0, jitter_px: float = 0.5
) -> list[str]:
    """What is said of images that turn to the left by so much a frame, seen ``delay`` frames late."""
    camera = MonoCamera(fx_px=FOCAL, fy_px=FOCAL, cx_px=79.5, cy_px=59.5, T_body_camera=mounting)
    check = MotionCheck(camera)
    heading = np.cumsum(rates_rad)
    rng = np.random.default_rng(1)
    for k, rate in enumerate(rates_rad):
        seen = heading[min(max(k - delay, 0), len(heading) - 1)]
        # To the left: what was in the middle moves to the right.
        column = round(400 - FOCAL * seen + jitter_px * rng.standard_normal())
        image = panorama()[90:210, column : column + 160]
        check.look(np.ascontiguousarray(image), exp(np.array([0.0, 0.0, rate, 0.1, 0.0, 0.0])))
    return check.findings(0.1)


def wandering(seed: int = 2) -> np.ndarray:
    return 0.04 * np.random.default_rng(seed).standard_normal(FRAMES)


def test_a_camera_that_turns_as_the_wheels_say_is_not_spoken_of() -> None:
    assert turning(wandering()) == []


@pytest.mark.parametrize("delay", [3, -2])
def test_clocks_that_are_apart_are_told_with_their_distance(delay: int) -> None:
    (told,) = turning(wandering(), delay=delay)
    side = "later" if delay > 0 else "earlier"
    assert f"best {abs(delay)} frame(s) ({abs(delay) * 0.1:.3g} s) {side}" in told
    assert "are the clocks of camera and odometry apart?" in told


def test_an_inverted_mounting_is_told() -> None:
    (told,) = turning(wandering(), inverse(FORWARD_CAMERA))
    assert "but would if T_body_camera is inverted" in told


def test_a_mounting_for_other_axes_of_the_camera_is_told() -> None:
    (told,) = turning(wandering(), np.eye(4))
    assert "T_body_camera was given for a camera whose x axis points forward" in told


def test_where_nothing_can_be_told_nothing_is_said() -> None:
    # Turning steadily, a delay changes nothing; hardly turning, or for a few frames, neither does anything.
    assert turning(np.full(FRAMES, 0.02), delay=4) == []
    assert turning(0.001 * wandering(), delay=4) == []
    assert turning(wandering()[:10], delay=3) == []


def test_frames_without_image_do_not_count() -> None:
    check = MotionCheck(MonoCamera(fx_px=FOCAL, fy_px=FOCAL, cx_px=79.5, cy_px=59.5))
    for k in range(20):
        check.look(None if k % 2 else panorama()[:120, :160], np.eye(4))
    assert check.findings(0.1) == []
