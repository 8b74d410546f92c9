"""How right a front end's association was, against labels that it was not told.

The ids it gave are names of its own, so each is matched with at most one true landmark, one to one, so that
as many detections as can be agree (Ristani et al. 2016 match identities of tracked persons so). A landmark
that was started twice therefore counts as right once only, and two that were taken for one count for the one
that was seen more often.

* precision: right ones among the detections that were given an id and whose label is known (clutter that was
  given one is wrong);
* recall: right ones among all detections of labelled landmarks, those held back or left out included.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

from slamcmp.types import Association, BoolArray, FloatArray, GroundTruth, IntArray
from slamcmp.types.association import NO_LANDMARK, NOT_KNOWN

COUNTS = ("association_given", "association_right", "association_labelled")


def identities(association: Association) -> dict[int, int]:
    """Of the ids that were given the true landmark of each that has one; as many detections as can agree."""
    ids, labels = np.concatenate([*association.ids]), np.concatenate([*association.labels])
    both = (ids != NO_LANDMARK) & (labels >= 0)
    if not both.any():
        return {}
    names, row = np.unique(ids[both], return_inverse=True)
    true, column = np.unique(labels[both], return_inverse=True)
    agreeing = np.zeros((names.size, true.size), dtype=np.int64)
    np.add.at(agreeing, (row, column), 1)
    pairs = zip(*linear_sum_assignment(-agreeing), strict=True)
    return {int(names[i]): int(true[j]) for i, j in pairs if agreeing[i, j]}


def right(association: Association) -> tuple[BoolArray, ...]:
    """Which detections were given the id of their own landmark, one mask a frame."""
    landmark_of = identities(association)
    return tuple(
        np.array([landmark_of.get(name) == label for name, label in zip(*frame, strict=True)], dtype=bool)
        for frame in zip(map(np.ndarray.tolist, association.ids), association.labels, strict=True)
    )


def association_counts(association: Association) -> dict[str, FloatArray]:
    """Series over the frames, each (K,): what was given an id, rightly so, and what is of a known landmark.

    Detections whose label nobody knows do not count; all are NaN where no label is known at all.
    """
    known = [labels != NOT_KNOWN for labels in association.labels]
    if not any(mask.any() for mask in known):
        return {name: np.full(len(known), math.nan) for name in COUNTS}
    rows = [
        (float((mask & (ids != NO_LANDMARK)).sum()), float(good.sum()), float((labels >= 0).sum()))
        for mask, ids, good, labels in zip(
            known, association.ids, right(association), association.labels, strict=True
        )
    ]
    return dict(zip(COUNTS, np.array(rows).reshape(-1, 3).T, strict=True))


def association_scores(association: Association) -> dict[str, float]:
    """``association_precision`` and ``association_recall``; NaN where nothing is known or given."""
    given, good, labelled = (float(series.sum()) for series in association_counts(association).values())
    return {
        "association_precision": good / given if given > 0 else math.nan,
        "association_recall": good / labelled if labelled > 0 else math.nan,
    }


def association_totals(association: Association) -> dict[str, float]:
    """Sums for the front end's report; empty where no label is known."""
    counts = association_counts(association)
    names = ("given an id", "given the right id", "of labelled landmarks")
    totals = {name: float(series.sum()) for name, series in zip(names, counts.values(), strict=True)}
    return {} if any(math.isnan(total) for total in totals.values()) else totals


def in_own_names(truth: GroundTruth, association: Association) -> tuple[IntArray, FloatArray]:
    """The true landmarks under the ids they were given, (I,) and (I, n): what a map is compared with."""
    place = {int(name): row for row, name in enumerate(truth.ids)}
    found = [(name, place[label]) for name, label in identities(association).items() if label in place]
    ids = np.array([name for name, _ in found], dtype=np.int64)
    return ids, truth.positions[np.array([row for _, row in found], dtype=np.int64)]
