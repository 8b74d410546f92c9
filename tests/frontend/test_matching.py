"""Descriptor matching by hand and against OpenCV's matcher, and the whole pair on photographs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamcmp.frontend.vision.image_pair import extract_features, match_features, precision_recall
from slamcmp.frontend.vision.matching import hamming_distances, match_descriptors
from tests.frontend.photographs import photograph


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


def test_precision_and_recall_by_hand() -> None:
    kept = np.array([True, True, True, False, False])
    correct = np.array([True, True, False, True, True])
    assert precision_recall(kept, correct) == (2 / 3, 0.5)
    precision, recall = precision_recall(np.zeros(2, bool), np.zeros(2, bool))
    assert np.isnan(precision)
    assert np.isnan(recall)
