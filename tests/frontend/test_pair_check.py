"""Pairs that are not what their calibration says, made from good ones: each is told with its likely cause."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from slamcmp.datasets.images.euroc import euroc
from slamcmp.errors import DataError
from slamcmp.frontend.tracked_features import tracked_features
from slamcmp.geometry import so3_exp
from slamcmp.models.camera import StereoCamera
from slamcmp.types import CameraFrame, Log, MeasurementStream
from slamcmp.worlds.rendered import rendered
from tests.recorded_data import recorded

COUNT = 8
Change = Callable[[list[CameraFrame], int], CameraFrame]


@cache
def drive() -> tuple[Log, list[CameraFrame]]:
    log = rendered(0, camera="stereo", steps=COUNT, width_px=320, height_px=240)
    return log, list(log.images)


def followed(change: Change, log: Log | None = None) -> MeasurementStream:
    good, images = drive()
    changed = [change(images, k) for k in range(COUNT)]
    return tracked_features(replace(log or good, images=changed), 0, followed=60)


def with_right(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda images, k: CameraFrame(images[k].image, change(images[k].right))


def lower(image: np.ndarray, by_px: float) -> np.ndarray:
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, by_px]])
    return np.asarray(cv2.warpAffine(image, shift, (320, 240), borderMode=cv2.BORDER_REFLECT))


def turned(image: np.ndarray, by_deg: float) -> np.ndarray:
    turn = cv2.getRotationMatrix2D((159.5, 119.5), by_deg, 1.0)
    return np.asarray(cv2.warpAffine(image, turn, (320, 240), borderMode=cv2.BORDER_REFLECT))


def askew(image: np.ndarray, axis: int, by_deg: float) -> np.ndarray:
    """What the camera would show turned by so much about its x (tilt), y (aside) or z axis (roll)."""
    K = drive()[0].problem.sensor.K
    turn = np.zeros(3)
    turn[axis] = np.radians(by_deg)
    H = K @ so3_exp(turn) @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(image, H, (320, 240), borderMode=cv2.BORDER_REFLECT))


def good(images: list[CameraFrame], k: int) -> CameraFrame:
    return images[k]


def test_a_good_pair_is_not_spoken_of() -> None:
    assert followed(good).report.warnings == ()


def test_recorded_pairs_are_not_spoken_of() -> None:
    log = euroc(0, folder=str(recorded("euroc_v101_static")))
    assert tracked_features(log, 0, followed=60).report.warnings == ()


def test_swapped_images_are_an_error() -> None:
    with pytest.raises(DataError, match="left and right are swapped"):
        followed(lambda images, k: CameraFrame(images[k].right, images[k].image))


@pytest.mark.parametrize(
    ("by_px", "said"), [(1.0, "1.0 px lower"), (4.0, "4.0 px lower"), (-2.0, "2.0 px higher")]
)
def test_rows_that_do_not_agree_are_told(by_px: float, said: str) -> None:
    (told,) = followed(with_right(lambda image: lower(image, by_px))).report.warnings
    assert said in told
    assert "not rectified" in told


@pytest.mark.parametrize("by_deg", [1.5, -1.5])
@pytest.mark.parametrize(
    ("axis", "said"),
    [
        (0, r"px {} than the left one \(1.[456]° of tilt\)"),
        (1, r"the right camera is turned to the side by 1.[456]°"),
        (2, r"the right image is turned by 1.[456]°"),
    ],
)
def test_a_camera_that_is_askew_is_told_with_its_axis(axis: int, said: str, by_deg: float) -> None:
    warnings = followed(with_right(lambda image: askew(image, axis, by_deg))).report.warnings
    assert re.search(said.format("higher" if by_deg > 0 else "lower"), warnings[0])
    assert "not rectified" in warnings[0]


@pytest.mark.parametrize("by_deg", [1.5, -1.5])
def test_a_turned_camera_is_told(by_deg: float) -> None:
    (told,) = followed(with_right(lambda image: turned(image, by_deg))).report.warnings
    assert "turned by 1.5° against the left one: the pair is not rectified" in told


def test_a_right_image_that_is_one_frame_late_is_told() -> None:
    warnings = followed(
        lambda images, k: CameraFrame(images[k].image, images[max(k - 1, 0)].right)
    ).report.warnings
    assert any("one frame late?" in told for told in warnings)


def test_one_image_on_both_sides_is_no_pair() -> None:
    stream = followed(lambda images, k: CameraFrame(images[k].image, images[k].image.copy()))
    skipped, nothing = stream.report.warnings
    assert "8 of 8 frames were skipped, odometry only: right image: the same as the left one" in skipped
    assert "not one image could be used" in nothing


def test_a_right_camera_that_is_frozen_is_told() -> None:
    stream = followed(lambda images, k: CameraFrame(images[k].image, images[min(k, 3)].right))
    (told,) = stream.report.warnings
    assert "4 of 8 frames were skipped" in told
    assert "right image: the same as before, while the left one changed: the right camera is frozen" in told


def test_a_baseline_in_millimetres_is_told() -> None:
    log, _ = drive()
    parameters = dict(log.problem.sensor.parameters())
    parameters["baseline_m"] *= 1000.0
    wrong = replace(log, problem=replace(log.problem, sensor=StereoCamera(**parameters)))
    told = followed(good, wrong).report.warnings
    assert "the baseline of the pair is 120 m: is it in millimetres?" in told


def test_unequal_exposure_is_told_and_costs_nothing() -> None:
    sizes = [frame.ids.size for frame in followed(good).frames]
    darker = followed(with_right(lambda image: (0.7 * image).astype(np.uint8)))
    (told,) = darker.report.warnings
    assert "0.70 times the contrast" in told
    assert sum(frame.ids.size for frame in darker.frames) > 0.9 * sum(sizes)
    brighter = followed(with_right(lambda image: np.minimum(image.astype(int) + 25, 255).astype(np.uint8)))
    assert brighter.report.warnings == ()
    assert sum(frame.ids.size for frame in brighter.frames) > 0.8 * sum(sizes)


def test_a_camera_that_delivers_its_last_image_again_is_told_and_moves_nobody() -> None:
    stream = followed(lambda images, k: images[min(k, 4)])
    event = "the same image as before, while the odometry moved: the camera is frozen"
    assert stream.report.events[event] == 3
    assert stream.report.warnings == (f"rendered_room: 3 of 8 frames were skipped, odometry only: {event}",)
    assert [frame.ids.size for frame in stream.frames[5:]] == [0, 0, 0]
    # Standing still, the same picture is what a camera should deliver.
    log, images = drive()
    standing = replace(
        log,
        T_prev_body=np.tile(np.eye(4), (COUNT, 1, 1)),
        images=[images[0]] * COUNT,
        truth=None,
    )
    assert tracked_features(standing, 0, followed=60).report.warnings == ()


def test_skipped_frames_are_told_with_their_reason_and_number() -> None:
    def broken(images: list[CameraFrame], k: int) -> CameraFrame:
        return (
            CameraFrame(None, problem="right image: the image file is truncated")
            if k in (2, 5, 6)
            else images[k]
        )

    (told,) = followed(broken).report.warnings
    assert told == (
        "rendered_room: 3 of 8 frames were skipped, odometry only: right image: the image file is truncated"
    )
    nothing = followed(lambda images, k: CameraFrame(None, problem="the file is missing")).report.warnings
    assert "8 of 8 frames" in nothing[0]
    assert "not one image could be used" in nothing[1]


def test_a_pair_without_any_match_is_no_reason_to_stop() -> None:
    rng = np.random.default_rng(0)
    stream = followed(with_right(lambda image: rng.integers(0, 256, image.shape, dtype=np.uint8)))
    assert all(frame.ids.size < 10 for frame in stream.frames)
