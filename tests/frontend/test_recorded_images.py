"""The front end on recorded images, judged by recorded motion."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

from slamcmp.frontend.vision.geometry.degeneracy import Geometry
from slamcmp.frontend.vision.geometry.fundamental import sampson_distance
from slamcmp.frontend.vision.image_pair import Features, extract_features, match_features
from slamcmp.geometry import hat, inverse
from slamcmp.image_files import read_image
from tests.recorded_data import recorded


def _features(pattern: str, data_set: str, count: int) -> list[Features]:
    files = sorted(recorded(data_set).glob(pattern))[:count]
    assert len(files) == count
    return [extract_features(read_image(file)) for file in files]


def test_a_standing_camera_is_recognised() -> None:
    features = _features("mav0/cam0/data/*.png", "euroc_v101_static", 6)
    for first, second in pairwise(features):
        pair = match_features(first, second, seed=0)
        assert pair.verification.geometry is Geometry.NO_MOTION
        assert pair.counts["kept"] > 400
        # The median corner moves by less than a tenth of a pixel: image noise and nothing else.
        assert np.median(np.linalg.norm(pair.second - pair.first, axis=1)) < 0.1


def test_matches_of_a_driving_camera_obey_the_recorded_motion() -> None:
    features = _features("image_l/*.png", "kitti06_first51", 12)
    folder = recorded("kitti06_first51")
    rows = np.loadtxt(next(folder.glob("poses*.txt")))[:12].reshape(-1, 3, 4)
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, :3] = rows
    K = np.array([[707.0912, 0.0, 601.8873], [0.0, 707.0912, 183.1104], [0.0, 0.0, 1.0]])
    K_inverse = np.linalg.inv(K)
    for k in range(11):
        pair = match_features(features[k], features[k + 1], seed=k, K=K)
        assert pair.verification.geometry is Geometry.EPIPOLAR
        T = inverse(poses[k + 1]) @ poses[k]
        F = K_inverse.T @ hat(T[:3, 3]) @ T[:3, :3] @ K_inverse
        distance = sampson_distance(F, pair.first, pair.second)
        assert pair.counts["kept"] > 100
        assert (distance[pair.kept] < 2.0).mean() >= 0.95
        # The recorded attitude is good to a few hundredths of a degree, and 0.08° is a pixel here.
        assert np.median(distance[pair.kept]) < 1.0


def test_recorded_images_of_different_places_have_nothing_in_common() -> None:
    patterns = {
        "kitti06_first51": "image_l/*.png",
        "7scenes_redkitchen": "frame-*.color.*",
        "tum_fr1_rpy_a": "rgb/*.png",
        "euroc_v101_static": "mav0/cam0/data/*.png",
    }
    first = [_features(pattern, name, 1)[0] for name, pattern in patterns.items()]
    for one, two in permutations(first, 2):
        pair = match_features(one, two, seed=0, ratio=0.9)
        assert pair.verification.geometry is Geometry.CHANCE
        assert pair.counts["kept"] == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_recorded_image_keeps_no_match(axis: int) -> None:
    """This kitchen has symmetrical cupboards: 18 and 31 matches obeyed an epipolar geometry of its rows."""
    image = read_image(sorted(recorded("7scenes_redkitchen").glob("frame-*.color.*"))[0])
    mirrored = extract_features(np.ascontiguousarray(np.flip(image, axis)))
    for ratio in (0.8, 0.9, 1.0):
        pair = match_features(extract_features(image), mirrored, seed=0, ratio=ratio)
        assert pair.verification.geometry in (Geometry.MIRRORED, Geometry.CHANCE)
        assert pair.counts["kept"] == 0
