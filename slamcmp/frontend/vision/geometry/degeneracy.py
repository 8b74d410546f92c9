"""Verify matches by geometry, and name the cases in which the epipolar geometry is not determined.

A fundamental matrix comes out of every input, also where the data leave it open: a camera that only turns,
a scene that is one plane, points on one line, no motion at all. Each is found by fitting the simpler model
and asking whether it explains (almost) everything (Torr, Fitzgibbon and Zisserman 1999, "The problem of
degeneracy in structure and motion recovery"). The matches can still be verified, by the homography instead;
only F is withheld.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import cv2
import numpy as np

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.geometry import fundamental
from slamcmp.frontend.vision.geometry.significance import (
    TURNS,
    chance_at_point,
    chance_on_line,
    significant,
    turned_about_the_common_motion,
)
from slamcmp.types import BoolArray, FloatArray

Method = Literal["magsac", "ransac", "least_squares"]


class Geometry(StrEnum):
    """What two views allow one to say."""

    EPIPOLAR = "epipolar"
    """The normal case: F is determined."""
    PLANAR_SCENE = "planar_scene"
    """One plane explains the matches: F is open, the homography holds."""
    PURE_ROTATION = "pure_rotation"
    """A rotation explains the matches: no depth can be told."""
    PLANE_OR_ROTATION = "plane_or_rotation"
    """One of the last two; telling them apart needs the calibration."""
    NO_MOTION = "no_motion"
    """Nothing moved."""
    COLLINEAR = "collinear"
    """All points lie on one line of the image."""
    TOO_FEW = "too_few"
    """Fewer than eight distinct matches."""
    CHANCE = "chance"
    """As many agree as would of matches that have nothing to do with each other."""
    MIRRORED = "mirrored"
    """One image is the mirror image of the other, or of parts of it: no camera sees that."""
    NOT_FINITE = "not_finite"
    """Fewer than eight matches are left without those that are NaN or infinite."""


@dataclass(frozen=True)
class Verification:
    """Which matches fit the geometry of two views; F and H only where they are determined."""

    geometry: Geometry
    inliers: BoolArray
    """(m,); none for COLLINEAR, TOO_FEW, CHANCE, MIRRORED and NOT_FINITE."""
    F: FloatArray | None = None
    """(3, 3) with x2ᵀ F x1 = 0, only for EPIPOLAR."""
    H: FloatArray | None = None
    """(3, 3) with x2 ~ H x1, for the plane, the rotation and no motion."""
    not_finite: int = 0
    """Matches with a coordinate that is NaN or infinite."""
    iterations: int = 0


_HOMOGRAPHY_FACTOR = 2.0
"""On the threshold, for the distance in the second image: √2, since noise of both images adds up there, times
√(9.21 / 6.63), since it has two degrees of freedom where Sampson's has one, is 1.67; the rest keeps a
threshold that is tight for the noise from reading depth out of it."""
_HOMOGRAPHY_SAMPLE = 4
_OFF_MODEL_SHARE = 0.05
"""F is determined if more than this share of its inliers (and more than eight) contradict the homography:
an F fitted around a homography is free to pick up that many wrong matches."""
_EXCHANGES = (0.236, 0.382, 0.618)
"""By what share of all places partners are moved on, to make matches that have nothing to do with each other:
far, for neighbours in the list may be neighbours in the image."""
_SIGMAS, _CONFIDENCE = 2.0, 0.999
"""By how many deviations of a count inliers must be more than those of such partners; of their sampling."""
_MANY, _NEARLY_ALL = 60, 0.9
"""Matches, and their share: partners in a window wider than the tolerance, of which a line through its middle
takes three quarters at most, never agree like that."""
_TURNED_OVER = -0.5
"""Of the correlation below: a mirrored image's is -0.7 to -1, of pairs of a moving camera above 0."""


