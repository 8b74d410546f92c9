"""Whether the motion that the images show is the odometry's: clocks that are apart, and the scale of depths.

The motion between neighbouring images is estimated without odometry, from matches of all their features: with
depths by P3P and RANSAC, translation included; with one camera by the essential matrix, rotation only. Its
series is correlated with the odometry's over delays. Scale is the slope of its displacements over the
odometry's, which needs no parallax: with depths that are ten times too large the camera seems to move ten
times as far.

==========  ===============================================================================
symbol      meaning
==========  ===============================================================================
a, b        components of the motion seen and of the odometry's, (n, c), without their trends
r_d         correlation of a and of b moved by d images, by component; 0 where it is negative
l(d)        -1/2 sum n_e log(1 - r_d²): log-likelihood gained by the odometry d images away
n_e         n (1 - f g) / (1 + f g), with lag-one correlations f of a and g of b (Bartlett 1946)
==========  ===============================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from slamcmp.frontend.vision.image_pair import Features, match_features
from slamcmp.frontend.vision.matching import match_descriptors
from slamcmp.geometry import inverse, log
from slamcmp.models.camera import Camera
from slamcmp.models.motion import compose_increments
from slamcmp.types import FloatArray

_IMAGES = 100
"""That are kept, from the first on; some 30 kB each."""
_STEPS_MIN = 30
_POINTS_MIN = 12
_REPROJECTION_PX = 2.0
_DELAY_MAX = 12
_BETTER, _THAN_OTHERS = 10.0, 5.0
"""Log-likelihood by which a delay must be better than none, and than all that are not its neighbours."""
_CLIP = 4.0
"""Robust deviations beyond which a component counts no more."""
_SPAN = 2
"""Steps whose displacements are added up for the scale."""
_SPANS_MIN = 12
_SCALE = 2.5
"""Told is a factor beyond it, of slope and of size, where the slope's interval excludes 1."""
_SIGMAS = 2.0
_WEAKER = 1.0
"""Deviations of the slope from nothing that are enough where no noise makes the camera's motion so large."""
_ABOVE_NOISE = 3.0
"""Times the deviation that the pixels leave a displacement: it is no noise of the images."""


@dataclass(frozen=True)
class Moved:
    """A displacement of the camera between two images."""

    seen: FloatArray
    """(3,)."""
    told: FloatArray
    """By the odometry, (3,)."""
    variance_seen: float
    """Of what was seen, by the pixels that it was found from; summed over the axes."""
    variance_told: float


@dataclass(frozen=True)
class _Step:
    """The second camera's pose in the first one's frame."""

    X: FloatArray
    """(4, 4); without depths its translation is a direction."""
    variance: float = 0.0
    """Of its translation, by the pixels; summed over the axes."""


@dataclass(frozen=True)
class _Image:
    features: Features
    depth_m: FloatArray | None
    increment: tuple[FloatArray, FloatArray]


