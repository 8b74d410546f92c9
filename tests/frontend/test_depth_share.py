"""Images of which few points have a usable depth are told, with what became of the others."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.frontend.vision.checks.depth_share import DepthShare

POINTS = 100


def said_of(depth_m: float, usable: int, *, images: int = 8, among: int = 0, repeated: int = 0) -> list[str]:
    """Of images with ``usable`` points and the others at one depth, among as many good ones."""
    share = DepthShare()
    for k in range(images + among):
        good = k >= images
        valid = np.arange(POINTS) < (60 if good else usable)
        depth = np.where(valid, 3.0, depth_m)
        share.look(depth, valid, 0.3, repeated=k < repeated)
    return share.findings()


@pytest.mark.parametrize(
    ("depth_m", "said"),
    [
        (np.nan, "98% have none: are both images of one instant and one calibration"),
        (0.003, "98% are nearer than depth_min_m: is a unit wrong"),
        (3000.0, "98% are too far away for the accuracy of the depth"),
    ],
)
def test_where_the_others_are_is_told(depth_m: float, said: str) -> None:
    (told,) = said_of(depth_m, 2)
    assert told.startswith("in 8 of 8 images 2% of the points have a usable depth; ")
    assert said in told
    (told,) = said_of(depth_m, 2, among=4)
    assert told.startswith("in 8 of 12 images 2% of the points have a usable depth (60% in the others); ")


def test_what_happens_now_and_then_is_not_told() -> None:
    assert said_of(np.nan, 30) == []
    assert said_of(np.nan, 2, images=4, among=50) == []
    assert said_of(np.nan, 60, repeated=1) == []


def test_a_frozen_depth_camera_is_told() -> None:
    (told,) = said_of(np.nan, 60, repeated=5)
    assert told.startswith("the same depth image came 6 times in a row")


def test_images_with_hardly_a_point_do_not_count() -> None:
    share = DepthShare()
    for _ in range(10):
        share.look(np.full(20, np.nan), np.zeros(20, dtype=bool), 0.3, repeated=False)
    assert share.findings() == []
