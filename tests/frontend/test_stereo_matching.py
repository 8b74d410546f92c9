"""Stereo matching on a pair that is drawn: what has no partner, what does not align, where the rest lies."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.image_pair import Features
from slamcmp.frontend.vision.tracking.stereo_matching import align_rows, match_rows

TRUE_PX = 20.3


@cache
def texture(seed: int) -> np.ndarray:
    rough = np.random.default_rng(seed).uniform(0, 255, (240, 400)).astype(np.float32)
    smooth = cv2.GaussianBlur(rough, (0, 0), 1.6)
    return np.asarray(np.clip((smooth - smooth.mean()) * 4 + 128, 0, 255), np.float32)


@cache
def pair() -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[0:240, 0:320].astype(np.float32)
    left, right = (
        np.rint(cv2.remap(texture(6), u + shift, v, cv2.INTER_LINEAR)).astype(np.uint8)
        for shift in (40.0, 40.0 + TRUE_PX)
    )
    return left, right


def features(xy: np.ndarray, descriptors: np.ndarray) -> Features:
    count = len(xy)
    corners = Corners(xy, np.ones(count), count, 0)
    return Features(xy, np.ones(count), np.zeros(count), descriptors, corners, {}, {})


@pytest.fixture
def two() -> tuple[Features, Features]:
    """Thirty corners; those of the right image have been found up to a pixel off."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.arange(70, 300, 40), np.arange(40, 220, 40)), axis=-1).reshape(-1, 2)
    left = grid + rng.uniform(-3, 3, grid.shape)
    right = left - [TRUE_PX, 0.0] + rng.uniform(-1.0, 1.0, grid.shape)
    descriptors = rng.integers(0, 256, (len(grid), 32), dtype=np.uint8)
    return features(left, descriptors), features(right, descriptors)


def test_the_disparity_is_that_of_the_patches_not_of_the_corners(two: tuple[Features, Features]) -> None:
    found = match_rows(*two, *pair(), disparity_max_px=60.0)
    assert (found.no_partner, found.not_aligned) == (0, 0)
    assert np.abs(found.disparity_px - TRUE_PX).max() < 0.1


def test_partners_lie_on_the_row_within_the_largest_disparity(two: tuple[Features, Features]) -> None:
    left, right = two
    lower = right.xy.copy()
    lower[:4, 1] = left.xy[:4, 1] + 2.0
    found = match_rows(left, replace(right, xy=lower), *pair(), disparity_max_px=60.0)
    assert found.no_partner == 4
    assert np.isnan(found.disparity_px[:4]).all()
    assert match_rows(left, right, *pair(), disparity_max_px=15.0).no_partner == len(left.xy)
    # A point behind infinity has no image: to the right of where the left camera sees it.
    one = features(left.xy[:1], left.descriptors[:1])
    for shift, missing in ((-1.0, 0), (3.0, 1)):
        found = match_rows(one, replace(one, xy=one.xy + np.array([shift, 0])), *pair(), disparity_max_px=60)
        assert found.no_partner == missing


def test_a_partner_that_has_a_rival_on_its_row_is_none(two: tuple[Features, Features]) -> None:
    left, right = two
    alike = features(
        np.concatenate([right.xy, right.xy[:1] + np.array([4.0, 0.0])]),
        np.concatenate([right.descriptors, right.descriptors[:1] ^ np.uint8(1)]),
    )
    found = match_rows(
        replace(left, descriptors=left.descriptors ^ np.uint8(2)), alike, *pair(), disparity_max_px=60
    )
    # 32 bits to the one, 64 to the other: clear. 32 and 32 + 8: not.
    assert found.no_partner == 0
    rival = alike.descriptors.copy()
    rival[-1] = right.descriptors[0]
    rival[-1, :8] ^= 1
    found = match_rows(
        replace(left, descriptors=left.descriptors ^ np.uint8(2)),
        replace(alike, descriptors=rival),
        *pair(),
        disparity_max_px=60,
    )
    assert found.no_partner == 1
    assert np.isnan(found.disparity_px[0])


def test_patches_that_differ_are_no_pair_though_their_descriptors_agree(
    two: tuple[Features, Features],
) -> None:
    left_image, right_image = pair()
    painted = right_image.copy()
    for u, v in np.rint(two[1].xy[:10]).astype(int):
        # Upside down and back to front: the same grey values and slopes.
        painted[v - 8 : v + 9, u - 12 : u + 13] = right_image[v - 8 : v + 9, u - 12 : u + 13][::-1, ::-1]
    found = match_rows(*two, left_image, painted, disparity_max_px=60.0)
    assert found.no_partner == 0
    assert found.not_aligned >= 9
    assert np.isnan(found.disparity_px[:10]).sum() >= 9
    assert np.isfinite(found.disparity_px[10:]).all()


def test_only_alike_patches_align() -> None:
    """Against another texture: a place where the difference is least there always is, but no likeness."""
    rng = np.random.default_rng(3)
    left_image, _ = pair()
    other = np.rint(texture(9)[:, :320]).astype(np.uint8)
    xy = rng.uniform([60, 20], [300, 220], (600, 2))
    found = align_rows(left_image, other, xy, np.full(600, TRUE_PX))
    # Eleven pixels of a texture with a grain of two: one in twenty passes by chance; without the likeness,
    # one in five does.
    assert np.isfinite(found).mean() < 0.07
    # A guess six pixels off leads out of what alignment may look at.
    assert np.isfinite(align_rows(*pair(), xy, np.full(600, TRUE_PX + 6.0))).mean() < 0.05


def test_an_offset_of_the_brightness_does_not_matter() -> None:
    left_image, right_image = pair()
    rng = np.random.default_rng(4)
    xy = rng.uniform([60, 20], [300, 220], (200, 2))
    brighter = np.minimum(right_image.astype(int) + 25, 255).astype(np.uint8)
    found = align_rows(left_image, brighter, xy, np.full(200, 20.0))
    assert np.isfinite(found).mean() > 0.95
    assert np.nanmedian(np.abs(found - TRUE_PX)) < 0.05