class SeenMotion:
    """The first images of a recording, compared with the odometry when it is asked for.

    Args:
        camera: what the images were taken with.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._images: list[_Image] = []

    def look(
        self, features: Features, depth_m: FloatArray | None, increment: tuple[FloatArray, FloatArray]
    ) -> None:
        """Take in the next image: its features, their depths (m,) where known, the odometry to it (T, Q)."""
        if len(self._images) < _IMAGES:
            self._images.append(_Image(features, depth_m, increment))

    def findings(self, step_s: float, *, depths: bool = True) -> list[str]:
        """What does not fit, with the likely cause; of ``depths`` only if nothing was said of them yet.

        ``step_s`` is the usual time between two images.
        """
        if len(self._images) <= _STEPS_MIN:
            return []
        pairs = zip(self._images[:-1], self._images[1:], strict=True)
        steps = [_step(self._camera, *pair, seed) for seed, pair in enumerate(pairs)]
        return [*self._clock(steps, step_s), *(self._scale(steps) if depths else [])]

    def _clock(self, steps: list[_Step | None], step_s: float) -> list[str]:
        T_body_camera = self._camera.T_body_camera
        nothing = np.full(6, np.nan)
        seen = np.array(
            [
                nothing if step is None else log(T_body_camera @ step.X @ inverse(T_body_camera))
                for step in steps
            ]
        )
        odometry = np.array([log(image.increment[0]) for image in self._images[1:]])
        if self._images[0].depth_m is None:
            seen, odometry = seen[:, :3], odometry[:, :3]
        late = delay(seen, odometry)
        if late == 0:
            return []
        return [
            f"the motion that the images show fits the odometry best {abs(late)} frame(s) "
            f"({abs(late) * step_s:.3g} s) {'later' if late > 0 else 'earlier'}: are the clocks of camera "
            "and odometry apart?"
        ]

    def _scale(self, steps: list[_Step | None]) -> list[str]:
        if self._images[0].depth_m is None:
            return []
        T_body_camera = self._camera.T_body_camera
        moved: list[Moved] = []
        for begin in range(0, len(steps) - _SPAN + 1, _SPAN):
            span = [step for step in steps[begin : begin + _SPAN] if step is not None]
            if len(span) < _SPAN:
                continue
            X: FloatArray = reduce(np.matmul, [step.X for step in span])
            T, Q = reduce(
                compose_increments,
                [image.increment for image in self._images[begin + 1 : begin + 1 + _SPAN]],
            )
            by_odometry = (inverse(T_body_camera) @ T @ T_body_camera)[:3, 3]
            by_images = sum(step.variance for step in span)
            moved.append(Moved(X[:3, 3], by_odometry, by_images, float(np.trace(Q[3:, 3:]))))
        scale = scale_of(moved)
        if scale == 1.0:
            return []
        return [
            f"depths are {scale:.3g} times what the camera's motion and the odometry say: is a unit wrong, "
            "of the depth images, the baseline or the odometry?"
        ]


def delay(seen: FloatArray, odometry: FloatArray) -> int:
    """By how many images the motion seen (n, c), NaN where unknown, lags the odometry's (n, c).

    0 where that is not sure.
    """
    count = len(seen)
    furthest = min(_DELAY_MAX, count // 5)
    # The same images for each delay: their own changes then favour none.
    middle = np.arange(furthest, count - furthest)
    middle = middle[np.isfinite(seen[middle, 0])]
    if len(middle) < _STEPS_MIN // 2:
        return 0
    seen, odometry = _clipped(seen), _clipped(odometry)
    trend, _ = np.linalg.qr(np.column_stack([np.ones(len(middle)), middle - middle.mean()]))
    a = seen[middle] - trend @ (trend.T @ seen[middle])
    f, g = _lag_one(a), _lag_one(odometry - odometry.mean(axis=0))
    share = np.clip((1.0 - f * g) / (1.0 + f * g), 0.05, 1.0)
    gained = []
    for late in range(-furthest, furthest + 1):
        b = odometry[middle - late]
        b = b - trend @ (trend.T @ b)
        norm = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
        r = np.clip((a * b).sum(axis=0) / np.maximum(norm, 1e-30), 0.0, 1.0 - 1e-9)
        gained.append(-0.5 * len(middle) * float((share * np.log1p(-r * r)).sum()))
    best = int(np.argmax(gained))
    others = [each for i, each in enumerate(gained) if abs(i - best) > 1]
    sure = gained[best] - gained[furthest] > _BETTER and gained[best] - max(others) > _THAN_OTHERS
    return best - furthest if sure else 0


def scale_of(moved: list[Moved]) -> float:
    """How many times too far the camera seems to move; 1 where that is not sure."""
    if not moved:
        return 1.0
    scale, sigma = slope(moved)
    seen, told = (
        np.linalg.norm([getattr(each, side) for each in moved], axis=1) for side in ("seen", "told")
    )
    # Noise on either side makes a slope uncertain, noise of the images sizes too large: both must say it.
    size = float(np.median(seen) / max(np.median(told), 1e-9))
    blur = np.sqrt([each.variance_seen for each in moved])
    # Further than told and the odometry's noise together the camera has hardly ever been. The slope's own
    # deviation is that noise times the scale, so that the largest scales would be doubted most.
    reach = np.maximum(told + np.sqrt([each.variance_told for each in moved]), 1e-9)
    beyond = scale > _WEAKER * sigma and np.median(seen / reach) > _SCALE
    clear = np.median(seen) > _ABOVE_NOISE * np.median(blur)
    larger = min(scale, size) > _SCALE and clear and (scale - _SIGMAS * sigma > 1.0 or beyond)
    smaller = max(scale, size) < 1.0 / _SCALE and scale + _SIGMAS * sigma < 1.0
    return scale if larger or smaller else 1.0


def slope(moved: list[Moved]) -> tuple[float, float]:
    """Displacements seen over those of the odometry, and its deviation by the jackknife; 1 and 0 if unknown.

    The odometry's variance, which would make the slope too small, is taken off.
    """
    if len(moved) < _SPANS_MIN:
        return 1.0, 0.0
    products = np.array([each.seen @ each.told for each in moved])
    squares = np.array([each.told @ each.told - each.variance_told for each in moved])
    count = len(moved)
    # Where noise is three quarters of what the odometry tells, there is no distance to compare with.
    if squares.sum() <= 0.25 * sum(float(each.told @ each.told) for each in moved):
        return 1.0, 0.0
    without = (products.sum() - products) / (squares.sum() - squares)
    sigma = np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum())
    return float(products.sum() / squares.sum()), float(sigma)


def _step(camera: Camera, first: _Image, second: _Image, seed: int) -> _Step | None:
    """The motion between two images by themselves; None where they do not tell."""
    if first.depth_m is None:
        return _turn(camera, first.features, second.features, seed)
    matches = match_descriptors(first.features.descriptors, second.features.descriptors)
    here, there = matches.pairs.T
    depth = first.depth_m[here]
    known = np.isfinite(depth) & (depth > 0)
    here, there, depth = here[known], there[known], depth[known]
    if here.size < _POINTS_MIN:
        return None
    points = camera.rays(first.features.xy[here]) * depth[:, None]
    cv2.setRNGSeed(seed)
    found, turn, t, inliers = cv2.solvePnPRansac(
        points,
        np.ascontiguousarray(second.features.xy[there]),
        camera.K,
        None,
        iterationsCount=100,
        reprojectionError=_REPROJECTION_PX,
        flags=cv2.SOLVEPNP_P3P,
    )
    if not found or inliers is None or len(inliers) < max(_POINTS_MIN, 0.3 * here.size):
        return None
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(t)
    agree = inliers.ravel()
    projected, J = cv2.projectPoints(points[agree], turn, t, camera.K, None)
    off = second.features.xy[there[agree]] - projected.reshape(-1, 2)
    # Two numbers a point, less six of the pose.
    spread = float((off * off).sum() / (2 * len(off) - 6))
    variance = spread * float(np.trace(np.linalg.pinv(J[:, :6].T @ J[:, :6])[3:, 3:]))
    return _Step(inverse(X), variance)


def _turn(camera: Camera, first: Features, second: Features, seed: int) -> _Step | None:
    pair = match_features(first, second, seed=seed, K=camera.K)
    F, kept = pair.verification.F, pair.kept
    if F is None or kept.sum() < _POINTS_MIN:
        return None
    K = camera.K
    _, R, t, _ = cv2.recoverPose(K.T @ F @ K, pair.first[kept], pair.second[kept], K)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, np.ravel(t)
    return _Step(inverse(X))


def _clipped(values: FloatArray) -> FloatArray:
    middle = np.nanmedian(values, axis=0)
    reach = _CLIP * 1.4826 * np.nanmedian(np.abs(values - middle), axis=0)
    clipped: FloatArray = np.clip(values, middle - reach, middle + reach)
    return clipped


def _lag_one(values: FloatArray) -> FloatArray:
    """Correlation (c,) of each entry with the next."""
    lagged = (values[1:] * values[:-1]).sum(axis=0)
    correlation: FloatArray = lagged / np.maximum((values * values).sum(axis=0), 1e-30)
    return correlation
