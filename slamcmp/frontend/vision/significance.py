"""Whether so many matches can agree on a geometry by chance.

A model that was fitted to the best of many samples always has some inliers: of 120 random matches about
eleven obey the best fundamental matrix. Counted instead is the number of false alarms (Moisan and Stival
2004, "A probabilistic criterion to detect rigid point matches"): how many sets of k inliers with a model of s
of them one expects among n matches that have nothing to do with each other,

    NFA = (n - s) C(n, k) C(k, s) p^(k - s),

where p is the probability that one such match obeys a given model. By Markov's inequality an NFA below a
limit has at most that limit's probability, whatever way the model was found.
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.types import BoolArray, FloatArray, IntArray

LIMIT = 1e-2
"""Largest number of false alarms that is no chance: one pair in a hundred, at most."""


def log10_false_alarms(matches: int, inliers: int, sample: int, probability: float) -> float:
    """Logarithm of the number of false alarms; 0 or more where nothing but chance can be said.

    Args:
        matches: n, of distinct ones.
        inliers: k, of distinct ones.
        sample: s, matches that determine a model.
        probability: p.
    """
    if inliers <= sample or matches <= sample or probability >= 1.0:
        return 0.0
    log = math.log(matches - sample) + _log_choose(matches, inliers) + _log_choose(inliers, sample)
    return (log + (inliers - sample) * math.log(probability)) / math.log(10.0)


def distinct(first: FloatArray, second: FloatArray, threshold_px: float) -> int:
    """How many matches (m, 2) and (m, 2) are evidence of their own.

    Those of one feature in either image count once: a model whose epipole lies there explains them all.
    """
    return min(_different(_places(each, threshold_px)) for each in (first, second))


def chance_on_line(first: FloatArray, second: FloatArray, threshold_px: float) -> float:
    """Probability that a random match is within ``threshold_px`` of its epipolar line, by Sampson's distance.

    A band about the longest line that the matched part of either image holds, over the area of that part.
    Sampson's distance shares the error among both images, so that the band is √2 times as wide.
    """
    chances = []
    for points in (first, second):
        width, height = _extent(points, 2.0 * threshold_px)
        chances.append(2.0 * math.sqrt(2.0) * threshold_px * math.hypot(width, height) / (width * height))
    return float(min(1.0, max(chances)))


def chance_at_point(first: FloatArray, second: FloatArray, radius_px: float) -> float:
    """Probability that a random match is within ``radius_px`` of where a homography takes it."""
    areas = [math.prod(_extent(points, 2.0 * radius_px)) for points in (first, second)]
    return float(min(1.0, math.pi * radius_px**2 / min(areas)))


def significant(
    first: FloatArray,
    second: FloatArray,
    inliers: BoolArray,
    *,
    sample: int,
    probability: float,
    cell_px: float,
) -> bool:
    """Whether the inliers (m,) among matches (m, 2) and (m, 2) are more than chance explains."""
    places = _places(first, cell_px), _places(second, cell_px)
    n, k = (min(_different(each[rows]) for each in places) for rows in (slice(None), inliers))
    return log10_false_alarms(n, k, sample, probability) <= math.log10(LIMIT)


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _extent(points: FloatArray, least_px: float) -> tuple[float, float]:
    """Width and height of what the points cover, and not less than the tolerance itself."""
    width, height = np.maximum(points.max(axis=0) - points.min(axis=0), least_px).tolist()
    return width, height


def _places(points: FloatArray, cell_px: float) -> IntArray:
    """Numbers (m,) of the image's cells that the points lie in."""
    column, row = np.floor(points * (1.0 / cell_px)).astype(np.int64).T
    numbers: IntArray = column * (1 << 32) + row
    return numbers


def _different(numbers: IntArray) -> int:
    ordered = np.sort(numbers)
    return int((ordered[1:] != ordered[:-1]).sum()) + (ordered.size > 0)
