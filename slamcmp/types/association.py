"""What a front end without labels decided, beside what is true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.errors import DataError
from slamcmp.types.arrays import FloatArray, IntArray
from slamcmp.types.checks import assign, frozen

NO_LANDMARK = -1
"""As an id: left out of the stream. As a label: of no landmark (clutter, a moving robot)."""
NOT_KNOWN = -2
"""As a label: nobody knows whose the detection is."""


@dataclass(frozen=True)
class Association:
    """Of every detection of a log the id it was given and whose it truly is; labels served no decision."""

    ids: tuple[IntArray, ...]
    """One array a frame, over the log's detections (m,)."""
    labels: tuple[IntArray, ...]
    """The same shapes."""
    points: tuple[FloatArray, ...]
    """Where they lie in the body frame, (m, n) [m]."""

    def __post_init__(self) -> None:
        if not len(self.ids) == len(self.labels) == len(self.points):
            raise DataError(
                f"Association: {len(self.ids)}, {len(self.labels)} and {len(self.points)} frames; "
                "as many of each are needed"
            )
        assign(
            self,
            ids=tuple(frozen(each, "Association.ids", (None,), np.int64) for each in self.ids),
            labels=tuple(
                frozen(each, "Association.labels", (ids.size,), np.int64)
                for each, ids in zip(self.labels, map(np.asarray, self.ids), strict=True)
            ),
            points=tuple(
                frozen(each, "Association.points", (ids.size, None))
                for each, ids in zip(self.points, map(np.asarray, self.ids), strict=True)
            ),
        )
