"""Corners and descriptors at several scales: what one image shows twice as large as another still matches.

An ORB descriptor looks at a patch of fixed size, so that corners of one scale only match images of nearly
the same scale. Here the image is made smaller step by step, as in ORB itself (Rublee, Rabaud, Konolige and
Bradski 2011, section 4.2); each level has corners of its own, in number as its width, since what is to be
found again in an image of half the size must come from the upper levels.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import UsageError
from slamcmp.frontend.vision.features.harris import Corners
from slamcmp.frontend.vision.image_pair import Features, Suppression, extract_features
from slamcmp.image_files import SIDE_MIN_PX
from slamcmp.types import FloatArray

STEP = 2.0**0.25
"""Between two levels: half of it is what a descriptor bears without loss."""
LEVELS = 8
"""Reach a factor of 3.4."""


def extract_pyramid(
    image: NDArray[np.uint8], *, count: int = 500, levels: int = LEVELS, suppression: Suppression = "cells"
) -> Features:
    """At most ``count`` described corners from ``levels`` scales, in pixels of the image itself.

    Args:
        image: grey values (height, width).
        count: features wanted over all levels.
        levels: 1 is :func:`~slamcmp.frontend.vision.image_pair.extract_features`.
        suppression: as there, level by level.

    Raises:
        UsageError: fewer than one level.
    """
    if levels < 1:
        raise UsageError(f"extract_pyramid: {levels} levels; one at least is needed")
    height, width = image.shape
    factors = [STEP**level for level in range(levels)]
    factors = [each for each in factors if each == 1.0 or min(width, height) / each >= SIDE_MIN_PX]
    shares = np.array([1.0 / each for each in factors])
    wanted = np.floor(count * shares / shares.sum()).astype(int)
    wanted[0] += count - wanted.sum()
    found = []
    for factor, number in zip(factors, wanted.tolist(), strict=True):
        if not number:
            continue
        size = round(width / factor), round(height / factor)
        small = image if factor == 1.0 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        features = extract_features(small, count=number, suppression=suppression)
        back = np.array([width, height]) / np.array([small.shape[1], small.shape[0]])
        corners = replace(features.corners, xy=_enlarged(features.corners.xy, back))
        found.append(
            replace(
                features,
                xy=_enlarged(features.xy, back),
                corners=corners,
                factor=np.full(len(features.xy), factor),
            )
        )
    return _together(found)


def _enlarged(xy: FloatArray, factor: FloatArray) -> FloatArray:
    """Pixels of a smaller image in the larger one; a pixel's centre has whole coordinates."""
    larger: FloatArray = (xy + 0.5) * factor - 0.5
    return larger


def _together(levels: list[Features]) -> Features:
    response = np.concatenate([each.response for each in levels])
    order = np.argsort(-response, kind="stable")
    counts: Counter[str] = Counter()
    times: dict[str, float] = {}
    for each in levels:
        counts.update(each.counts)
        for name, value in each.times_ms.items():
            times[name] = times.get(name, 0.0) + value
    corners = Corners(
        np.concatenate([each.corners.xy for each in levels]),
        np.concatenate([each.corners.response for each in levels]),
        sum(each.corners.found for each in levels),
        sum(each.corners.at_border for each in levels),
    )
    return Features(
        np.concatenate([each.xy for each in levels])[order],
        response[order],
        np.concatenate([each.angle_deg for each in levels])[order],
        np.concatenate([each.descriptors for each in levels])[order],
        corners,
        dict(counts),
        times,
        np.concatenate([np.empty(0) if each.factor is None else each.factor for each in levels])[order],
    )
