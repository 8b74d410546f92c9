"""The fundamental matrix: least squares, RANSAC spelt out for teaching, and OpenCV's MAGSAC for speed.

A static scene seen twice obeys x2ᵀ F x1 = 0 with homogeneous pixels x1, x2: each match must lie on its
epipolar line. Least squares on all matches (the eight-point algorithm) lets every wrong match bend F;
RANSAC draws minimal samples and keeps the F that most matches agree with, so that wrong ones do not vote.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from slamcmp.types import BoolArray, FloatArray

SAMPLE = 8
"""Matches that determine F in the linear algorithm."""


@dataclass(frozen=True)
class EpipolarFit:
    """A fundamental matrix and the matches that agree with it."""

    F: FloatArray | None
    """(3, 3) of Frobenius norm 1, or None where there is no answer."""
    inliers: BoolArray
    """(m,)."""
    iterations: int


def least_squares(first: FloatArray, second: FloatArray, *, threshold_px: float = 1.0) -> EpipolarFit:
    """F from all matches (m, 2) and (m, 2) at once; one gross outlier is enough to spoil it."""
    return _with_inliers(eight_point(first, second), first, second, threshold_px, 1)


def ransac(
    first: FloatArray,
    second: FloatArray,
    generator: np.random.Generator,
    *,
    threshold_px: float = 1.0,
    confidence: float = 0.999,
    iterations_max: int = 3000,
) -> EpipolarFit:
    """F by random sample consensus (Fischler and Bolles 1981; Hartley and Zisserman 2004, algorithm 4.6).

    The number of samples adapts: it is what finds one sample without outliers with the given confidence,
    if the share of inliers is the best seen so far. The winner is fitted again to all its inliers.

    Args:
        first: pixels (m, 2) in the first image.
        second: pixels (m, 2) in the second image.
        generator: draws the samples.
        threshold_px: largest Sampson distance of an inlier.
        confidence: probability that at least one sample is free of outliers.
        iterations_max: upper limit of the number of samples.
    """
    count = len(first)
    if count < SAMPLE:
        return EpipolarFit(None, np.zeros(count, dtype=bool), 0)
    best_F: FloatArray | None = None
    best = np.zeros(count, dtype=bool)
    needed, done = float(iterations_max), 0
    while done < min(needed, iterations_max):
        done += 1
        sample = generator.choice(count, SAMPLE, replace=False, shuffle=False)
        F = eight_point(first[sample], second[sample])
        if F is None:
            continue
        agrees = sampson_distance(F, first, second) <= threshold_px
        if agrees.sum() > best.sum():
            best_F, best = F, agrees
            needed = samples_needed(best.mean(), confidence)
    if best_F is None:
        return EpipolarFit(None, best, done)
    fit = _with_inliers(best_F, first, second, threshold_px, done)
    for _ in range(5):
        again = _with_inliers(
            eight_point(first[fit.inliers], second[fit.inliers]), first, second, threshold_px, done
        )
        if again.F is None or again.inliers.sum() < fit.inliers.sum():
            break
        settled = np.array_equal(again.inliers, fit.inliers)
        fit = again
        if settled:
            break
    return fit


def magsac(
    first: FloatArray,
    second: FloatArray,
    seed: int,
    *,
    threshold_px: float = 1.0,
    confidence: float = 0.999,
    iterations_max: int = 3000,
) -> EpipolarFit:
    """F by OpenCV's USAC with the MAGSAC score (Barath et al. 2020); parameters as for :func:`ransac`.

    ``cv2.setRNGSeed`` does not reach this estimator; the seed goes in with its parameters.
    """
    count = len(first)
    if count < SAMPLE:
        return EpipolarFit(None, np.zeros(count, dtype=bool), 0)
    parameters = usac_parameters(seed, threshold_px, confidence, iterations_max)
    try:
        F, _ = cv2.findFundamentalMat(np.ascontiguousarray(first), np.ascontiguousarray(second), parameters)
    except cv2.error:
        F = None
    # Seven-point samples can come back as three stacked solutions: that is no answer.
    if F is None or np.shape(F) != (3, 3):
        return EpipolarFit(None, np.zeros(count, dtype=bool), iterations_max)
    F = np.asarray(F, dtype=np.float64)
    norm = np.linalg.norm(F)
    usable = F / norm if np.isfinite(norm) and norm > 0 else None
    return _with_inliers(usable, first, second, threshold_px, iterations_max)


def eight_point(first: FloatArray, second: FloatArray) -> FloatArray | None:
    """The normalised eight-point algorithm (Hartley 1997) for m >= 8 matches; None if it has no answer."""
    if len(first) < SAMPLE:
        return None
    one, T1 = _normalised(first)
    two, T2 = _normalised(second)
    A = np.column_stack(
        [
            two[:, 0] * one[:, 0],
            two[:, 0] * one[:, 1],
            two[:, 0],
            two[:, 1] * one[:, 0],
            two[:, 1] * one[:, 1],
            two[:, 1],
            one[:, 0],
            one[:, 1],
            np.ones(len(one)),
        ]
    )
    if not np.isfinite(A).all():
        return None
    # The null vector from the 9×9 normal matrix: the points are normalised, so squaring costs no accuracy
    # that matters, and time no longer grows with the number of matches.
    _, vectors = np.linalg.eigh(A.T @ A)
    U, S, Vt = np.linalg.svd(vectors[:, 0].reshape(3, 3))
    # All epipolar lines meet in one point: a fundamental matrix has rank 2.
    F = T2.T @ (U * [S[0], S[1], 0.0]) @ Vt @ T1
    norm = np.linalg.norm(F)
    return F / norm if norm > 0 and np.isfinite(norm) else None


def sampson_distance(F: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """First-order distance (m,) [px] of matches from obeying F (Hartley and Zisserman 2004, eq. 11.9).

    With noise of σ px on every coordinate it is normally distributed with standard deviation σ.
    """
    one = np.column_stack([first, np.ones(len(first))])
    two = np.column_stack([second, np.ones(len(second))])
    lines_2, lines_1 = one @ F.T, two @ F
    algebraic = np.abs((two * lines_2).sum(axis=1))
    slope = np.hypot(np.hypot(lines_2[:, 0], lines_2[:, 1]), np.hypot(lines_1[:, 0], lines_1[:, 1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: FloatArray = np.where(slope > 0, algebraic / slope, np.inf)
    return distance


def samples_needed(inlier_share: float, confidence: float, sample: int = SAMPLE) -> float:
    """log(1 − confidence) / log(1 − share^sample) (Hartley and Zisserman 2004, eq. 4.18)."""
    clean = inlier_share**sample
    if clean <= 0.0:
        return math.inf
    if clean >= 1.0:
        return 1.0
    return math.ceil(math.log1p(-confidence) / math.log1p(-clean))


def usac_parameters(seed: int, threshold_px: float, confidence: float, iterations_max: int) -> cv2.UsacParams:
    """OpenCV's settings for MAGSAC, seeded."""
    parameters = cv2.UsacParams()
    parameters.randomGeneratorState = int(seed) & 0x7FFFFFFF
    parameters.threshold = threshold_px
    parameters.confidence = confidence
    parameters.maxIterations = iterations_max
    parameters.isParallel = False
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.sampler = cv2.SAMPLING_UNIFORM
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.final_polisher = cv2.MAGSAC
    return parameters


def _with_inliers(
    F: FloatArray | None, first: FloatArray, second: FloatArray, threshold_px: float, iterations: int
) -> EpipolarFit:
    if F is None:
        return EpipolarFit(None, np.zeros(len(first), dtype=bool), iterations)
    return EpipolarFit(F, sampson_distance(F, first, second) <= threshold_px, iterations)


def _normalised(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points moved to centroid 0 and mean distance √2, and the (3, 3) matrix that did it."""
    centre = points.mean(axis=0)
    spread = np.hypot(*(points - centre).T).mean()
    scale = math.sqrt(2.0) / spread if spread > 0 else 1.0
    T = np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])
    return (points - centre) * scale, T
