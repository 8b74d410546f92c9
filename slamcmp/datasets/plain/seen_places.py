"""Where landmarks are that no file places: by what was seen of them from true poses."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from slamcmp.datasets.plain.column_files import Table
from slamcmp.types import FloatArray

LEAST_SIGHTINGS = 5
"""Of a landmark; of fewer the median would follow the errors that it shall show."""


def seen_places(table: Table, at: FloatArray) -> dict[int, FloatArray]:
    """By name the place (2,) of each landmark that was seen often enough.

    ``at`` (rows, 4, 4) are the true poses, NaN where they are not known. A place is the median of where its
    sightings put it, so that outliers have no say. Empty where a sighting is a range or a bearing alone.
    """
    if table.has("range", "bearing"):
        r, beta = table.columns["range"], table.columns["bearing"]
        body = np.stack([r * np.cos(beta), r * np.sin(beta)], axis=1)
    elif table.has("x", "y"):
        body = np.stack([table.columns["x"], table.columns["y"]], axis=1)
    else:
        return {}
    places = np.einsum("kij,kj->ki", at[:, :2, :2], body) + at[:, :2, 3]
    rows: defaultdict[int, list[int]] = defaultdict(list)
    for k in np.flatnonzero(np.isfinite(places).all(axis=1)).tolist():
        name = None if table.ids is None else table.ids[k]
        if name is not None:
            rows[name].append(k)
    return {name: np.median(places[own], axis=0) for name, own in rows.items() if len(own) >= LEAST_SIGHTINGS}
