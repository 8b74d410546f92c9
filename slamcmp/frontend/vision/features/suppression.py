"""Adaptive non-maximal suppression: few corners, spread over the image instead of crowded where it is sharp.

Brown, Szeliski and Winder 2005 ("Multi-image matching using multi-scale oriented patches", section 3): the
radius of a corner is its distance to the nearest corner that is clearly stronger; keep those with the
largest radii. :func:`suppress_brown` is that definition exactly; :func:`suppress_cells` is many times faster
and spreads at least as well.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slamcmp.types import FloatArray, IntArray

_CLEARANCE = 0.7
"""Of a cell's side: winners of neighbouring cells that are closer than this do not both stay."""
_TRIALS = 8
_NARROWEST_PX = 1.0
_SURPLUS = 0.05
"""A width that gives up to this share too many corners is good enough; the weakest are cut."""
_FAR_PX = -1e9


def brown_radii(xy: FloatArray, response: FloatArray, *, robustness: float = 0.9) -> FloatArray:
    """Squared distances (m,) [px²] to the nearest corner j with response_i < robustness · response_j.

    Infinite where there is none. Neighbours come from a k-d tree, more and more of them for the corners
    that have not met a stronger one yet, so that the cost is near n log n.
    """
    count = len(response)
    squared = np.full(count, np.inf)
    if count == 0:
        return squared
    open_ = np.flatnonzero(response < robustness * response.max())
    tree = cKDTree(xy)
    neighbours = 8
    while open_.size:
        neighbours = min(neighbours, count)
        still_open = []
        # Blocks bound the memory for the few corners that need almost all the others.
        for block in np.array_split(open_, -(-open_.size * neighbours // 500_000)):
            _, near = tree.query(xy[block], k=neighbours)
            near = np.reshape(near, (block.size, neighbours))
            stronger = response[block, None] < robustness * response[near]
            # The tree's own distances are rounded by a root; integer pixels square exactly.
            distance = ((xy[near] - xy[block, None]) ** 2).sum(axis=-1)
            nearest = np.where(stronger, distance, np.inf).min(axis=1)
            squared[block] = nearest
            still_open.append(block[np.isinf(nearest)])
        open_ = np.concatenate(still_open)
        neighbours *= 4
    return squared


def suppress_brown(xy: FloatArray, response: FloatArray, count: int, *, robustness: float = 0.9) -> IntArray:
    """Indices of the ``count`` corners with the largest radius, strongest first; ties by strength."""
    squared = brown_radii(xy, response, robustness=robustness)
    kept = np.lexsort((-response, -squared))[:count]
    return kept[np.lexsort((kept, -response[kept]))].astype(np.int64)


def suppress_cells(xy: FloatArray, response: FloatArray, count: int) -> IntArray:
    """Indices of ``count`` well spread corners, strongest first, by square cells of adapted width.

    Each cell keeps its strongest corner, unless a neighbouring cell's is stronger and closer than 0.7 of
    the width. The width is adapted until the right number stays.
    """
    total = len(response)
    order = np.argsort(-response, kind="stable")
    if total <= count:
        return order.astype(np.int64)
    corner = xy.min(axis=0)
    x, y = places = np.full((2, total + 1), _FAR_PX, dtype=np.float32)
    places[:, :-1] = (xy[order] - corner).T
    extent = (float(x[:-1].max()) + 1.0, float(y[:-1].max()) + 1.0)
    # Of a square per corner, this much of its side is about right for corners from a photograph.
    width = max(0.7 * math.sqrt(extent[0] * extent[1] / count), _NARROWEST_PX)
    aim = math.log(count * (1.0 + 0.5 * _SURPLUS))
    too_narrow, too_wide = _NARROWEST_PX, 2.0 * max(extent)
    slope, last = -1.5, (0.0, 0.0)
    best: IntArray | None = None
    for trial in range(_TRIALS):
        kept = _cell_winners(x, y, extent, width)
        if kept.size >= count:
            too_narrow = width
            if best is None or kept.size < best.size:
                best = kept
            if kept.size <= (1.0 + _SURPLUS) * count:
                break
        else:
            too_wide = width
        if too_wide <= _NARROWEST_PX:
            break
        # The number falls with a power of the width; a secant through the last two trials finds it.
        here = (math.log(width), math.log(max(kept.size, 1)))
        if trial and here[0] != last[0]:
            slope = min(-0.5, (here[1] - last[1]) / (here[0] - last[0]))
        last = here
        width = math.exp(here[0] + (aim - here[1]) / slope)
        if not too_narrow < width < too_wide:
            width = max(0.5 * (too_narrow + too_wide), _NARROWEST_PX)
    if best is None:
        # Too many corners share their place: fill up with the strongest that are left.
        rest = np.setdiff1d(np.arange(total), kept)
        best = np.concatenate([kept, rest[: count - kept.size]])
    return order[np.sort(best)[:count]].astype(np.int64)


def _cell_winners(
    x: NDArray[np.float32], y: NDArray[np.float32], extent: tuple[float, float], width: float
) -> IntArray:
    """Ranks of the corners that stay at this width; corners come in order of falling response.

    After them x and y have a last entry that is far away: the place of an empty cell's corner.
    """
    # A column and a row more, always empty: no step along the flat grid leads out of it or round its side.
    columns, rows = int(extent[0] / width) + 2, int(extent[1] / width) + 2
    scale = np.float32(1.0 / width)
    # Weakest first, so that the strongest of a cell is what stays written.
    cell = (y[-2::-1] * scale).astype(np.int64)
    cell *= columns
    cell += (x[-2::-1] * scale).astype(np.int64)
    none = cell.size
    winner = np.full(rows * columns, none)
    winner[cell] = np.arange(none - 1, -1, -1)
    occupied = (winner < none).nonzero()[0]
    here = winner[occupied]
    x_here, y_here = x.take(here), y.take(here)
    limit = np.float32((_CLEARANCE * width) ** 2)
    loses = np.zeros(none, dtype=bool)
    # Four of the eight directions reach every pair of neighbours once: right, and the three below.
    for step in (1, columns - 1, columns, columns + 1):
        there = winner.take(occupied + step)
        across, down = x_here - x.take(there), y_here - y.take(there)
        across *= across
        down *= down
        across += down
        # The higher rank is the weaker corner.
        loses[np.maximum(here, there)[across < limit]] = True
    return here[~loses.take(here)]
