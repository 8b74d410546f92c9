"""Whether the camera travels as the odometry says: its mounting, and the scale of its depths.

Matches of two images some frames apart, made without odometry, tell the direction in which the camera
travelled (the essential matrix: Hartley and Zisserman 2004, section 9.6). The mounting tells which direction
it should have. With the length of the odometry's step the matches also tell how far away the points are,
which a pair or a depth image says by itself.

==========  ===========================================================================
symbol      meaning
==========  ===========================================================================
R, t        from the first camera frame to the second by the images, t of length 1
X           the same by the odometry through the mounting, (4, 4), in metres
==========  ===========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from slamcmp.frontend.vision.checks.mounting_mistakes import WHAT_IT_MAPS, mounting_mistakes
from slamcmp.frontend.vision.geometry.degeneracy import Geometry
from slamcmp.frontend.vision.image_pair import Features, match_features
from slamcmp.geometry import inverse
from slamcmp.models.camera import Camera
from slamcmp.models.motion import compose_increments
from slamcmp.types import FloatArray

_EVERY, _APART = 6, 3
"""One image in so many is compared with that so many later."""
_ENOUGH = 12
"""Pairs that are looked at; the check then costs nothing any more."""
_PAIRS_MIN = 4
_MATCHES_MIN = 30
_PARALLAX_PX = 4.0
"""In the median, beside what the rotation does: with less the direction is anyone's."""
_SIGMAS = 5.0
"""Of the odometry: a shorter step has no direction of its own."""
_ASTRAY, _FITS = 0.5, 0.9
"""Cosines between where the camera went and where it should have."""
_SCALE = 2.5


@dataclass(frozen=True)
class _Step:
    t: FloatArray
    """Direction by the images, (3,)."""
    T: FloatArray
    """The odometry's increment of the body, (4, 4)."""
    scale: float
    """Median of measured depths over those by parallax and odometry; NaN where it is not known."""


class TravelCheck:
    """Steps of the camera, as images and odometry tell them.

    Args:
        camera: what the images were taken with.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._steps: list[_Step] = []
        self._seen = 0
        self._first: tuple[Features, FloatArray | None] | None = None
        self._since: list[tuple[FloatArray, FloatArray]] = []

    def look(
        self, features: Features, depth_m: FloatArray | None, increment: tuple[FloatArray, FloatArray]
    ) -> None:
        """Take in the next image: its features, their depths (m,) where known, the odometry to it (T, Q)."""
        if len(self._steps) >= _ENOUGH:
            return
        turn = self._seen % _EVERY
        self._seen += 1
        if turn == 0:
            self._first, self._since = (features, depth_m), []
        elif turn <= _APART and self._first is not None:
            self._since.append(increment)
            if turn == _APART:
                self._compare(*self._first, features)
                self._first = None

    def findings(self) -> list[str]:
        """What does not fit, with the likely cause."""
        if len(self._steps) < _PAIRS_MIN:
            return []
        cosine = self._cosine(self._camera.T_body_camera)
        if cosine < _ASTRAY:
            for T_body_camera, name in mounting_mistakes(self._camera.T_body_camera):
                if self._cosine(T_body_camera) > _FITS:
                    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
                    return [
                        f"the camera travels {angle:.0f}° beside where odometry and T_body_camera say, and "
                        f"as they say if {name}; {WHAT_IT_MAPS}"
                    ]
            return []
        scales = np.array([step.scale for step in self._steps])
        scales = scales[np.isfinite(scales)]
        scale = float(np.median(scales)) if len(scales) >= _PAIRS_MIN else 1.0
        if not 1.0 / _SCALE <= scale <= _SCALE:
            return [
                f"depths are {scale:.3g} times what parallax and odometry say: is a unit wrong, of the depth "
                "images, the baseline or the odometry?"
            ]
        return []

    def _compare(self, first: Features, depth_m: FloatArray | None, second: Features) -> None:
        """Keep the step between two images if they tell its direction."""
        T, Q = reduce(compose_increments, self._since)
        X = _of_camera(T, self._camera.T_body_camera)
        length = float(np.linalg.norm(X[:3, 3]))
        if length <= _SIGMAS * float(np.sqrt(np.trace(Q[3:, 3:]))):
            return
        K = self._camera.K
        pair = match_features(first, second, seed=self._seen, K=K)
        F, kept = pair.verification.F, pair.kept
        if pair.verification.geometry is not Geometry.EPIPOLAR or F is None or kept.sum() < _MATCHES_MIN:
            return
        one, two = pair.first[kept], pair.second[kept]
        _, R, t, _ = cv2.recoverPose(K.T @ F @ K, one, two, K)
        ray = self._camera.rays(one) @ np.asarray(R).T
        seen = self._camera.rays(two)
        off = (ray[:, :2] / ray[:, 2:] - seen[:, :2]) * [K[0, 0], K[1, 1]]
        if float(np.median(np.linalg.norm(off, axis=1))) < _PARALLAX_PX:
            return
        scale = float("nan")
        if depth_m is not None:
            # ray z + t length = seen z', by least squares on the two rows without z'.
            a = ray[:, :2] - seen[:, :2] * ray[:, 2:]
            b = length * (seen[:, :2] * t[2] - t[:2].T)
            with np.errstate(divide="ignore", invalid="ignore"):
                z = (a * b).sum(axis=1) / (a * a).sum(axis=1)
                ratio = depth_m[pair.matches.pairs[kept, 0]] / z
            ratio = ratio[np.isfinite(ratio) & (ratio > 0)]
            scale = float(np.median(ratio)) if len(ratio) >= _MATCHES_MIN // 2 else scale
        self._steps.append(_Step(np.asarray(t, dtype=np.float64).ravel(), T, scale))

    def _cosine(self, T_body_camera: FloatArray) -> float:
        """Between the directions by the images and by odometry through a mounting, in the median."""
        cosines = []
        for step in self._steps:
            expected = _of_camera(step.T, T_body_camera)[:3, 3]
            cosines.append(float(step.t @ expected) / max(float(np.linalg.norm(expected)), 1e-12))
        return float(np.median(cosines))


def _of_camera(T_first_second: FloatArray, T_body_camera: FloatArray) -> FloatArray:
    """X of a body that moved by ``T_first_second``."""
    X: FloatArray = inverse(T_body_camera) @ inverse(T_first_second) @ T_body_camera
    return X