def verify_matches(
    first: FloatArray,
    second: FloatArray,
    *,
    seed: int,
    method: Method = "magsac",
    threshold_px: float = 1.0,
    confidence: float = 0.999,
    K: FloatArray | None = None,
) -> Verification:
    """Reject the matches that no static scene can explain.

    Args:
        first: pixels (m, 2) in the first image.
        second: pixels (m, 2) in the second image.
        seed: of the sampling.
        method: OpenCV's MAGSAC, the teaching RANSAC, or least squares on everything (which breaks).
        threshold_px: largest Sampson distance of an inlier; a homography's distance may be twice that.
        confidence: probability that sampling finds a sample without outliers.
        K: calibration matrix (3, 3), with which a rotation can be told from a plane.

    Raises:
        UsageError: the two arrays do not pair up.
    """
    if first.shape != second.shape or first.ndim != 2 or first.shape[1] != 2:
        raise UsageError(f"matches of shape {first.shape} and {second.shape}; (m, 2) twice is needed")
    nobody = np.zeros(len(first), dtype=bool)
    finite = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    spoilt = int((~finite).sum())
    one, two = first[finite], second[finite]

    def answer(geometry: Geometry, inliers: BoolArray, **model: FloatArray | int | None) -> Verification:
        mask = nobody.copy()
        mask[finite] = inliers
        return Verification(geometry, mask, not_finite=spoilt, **model)  # type: ignore[arg-type]

    none = np.zeros(len(one), dtype=bool)
    if _distinct(one, two) < fundamental.SAMPLE:
        return answer(Geometry.NOT_FINITE if spoilt and len(first) >= 8 else Geometry.TOO_FEW, none)
    if _is_collinear(one, threshold_px) or _is_collinear(two, threshold_px):
        return answer(Geometry.COLLINEAR, none)
    still = np.linalg.norm(two - one, axis=1) <= threshold_px
    if still.mean() >= 1.0 - _OFF_MODEL_SHARE:
        return answer(Geometry.NO_MOTION, still, H=np.eye(3))

    fit = _fit(one, two, seed, method, threshold_px, confidence)
    H, on_plane = _homography(one, two, seed, _HOMOGRAPHY_FACTOR * threshold_px, confidence)
    agree = int(fit.inliers.sum())
    off_plane = int((fit.inliers & ~on_plane).sum())
    if H is not None and off_plane <= max(fundamental.SAMPLE, _OFF_MODEL_SHARE * agree):
        if not _more_than_chance(one, two, on_plane, threshold_px, H=H):
            return answer(Geometry.CHANCE, none, iterations=fit.iterations)
        if _is_mirrored(one[on_plane], two[on_plane]):
            return answer(Geometry.MIRRORED, none, iterations=fit.iterations)
        geometry = _which_homography(one[on_plane], two[on_plane], K, _HOMOGRAPHY_FACTOR * threshold_px)
        return answer(geometry, on_plane, H=H, iterations=fit.iterations)
    if fit.F is None or not _more_than_chance(one, two, fit.inliers, threshold_px, F=fit.F):
        return answer(Geometry.CHANCE, none, iterations=fit.iterations)
    if _is_mirrored(one[fit.inliers], two[fit.inliers]):
        return answer(Geometry.MIRRORED, none, iterations=fit.iterations)
    return answer(Geometry.EPIPOLAR, fit.inliers, F=fit.F, iterations=fit.iterations)


