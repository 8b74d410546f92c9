"""Descriptor matching by hand and against OpenCV's matcher, and the whole pair on photographs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.geometry.degeneracy import Geometry
from slamcmp.frontend.vision.image_pair import Features, extract_features, match_features, precision_recall
from slamcmp.frontend.vision.matching import hamming_distances, match_candidates, match_descriptors
from tests.frontend.photographs import photograph
from tests.frontend.two_views import K, two_views


def _bits(*positions: int) -> np.ndarray:
    row = np.zeros(256, dtype=np.uint8)
    row[list(positions)] = 1
    return np.packbits(row)


def test_distances_count_the_bits_that_differ() -> None:
    first = np.stack([_bits(), _bits(0, 100), _bits(*range(256))])
    second = np.stack([_bits(0), _bits(255)])
    np.testing.assert_array_equal(hamming_distances(first, second), [[1, 1], [1, 3], [255, 255]])


def test_mutual_and_ratio_by_hand() -> None:
    first = np.stack([_bits(0), _bits(0, 1), _bits(*range(50, 60)), _bits(*range(100, 120))])
    second = np.stack(
        [
            _bits(0),  # the best of rows 0 and 1; its own best is row 0
            _bits(*range(50, 60), 70),  # row 2's best, at distance 1
            _bits(*range(100, 115)),  # row 3's best, at distance 5 …
            _bits(*range(100, 114)),  # … and its second best, at distance 6: ambiguous
        ]
    )
    matches = match_descriptors(first, second, ratio=0.8)
    np.testing.assert_array_equal(matches.pairs, [[0, 0], [2, 1]])
    np.testing.assert_array_equal(matches.distance, [0, 1])
    assert (matches.tried, matches.not_mutual, matches.ambiguous) == (4, 1, 1)
    without_ratio = match_descriptors(first, second, ratio=1.0)
    np.testing.assert_array_equal(without_ratio.pairs, [[0, 0], [2, 1], [3, 2]])
    one_way = match_descriptors(first, second, ratio=1.0, mutual=False)
    np.testing.assert_array_equal(one_way.pairs, [[0, 0], [1, 0], [2, 1], [3, 2]])


def test_only_allowed_pairs_match() -> None:
    first = np.stack([_bits(0), _bits(10)])
    second = np.stack([_bits(0), _bits(0, 1, 2)])
    allowed = np.array([[False, True], [False, False]])
    matches = match_descriptors(first, second, allowed=allowed)
    np.testing.assert_array_equal(matches.pairs, [[0, 1]])
    np.testing.assert_array_equal(matches.distance, [2])
    assert matches.tried == 1


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (0, 0)])
def test_no_descriptors_no_matches(shape: tuple[int, int]) -> None:
    first, second = (np.zeros((size, 32), dtype=np.uint8) for size in shape)
    matches = match_descriptors(first, second)
    assert matches.pairs.shape == (0, 2)
    assert matches.tried == 0


def test_matches_equal_those_of_opencvs_matcher() -> None:
    first, second = (extract_features(photograph(n)).descriptors for n in (1, 2))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    forward = {m.queryIdx: (m, n) for m, n in matcher.knnMatch(first, second, k=2)}
    backward = {m.queryIdx: m for m, _ in matcher.knnMatch(second, first, k=2)}
    expected = {
        (i, m.trainIdx)
        for i, (m, n) in forward.items()
        if m.distance < 0.8 * n.distance and backward[m.trainIdx].trainIdx == i
    }
    assert {tuple(pair) for pair in match_descriptors(first, second).pairs.tolist()} == expected


def test_counts_of_a_pair_add_up_and_the_seed_repeats_it() -> None:
    first, second = extract_features(photograph(1)), extract_features(photograph(2))
    pair = match_features(first, second, seed=4)
    counts = pair.counts
    assert counts["tried"] - counts["not_mutual"] - counts["ambiguous"] == counts["matches"]
    assert counts["matches"] - counts["rejected"] == counts["kept"] == pair.kept.sum()
    again = match_features(first, second, seed=4)
    np.testing.assert_array_equal(pair.kept, again.kept)
    np.testing.assert_array_equal(pair.verification.F, again.verification.F)


def test_every_choice_reaches_its_stage() -> None:
    """Points seen twice by a camera that turns, and three descriptors that are doubtful."""
    rng = np.random.default_rng(0)
    views = two_views(0, 80, translation=(0.0, 0.0, 0.0), noise_px=0.3)
    first = rng.integers(0, 256, (80, 32), dtype=np.uint8)
    second = first.copy()
    second[0] ^= np.uint8(1)
    # The first one's second best is 4 bits worse; the last two of the first image look like one.
    second[1] = second[0] ^ np.r_[np.full(4, 2, np.uint8), np.zeros(28, np.uint8)]
    first[79] = first[78] ^ np.r_[np.full(3, 4, np.uint8), np.zeros(29, np.uint8)]
    second[79] = rng.integers(0, 256, 32, dtype=np.uint8)
    one, two = (_features(xy, bits) for xy, bits in ((views.first, first), (views.second, second)))

    def numbers(**choices: object) -> tuple[int, int, int]:
        counts = match_features(one, two, seed=0, **choices).counts
        return counts["matches"], counts["ambiguous"], counts["not_mutual"]

    strict, loose = numbers(), numbers(ratio=1.0)
    assert strict[1] > loose[1] == 0
    assert strict[2] > numbers(mutual=False)[2] == 0
    geometries = [match_features(one, two, seed=0, K=each).verification.geometry for each in (K, None)]
    assert geometries == [Geometry.PURE_ROTATION, Geometry.PLANE_OR_ROTATION]
    kept = [match_features(one, two, seed=0, threshold_px=each).counts["kept"] for each in (0.2, 1.0)]
    assert kept[0] < 0.6 * kept[1]
    allowed = np.zeros((80, 80), dtype=bool)
    allowed[:10] = True
    assert match_features(one, two, seed=0, allowed=allowed).counts["tried"] == 10
    wrong = two_views(1, 80, wrong=0.3)
    one, two = _features(wrong.first, first), _features(wrong.second, first)
    by = {
        method: match_features(one, two, seed=0, method=method).counts["kept"]
        for method in ("magsac", "ransac", "least_squares")
    }
    assert by["least_squares"] < 0.5 * min(by["magsac"], by["ransac"])


def _features(xy: np.ndarray, descriptors: np.ndarray) -> Features:
    count = len(xy)
    corners = Corners(xy, np.ones(count), count, 0)
    return Features(xy, np.ones(count), np.zeros(count), descriptors, corners, {}, {})


def test_suppression_chooses_from_more_corners_than_it_keeps_and_spreads_them() -> None:
    image = photograph(1)
    spread = {}
    for suppression in ("cells", "brown", "none"):
        features = extract_features(image, count=200, suppression=suppression)
        assert len(features.xy) == 200
        spread[suppression] = cKDTree(features.xy).query(features.xy, 2)[0][:, 1].mean()
    assert spread["cells"] > 1.3 * spread["none"]
    assert spread["brown"] > 1.3 * spread["none"]
    strongest = extract_features(image, count=200, suppression="none")
    assert (np.diff(strongest.response) <= 0).all()
    assert strongest.response.min() >= np.sort(strongest.corners.response)[-200]
    whole = extract_features(image, count=200, subpixel=False)
    np.testing.assert_array_equal(whole.xy, np.rint(whole.xy))
    assert (strongest.xy != np.rint(strongest.xy)).any(axis=1).mean() > 0.9
    with pytest.raises(UsageError, match="cells, brown or none"):
        extract_features(image, suppression="all")  # type: ignore[arg-type]


def test_precision_and_recall_by_hand() -> None:
    kept = np.array([True, True, True, False, False])
    correct = np.array([True, True, False, True, True])
    assert precision_recall(kept, correct) == (2 / 3, 0.5)
    precision, recall = precision_recall(np.zeros(2, bool), np.zeros(2, bool))
    assert np.isnan(precision)
    assert np.isnan(recall)


@pytest.mark.parametrize("ratio", [0.8, 1.0])
@pytest.mark.parametrize("seed", range(6))
def test_candidates_match_as_the_table_of_all_pairs_with_a_mask_does(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    # Few different bits: equal distances are common.
    first = rng.integers(0, 4, (40, 32), dtype=np.uint8) * (np.arange(32) < 3).astype(np.uint8)
    second = np.concatenate([first[rng.permutation(40)[:25]], first[:20] ^ 1])
    allowed = rng.uniform(size=(40, 45)) < (0.0, 0.02, 0.1, 0.3, 0.8, 1.0)[seed]
    expected = match_descriptors(first, second, ratio=ratio, allowed=allowed)
    found = match_candidates(first, second, *np.nonzero(allowed), ratio=ratio)
    np.testing.assert_array_equal(found.pairs, expected.pairs)
    np.testing.assert_array_equal(found.distance, expected.distance)
    assert (found.tried, found.not_mutual, found.ambiguous) == (
        expected.tried,
        expected.not_mutual,
        expected.ambiguous,
    )
