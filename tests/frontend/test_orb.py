"""Angles against OpenCV's own, and descriptors that survive a rotation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.features.harris import harris_corners
from slamcmp.frontend.vision.features.orb import BORDER_PX, describe, intensity_centroid_angles
from slamcmp.frontend.vision.image_pair import extract_features
from slamcmp.frontend.vision.matching import match_descriptors
from tests.frontend.photographs import photograph


def test_angles_equal_those_of_opencvs_own_corners() -> None:
    image = photograph(1)
    keypoints = cv2.ORB.create(800, nlevels=1).detect(image, None)
    xy = np.array([keypoint.pt for keypoint in keypoints])
    theirs = np.array([keypoint.angle for keypoint in keypoints])
    difference = (intensity_centroid_angles(image, xy) - theirs + 180.0) % 360.0 - 180.0
    # OpenCV's arctangent is good to a few hundredths of a degree.
    assert len(theirs) == 800
    assert np.abs(difference).max() < 0.05


def test_the_angle_of_a_half_bright_disc_by_hand() -> None:
    image = np.zeros((61, 61), dtype=np.uint8)
    image[:, 31:] = 100
    image_down = np.ascontiguousarray(image.T)
    centre = np.array([[30.0, 30.0]])
    np.testing.assert_allclose(intensity_centroid_angles(image, centre), [0.0], atol=1e-9)
    np.testing.assert_allclose(intensity_centroid_angles(image_down, centre), [90.0], atol=1e-9)


def test_descriptors_equal_opencvs_at_its_own_corners() -> None:
    image = photograph(1)
    orb = cv2.ORB.create(500, nlevels=1)
    keypoints, theirs = orb.detectAndCompute(image, None)
    description = describe(image, np.array([keypoint.pt for keypoint in keypoints]))
    assert description.described.size == len(keypoints)
    # Only the few angles that sit on the edge of OpenCV's rounding may turn a bit.
    assert np.bitwise_count(description.descriptors ^ theirs).sum(axis=1).mean() < 1.0


def _rotated(image: np.ndarray, angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
    height, width = image.shape
    M = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle_deg, 1.0)
    return cv2.warpAffine(image, M, (width, height), borderMode=cv2.BORDER_REFLECT_101), M


@pytest.mark.parametrize("angle_deg", [10.0, 30.0, 90.0, 170.0])
def test_at_least_four_of_five_matches_are_right_after_a_rotation(angle_deg: float) -> None:
    image = photograph(1)
    turned, M = _rotated(image, angle_deg)
    first, second = extract_features(image), extract_features(turned)
    pairs = match_descriptors(first.descriptors, second.descriptors).pairs
    expected = first.xy[pairs[:, 0]] @ M[:, :2].T + M[:, 2]
    right = np.linalg.norm(second.xy[pairs[:, 1]] - expected, axis=1) < 3.0
    assert len(pairs) > 120
    assert right.mean() >= 0.8


def test_without_the_angle_a_rotation_defeats_the_descriptor() -> None:
    image = photograph(1)
    turned, M = _rotated(image, 30.0)
    described = []
    for picture in (image, turned):
        xy = np.rint(harris_corners(picture, border_px=BORDER_PX, count_max=500).xy)
        keypoints = [cv2.KeyPoint(x, y, 31.0) for x, y in xy.tolist()]
        _, descriptors = cv2.ORB.create(nlevels=1, edgeThreshold=BORDER_PX - 1).compute(picture, keypoints)
        assert len(descriptors) == len(xy)
        described.append((xy, descriptors))
    (xy_1, first), (xy_2, second) = described
    pairs = match_descriptors(first, second).pairs
    expected = xy_1[pairs[:, 0]] @ M[:, :2].T + M[:, 2]
    right = np.linalg.norm(xy_2[pairs[:, 1]] - expected, axis=1) < 3.0
    assert right.sum() < 0.1 * max(len(pairs), 1)


def test_corners_too_close_to_the_border_are_left_out_by_index() -> None:
    image = photograph(1)
    height, width = image.shape
    inside = [(100.0, 100.0), (BORDER_PX, BORDER_PX), (width - BORDER_PX - 1, 200.0)]
    outside = [(0.0, 0.0), (BORDER_PX - 1, 100.0), (200.0, height - BORDER_PX), (width - 1, height - 1)]
    xy = np.array([outside[0], inside[0], outside[1], inside[1], outside[2], inside[2], outside[3]])
    description = describe(image, xy)
    np.testing.assert_array_equal(description.described, [1, 3, 5])
    assert description.descriptors.shape == (3, 32)
    assert description.angle_deg.shape == (3,)


def test_counts_of_a_photograph_add_up() -> None:
    features = extract_features(photograph(1), count=500)
    counts = features.counts
    losses = ("at_border", "weak", "suppressed", "undescribed")
    assert counts["found"] - sum(counts[name] for name in losses) == counts["features"] == 500
    assert counts["at_border"] > 0
    assert counts["undescribed"] == 0


def test_an_image_without_corners_gives_no_features() -> None:
    features = extract_features(np.zeros((480, 640), dtype=np.uint8))
    assert features.descriptors.shape == (0, 32)
    assert features.counts["features"] == 0
