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
TURNS = 4
"""How many sets of partners are made of one."""
_ANGLES = 2.0 * math.pi * 0.381966 * np.arange(TURNS)
"""Golden angles: no direction is preferred, and neighbours in the list do not share one."""
_NEAR = 3.0
"""Times the median distance from the common motion: beyond it, a match tells nothing of it."""
_TABLE_MAX = 300
"""Points whose mutual distances are looked at all at once."""


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


def distinct(first: FloatArray, second: FloatArray, apart_px: float) -> int:
    """How many matches (m, 2) and (m, 2) are evidence of their own.

    Those of one feature in either image count once: a model whose epipole lies there explains them all.
    Corners less than ``apart_px`` from one another are one feature, for their patches are the same.
    """
    return min(_thinned(each, apart_px) for each in (first, second))


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
    apart_px: float,
) -> bool:
    """Whether the inliers (m,) among matches (m, 2) and (m, 2) are more than chance explains.

    See :func:`distinct`. Counted one by one only where a quarter of the matches leaves it open: those in
    every other row and every other column of cells, of which no two are one feature.
    """

    def passes(n: int, k: int) -> bool:
        return log10_false_alarms(n, k, sample, probability) <= math.log10(LIMIT)

    quarters = [_quarter(each, inliers, apart_px) for each in (first, second)]
    if passes(max(n for n, _ in quarters), min(k for _, k in quarters)):
        return True
    return passes(distinct(first, second, apart_px), distinct(first[inliers], second[inliers], apart_px))


def turned_about_the_common_motion(
    first: FloatArray, second: FloatArray, threshold_px: float
) -> tuple[BoolArray, FloatArray]:
    """Partners as far from an affine map of the first points as the second are, but in any direction.

    The mask (m,) tells the matches that are meant, of whose points the partners (TURNS k, 2) are: without
    those that the map leaves far behind, which are wrong wherever they were looked for. It is empty where
    the map explains half of them by itself, to ``threshold_px``.
    """
    # About the middle and of unit size, so that normal equations of three unknowns lose no digits.
    centre = first.mean(axis=0)
    rows = np.ones((len(first), 3))
    rows[:, :2] = (first - centre) / max(float(np.abs(first - centre).max()), 1e-9)
    near = np.ones(len(first), dtype=bool)
    for _ in range(3):
        kept = rows[near]
        A = np.linalg.solve(kept.T @ kept + 1e-9 * np.eye(3), kept.T @ second[near])
        off = second - rows @ A
        far = np.hypot(off[:, 0], off[:, 1])
        middle = float(np.partition(far, len(far) // 2)[len(far) // 2])
        near = far <= _NEAR * middle
    if middle <= threshold_px:
        return np.zeros(len(first), dtype=bool), np.empty((0, 2))
    angles = np.add.outer(_ANGLES, _ANGLES[1] * np.arange(int(near.sum())))
    around = np.exp(1j * angles) * (off[near, 0] + 1j * off[near, 1])
    return near, (rows[near] @ A + np.stack([around.real, around.imag], axis=-1)).reshape(-1, 2)


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _extent(points: FloatArray, least_px: float) -> tuple[float, float]:
    """Width and height of what the points cover, and not less than the tolerance itself."""
    width, height = np.maximum(points.max(axis=0) - points.min(axis=0), least_px).tolist()
    return width, height


def _quarter(points: FloatArray, inliers: BoolArray, cell_px: float) -> tuple[int, int]:
    """Of the cells in every other row and column: how many hold a point, and how many an inlier."""
    column, row = np.floor(points.T * (1.0 / cell_px)).astype(np.int64)
    counted = (column | row) & 1 == 0
    numbers = column * (1 << 32) + row
    return _different(numbers[counted]), _different(numbers[counted & inliers])


def _different(numbers: IntArray) -> int:
    ordered = np.sort(numbers)
    return int((ordered[1:] != ordered[:-1]).sum()) + (ordered.size > 0)


def _thinned(points: FloatArray, apart_px: float) -> int:
    """How many of the points (m, 2) stay if each that stays takes away all that are nearer."""
    alone = 0
    if len(points) <= _TABLE_MAX:
        off_x, off_y = (axis[:, None] - axis for axis in points.T)
        near = off_x * off_x + off_y * off_y < apart_px**2
        crowded = near.sum(axis=1) > 1
        alone, points = int((~crowded).sum()), points[crowded]
    while len(points):
        alone += 1
        off = points - points[0]
        points = points[(off * off).sum(axis=1) >= apart_px**2]
    return alone
