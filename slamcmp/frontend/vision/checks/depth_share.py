"""How many of an image's points have a depth: few of them are told, with what became of the others."""

from __future__ import annotations

import numpy as np

from slamcmp.types import BoolArray, FloatArray

_FEW = 0.1
_IMAGES_MIN = 5
_REPEATED = 2
"""Once, a depth image may be the nearest in time to two others."""
_POINTS_MIN = 40
"""An image with fewer shows nothing, which is another story."""


class DepthShare:
    """Shares of the points with a usable depth, image by image."""

    def __init__(self) -> None:
        self._usable: list[float] = []
        self._near: list[float] = []
        self._far: list[float] = []
        self._repeated = 0
        self._longest = 0

    def look(self, depth_m: FloatArray, usable: BoolArray, depth_min_m: float, *, repeated: bool) -> None:
        """Take in an image: depths (m,), NaN where there is none, and which of them are measurements.

        ``repeated`` where the depth image is the last one again and the other image is not.
        """
        self._repeated = self._repeated + 1 if repeated else 0
        self._longest = max(self._longest, self._repeated)
        if len(depth_m) < _POINTS_MIN:
            return
        near = depth_m < depth_min_m
        self._usable.append(float(usable.mean()))
        self._near.append(float(near.mean()))
        self._far.append(float((np.isfinite(depth_m) & ~near & ~usable).mean()))

    def findings(self) -> list[str]:
        """What a user must know of it."""
        return [*self._frozen(), *self._few()]

    def _frozen(self) -> list[str]:
        if self._longest < _REPEATED:
            return []
        return [
            f"the same depth image came {self._longest + 1} times in a row while the other image changed: is "
            "the depth camera frozen?"
        ]

    def _few(self) -> list[str]:
        usable = np.array(self._usable)
        poor = usable < _FEW
        count = int(poor.sum())
        if count < _IMAGES_MIN:
            return []
        near, far = (float(np.array(each)[poor].mean()) for each in (self._near, self._far))
        rest = max(1.0 - near - far - float(usable[poor].mean()), 0.0)
        share, why = max(
            (near, "are nearer than depth_min_m: is a unit wrong, of depth or baseline?"),
            (far, "are too far away for the accuracy of the depth: is the baseline, or a unit, right?"),
            (rest, "have none: are both images of one instant and one calibration, and is no lens covered?"),
        )
        others = f" ({np.median(usable[~poor]):.0%} in the others)" if not poor.all() else ""
        return [
            f"in {count} of {usable.size} images {usable[poor].mean():.0%} of the points have a usable depth"
            f"{others}; {share:.0%} {why}"
        ]
