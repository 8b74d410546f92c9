"""The course's front end on images: corners, suppression, descriptors, matches, outlier rejection.

Every stage counts what it let through and what it took, so that nothing is lost in silence.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.features.harris import Corners, harris_corners
from slamcmp.frontend.vision.features.orb import BORDER_PX, describe
from slamcmp.frontend.vision.features.suppression import suppress_brown, suppress_cells
from slamcmp.frontend.vision.geometry.degeneracy import Method, Verification, verify_matches
from slamcmp.frontend.vision.matching import Matches, match_descriptors
from slamcmp.types import BoolArray, FloatArray

Suppression = Literal["cells", "brown", "none"]


@dataclass(frozen=True)
class Features:
    """Described corners of one image, strongest first."""

    xy: FloatArray
    """Pixels (m, 2)."""
    response: FloatArray
    """(m,)."""
    angle_deg: FloatArray
    """(m,)."""
    descriptors: NDArray[np.uint8]
    """(m, 32)."""
    corners: Corners
    """What suppression chose from."""
    counts: Mapping[str, int]
    """found, at_border, weak (beyond the number of candidates), suppressed, undescribed, features."""
    times_ms: Mapping[str, float]
    factor: FloatArray | None = None
    """How many times smaller the image was in which each was found, (m,); None: not at all."""


@dataclass(frozen=True)
class PairMatches:
    """Matches between two images before and after outlier rejection."""

    first: FloatArray
    """Pixels (m, 2) in the first image."""
    second: FloatArray
    """Pixels (m, 2) in the second image."""
    matches: Matches
    verification: Verification
    counts: Mapping[str, int]
    """tried, not_mutual, ambiguous, matches, rejected, kept."""
    times_ms: Mapping[str, float]

    @property
    def kept(self) -> BoolArray:
        """Which matches passed, (m,)."""
        return self.verification.inliers


@dataclass
class _Clock:
    times_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.times_ms[name] = 1e3 * (time.perf_counter() - start)


def extract_features(
    image: NDArray[np.uint8],
    *,
    count: int = 500,
    suppression: Suppression = "cells",
    candidates: int = 3000,
    quality: float = 1e-3,
    subpixel: bool = True,
) -> Features:
    """At most ``count`` described Harris corners of a grey image, spread by adaptive suppression.

    Args:
        image: grey values (height, width).
        count: features wanted.
        suppression: square cells (fast), Brown's exact radii, or none (simply the strongest).
        candidates: how many of the strongest corners suppression chooses from.
        quality: smallest response as a share of the largest.
        subpixel: see :func:`~slamcmp.frontend.vision.features.harris.harris_corners`.
    """
    clock = _Clock()
    with clock.stage("harris"):
        # The border is cleared before suppression: what is dropped after it would leave holes.
        corners = harris_corners(
            image, quality=quality, count_max=candidates, border_px=BORDER_PX + 1, subpixel=subpixel
        )
    with clock.stage("suppression"):
        chosen = _suppress(corners, count, suppression)
    with clock.stage("orb"):
        description = describe(image, corners.xy[chosen])
    kept = chosen[description.described]
    available = corners.xy.shape[0]
    return Features(
        corners.xy[kept],
        corners.response[kept],
        description.angle_deg,
        description.descriptors,
        corners,
        {
            "found": corners.found,
            "at_border": corners.at_border,
            "weak": corners.found - corners.at_border - available,
            "suppressed": available - chosen.size,
            "undescribed": chosen.size - kept.size,
            "features": kept.size,
        },
        clock.times_ms,
    )


def match_features(
    first: Features,
    second: Features,
    *,
    seed: int,
    ratio: float = 0.8,
    mutual: bool = True,
    allowed: BoolArray | None = None,
    method: Method = "magsac",
    threshold_px: float = 1.0,
    K: FloatArray | None = None,
) -> PairMatches:
    """Match two images' features and reject what the geometry of two views does not allow.

    The parameters are those of :func:`~slamcmp.frontend.vision.matching.match_descriptors` and
    :func:`~slamcmp.frontend.vision.geometry.degeneracy.verify_matches`.
    """
    clock = _Clock()
    with clock.stage("matching"):
        matches = match_descriptors(
            first.descriptors, second.descriptors, ratio=ratio, mutual=mutual, allowed=allowed
        )
    one, two = first.xy[matches.pairs[:, 0]], second.xy[matches.pairs[:, 1]]
    with clock.stage("verification"):
        verification = verify_matches(one, two, seed=seed, method=method, threshold_px=threshold_px, K=K)
    kept = int(verification.inliers.sum())
    counts = {
        "tried": matches.tried,
        "not_mutual": matches.not_mutual,
        "ambiguous": matches.ambiguous,
        "matches": len(matches.pairs),
        "rejected": len(matches.pairs) - kept,
        "kept": kept,
    }
    return PairMatches(one, two, matches, verification, counts, clock.times_ms)


def precision_recall(kept: BoolArray, correct: BoolArray) -> tuple[float, float]:
    """Share of the kept matches that are correct, and of the correct ones that are kept; NaN for 0 of 0."""
    both = int((kept & correct).sum())
    precision = both / kept.sum() if kept.any() else float("nan")
    recall = both / correct.sum() if correct.any() else float("nan")
    return float(precision), float(recall)


def _suppress(corners: Corners, count: int, suppression: Suppression) -> NDArray[np.int64]:
    if suppression == "cells":
        return suppress_cells(corners.xy, corners.response, count)
    if suppression == "brown":
        return suppress_brown(corners.xy, corners.response, count)
    if suppression == "none":
        return np.arange(min(count, len(corners.response)), dtype=np.int64)
    raise UsageError(f"suppression {suppression!r}; cells, brown or none is needed")
