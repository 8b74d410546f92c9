"""Corners at several scales against images that were made smaller and larger by a known factor."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pytest

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.image_pair import extract_features, match_features
from slamcmp.frontend.vision.matching import match_descriptors
from slamcmp.frontend.vision.pyramid import STEP, extract_pyramid
from slamcmp.worlds.rendered import rendered
from tests.frontend.photographs import photograph


@cache
def picture(name: str) -> np.ndarray:
    """A photograph, or the middle of a rendered room's drive."""
    return photograph(1) if name == "photograph" else rendered(0, camera="mono", steps=12).images[8].image


def resized(scale: float, name: str = "photograph") -> np.ndarray:
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture(name), None, fx=scale, fy=scale, interpolation=way))


@pytest.mark.parametrize("name", ["photograph", "rendered room"])
@pytest.mark.parametrize("scale", [0.5, 0.71, 1.19, 2.0])
def test_most_corners_that_can_be_found_again_are(scale: float, name: str) -> None:
    """Those that the other image has at the same place and in the same size, to half a level."""
    first, second = extract_pyramid(picture(name)), extract_pyramid(resized(scale, name))
    expected = (first.xy + 0.5) * scale - 0.5
    near = np.linalg.norm(expected[:, None] - second.xy[None], axis=2) < 3.0 * max(1.0, scale)
    ratio = first.factor[:, None] * scale / second.factor[None]
    there = (near & (np.abs(np.log(ratio)) < 0.5 * np.log(STEP))).any(axis=1)
    pairs = match_descriptors(first.descriptors, second.descriptors).pairs
    right = near[pairs[:, 0], pairs[:, 1]]
    assert there.sum() > 100
    assert right.mean() > 0.9
    found = np.zeros(len(first.xy), dtype=bool)
    found[pairs[right, 0]] = True
    assert found[there].mean() > 0.6


def test_one_scale_alone_does_not_find_the_half() -> None:
    single = [match_features(extract_features(photograph(1)), extract_features(resized(0.5)), seed=0)]
    several = match_features(
        extract_pyramid(photograph(1)), extract_pyramid(resized(0.5)), seed=0, threshold_px=2.0
    )
    assert single[0].counts["kept"] == 0
    assert several.counts["kept"] > 80


def test_one_level_is_the_image_alone() -> None:
    one, plain = extract_pyramid(photograph(1), levels=1), extract_features(photograph(1))
    np.testing.assert_array_equal(one.descriptors, plain.descriptors)
    np.testing.assert_allclose(one.xy, plain.xy, atol=1e-9)
    np.testing.assert_array_equal(one.factor, 1.0)


def test_levels_share_the_number_and_their_pixels_are_the_image_s_own() -> None:
    features = extract_pyramid(photograph(1), count=400)
    assert 380 <= len(features.xy) <= 400
    assert (np.diff(features.response) <= 0).all()
    numbers = [int(np.isclose(features.factor, STEP**level).sum()) for level in range(8)]
    assert all(a >= b > 0 for a, b in pairwise(numbers))
    height, width = photograph(1).shape
    assert (features.xy > 0).all()
    assert (features.xy < [width, height]).all()
    losses = ("at_border", "weak", "suppressed", "undescribed")
    assert features.counts["found"] - sum(features.counts[name] for name in losses) == len(features.xy)


def test_small_images_have_fewer_levels() -> None:
    small = extract_pyramid(resized(0.2))
    assert small.factor.max() < 2.0
    with pytest.raises(UsageError, match="0 levels"):
        extract_pyramid(photograph(1), levels=0)