def transfer_distance(H: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance (m,) [px] in the second image between H x1 and x2; infinite where H x1 is at infinity."""
    mapped = np.column_stack([first, np.ones(len(first))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - second, axis=1)
    return np.where(np.isfinite(distance), distance, np.inf)


def rotation_between(first: FloatArray, second: FloatArray, K: FloatArray) -> FloatArray:
    """The rotation R (3, 3) that best turns the rays of the first pixels into the second's (Kabsch 1976)."""
    rays_1, rays_2 = (_unit_rays(points, K) for points in (first, second))
    U, _, Vt = np.linalg.svd(rays_2.T @ rays_1)
    R: FloatArray = (U * [1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R


def _fit(
    first: FloatArray, second: FloatArray, seed: int, method: Method, threshold_px: float, confidence: float
) -> fundamental.EpipolarFit:
    if method == "magsac":
        return fundamental.magsac(first, second, seed, threshold_px=threshold_px, confidence=confidence)
    if method == "ransac":
        generator = np.random.default_rng(seed)
        return fundamental.ransac(first, second, generator, threshold_px=threshold_px, confidence=confidence)
    if method == "least_squares":
        return fundamental.least_squares(first, second, threshold_px=threshold_px)
    raise UsageError(f"verification method {method!r}; magsac, ransac or least_squares is needed")


def _homography(
    first: FloatArray, second: FloatArray, seed: int, threshold_px: float, confidence: float
) -> tuple[FloatArray | None, BoolArray]:
    parameters = fundamental.usac_parameters(seed, threshold_px, confidence, 1000)
    try:
        H, _ = cv2.findHomography(np.ascontiguousarray(first), np.ascontiguousarray(second), parameters)
    except cv2.error:
        H = None
    if H is None or np.shape(H) != (3, 3) or not np.isfinite(H).all():
        return None, np.zeros(len(first), dtype=bool)
    H = np.asarray(H, dtype=np.float64)
    return H, transfer_distance(H, first, second) <= threshold_px


def _more_than_chance(
    first: FloatArray,
    second: FloatArray,
    inliers: BoolArray,
    threshold_px: float,
    *,
    F: FloatArray | None = None,
    H: FloatArray | None = None,
) -> bool:
    """Whether as many inliers of F, or of H, are no chance.

    A random match obeys a model more often than areas say where the points themselves stand in rows, as those
    of a pattern that repeats do; exchanging the partners tells how often. And where partners were looked for
    near a predicted place only, as all trackers do, they lie near any line through that place: then partners
    as far from it in any direction tell how often.
    """
    others = np.concatenate([np.roll(second, round(share * len(second)), axis=0) for share in _EXCHANGES])
    of_first = np.tile(first, (len(_EXCHANGES), 1))
    radius = _HOMOGRAPHY_FACTOR * threshold_px
    if H is not None:
        sample, probability = _HOMOGRAPHY_SAMPLE, chance_at_point(first, second, radius)
        exchanged = transfer_distance(H, of_first, others) <= radius
    else:
        assert F is not None
        sample, probability = fundamental.SAMPLE, chance_on_line(first, second, threshold_px)
        exchanged = fundamental.sampson_distance(F, of_first, others) <= threshold_px
    probability = max(probability, float(exchanged.mean()))
    apart_px = max(5.0 * threshold_px, 5.0)
    by_areas = significant(first, second, inliers, sample=sample, probability=probability, apart_px=apart_px)
    if not by_areas or (len(first) >= _MANY and inliers.mean() >= _NEARLY_ALL):
        return by_areas
    near, turned = turned_about_the_common_motion(first, second, radius)
    return not near.any() or _more_than_in_a_window(
        first[near], turned, second[near], inliers[near], threshold_px, F=F, H=H, least=probability
    )


def _more_than_in_a_window(
    first: FloatArray,
    turned: FloatArray,
    second: FloatArray,
    inliers: BoolArray,
    threshold_px: float,
    *,
    F: FloatArray | None,
    H: FloatArray | None,
    least: float,
) -> bool:
    """Whether more of the matches (k, 2) and (k, 2) agree than do of partners ``turned``, (TURNS k, 2).

    ``least`` is the chance by areas. The bound that it goes into is generous where a chance is large; what
    the best model of such partners has is not, and is counted then.
    """
    count, radius = len(first), _HOMOGRAPHY_FACTOR * threshold_px
    sample = _HOMOGRAPHY_SAMPLE if F is None else fundamental.SAMPLE
    of_first = np.tile(first, (TURNS, 1))
    if F is not None:
        agree = fundamental.sampson_distance(F, of_first, turned) <= threshold_px
    else:
        assert H is not None
        agree = transfer_distance(H, of_first, turned) <= radius
    chance, apart_px = max(least, float(agree.mean())), max(5.0 * threshold_px, 5.0)
    if significant(first, second, inliers, sample=sample, probability=chance, apart_px=apart_px):
        return True
    for seed, partners in enumerate(turned.reshape(TURNS, count, 2)):
        if F is not None:
            agree = fundamental.magsac(first, partners, seed, threshold_px=threshold_px).inliers
        else:
            _, agree = _homography(first, partners, seed, radius, _CONFIDENCE)
        by_chance = int(agree.sum())
        if inliers.sum() <= by_chance + _SIGMAS * math.sqrt(by_chance * (count - by_chance) / count):
            return False
    return True


def _is_mirrored(first: FloatArray, second: FloatArray) -> bool:
    """Whether what stands clockwise in one image stands the other way round in the other.

    A row for a row or a column for a column is a perfectly good epipolar geometry, of points behind a camera.
    The sign is that of det C12 / sqrt(det C11 det C22), the product of the canonical correlations of the two
    images' points with their handedness: 1 for an affine map, -1 for one that turns the image over.
    """
    off = np.hstack([first, second])
    off -= off.mean(axis=0)
    both = off.T @ off
    scale = _determinant(both[:2, :2]) * _determinant(both[2:, 2:])
    return scale > 0 and _determinant(both[:2, 2:]) < _TURNED_OVER * math.sqrt(scale)


def _determinant(C: FloatArray) -> float:
    (a, b), (c, d) = C.tolist()
    return float(a * d - b * c)


def _which_homography(
    first: FloatArray, second: FloatArray, K: FloatArray | None, threshold_px: float
) -> Geometry:
    if K is None:
        return Geometry.PLANE_OR_ROTATION
    R = rotation_between(first, second, K)
    turned = transfer_distance(K @ R @ np.linalg.inv(K), first, second) <= threshold_px
    if turned.mean() >= 1.0 - _OFF_MODEL_SHARE:
        return Geometry.PURE_ROTATION
    return Geometry.PLANAR_SCENE


def _distinct(first: FloatArray, second: FloatArray) -> int:
    """How many different matches there are, at least."""
    columns = len(set(first[:, 0].tolist()))
    # Eight different columns settle it; comparing whole rows takes a tenth of the time of RANSAC.
    return columns if columns >= fundamental.SAMPLE else len(np.unique(np.hstack([first, second]), axis=0))


def _is_collinear(points: FloatArray, threshold_px: float) -> bool:
    """Whether all points lie within the threshold of one line, by their smaller principal deviation."""
    x, y = (points - points.mean(axis=0)).T
    (xx, xy, yy) = (float(a @ b) / len(points) for a, b in ((x, x), (x, y), (y, y)))
    # The smaller eigenvalue of the 2×2 covariance, as determinant over the larger: without cancellation.
    larger = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    return not larger > 0.0 or (xx * yy - xy * xy) / larger < (0.5 * threshold_px) ** 2


def _unit_rays(points: FloatArray, K: FloatArray) -> FloatArray:
    rays = np.linalg.solve(K, np.column_stack([points, np.ones(len(points))]).T).T
    unit: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit
