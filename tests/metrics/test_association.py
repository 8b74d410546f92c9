"""Precision and recall of an association, counted by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamcmp.metrics.association import association_counts, association_scores, identities, in_own_names
from slamcmp.types import Association, GroundTruth


def decided(*frames: tuple[list[int], list[int]]) -> Association:
    ids, labels = zip(*frames, strict=True)
    points = tuple(np.zeros((len(each), 2)) for each in ids)
    return Association(tuple(map(np.array, ids)), tuple(map(np.array, labels)), points)


def test_counted_by_hand() -> None:
    """0 is 7, 1 is 8; one 8 taken for 0, one 7 left out, clutter believed once and refused once."""
    association = decided(
        ([0, 1], [7, 8]), ([0, -1], [7, 7]), ([0, 1], [8, 8]), ([1, -1], [-1, -1]), ([0], [7])
    )
    assert identities(association) == {0: 7, 1: 8}
    counts = association_counts(association)
    assert counts["association_given"].tolist() == [2, 1, 2, 1, 1]
    assert counts["association_right"].tolist() == [2, 1, 1, 0, 1]
    assert counts["association_labelled"].tolist() == [2, 2, 2, 0, 1]
    scores = association_scores(association)
    assert scores == {"association_precision": 5 / 7, "association_recall": 5 / 7}


def test_a_landmark_that_was_started_twice_is_right_once() -> None:
    association = decided(*[([0], [7])] * 3, *[([1], [7])] * 2)
    assert identities(association) == {0: 7}
    assert association_scores(association)["association_precision"] == 3 / 5


def test_two_landmarks_taken_for_one() -> None:
    association = decided(*[([0], [7])] * 4, *[([0], [8])])
    assert association_scores(association) == {"association_precision": 0.8, "association_recall": 0.8}


def test_the_best_matching_is_not_the_greedy_one() -> None:
    """0 agrees with 7 thrice and with 8 twice, 1 with 7 twice: 0 is 8 and 1 is 7, four right."""
    association = decided(*[([0], [7])] * 3, *[([0], [8])] * 2, *[([1], [7])] * 2)
    assert identities(association) == {0: 8, 1: 7}
    assert association_counts(association)["association_right"].sum() == 4


def test_what_nobody_knows_is_not_scored() -> None:
    mixed = decided(([0, 1], [7, -2]), ([0], [7]))
    assert association_scores(mixed) == {"association_precision": 1.0, "association_recall": 1.0}
    assert all(math.isnan(score) for score in association_scores(decided(([0], [-2]))).values())
    assert all(np.isnan(series).all() for series in association_counts(decided(([0], [-2]))).values())


def test_the_map_is_compared_under_the_names_that_were_given() -> None:
    truth = GroundTruth(
        np.zeros(1), np.eye(3)[None], np.array([7, 8, 9]), np.array([[1.0, 2], [3, 4], [5, 6]])
    )
    ids, positions = in_own_names(truth, decided(([5, 3], [8, 7])))
    assert dict(zip(ids.tolist(), positions.tolist(), strict=True)) == {5: [3.0, 4.0], 3: [1.0, 2.0]}


@pytest.mark.parametrize("empty", [decided(([], [])), decided(([], []), ([], []))])
def test_nothing_was_seen(empty: Association) -> None:
    assert all(math.isnan(score) for score in association_scores(empty).values())
