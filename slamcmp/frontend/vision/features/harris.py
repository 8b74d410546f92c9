"""Harris corners: the course's feature extraction, spelt out once and then taken from OpenCV for speed.

With the image gradient (I_x, I_y) summed over a window, M = [[Σ I_x², Σ I_x I_y], [Σ I_x I_y, Σ I_y²]],
the response is det M − k (trace M)² (Harris and Stephens 1988). It is large where both eigenvalues are,
negative on edges, and near 0 on flat ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import UsageError
from slamcmp.types import FloatArray, IntArray


@dataclass(frozen=True)
class Corners:
    """Corners in order of falling response."""

    xy: FloatArray
    """Pixels (m, 2) as (column, row)."""
    response: FloatArray
    """(m,)."""
    found: int
    """How many there were before the weakest were cut and the border was cleared."""
    at_border: int
    """How many of them lay too close to the border."""


def harris_response(image: NDArray[np.generic], *, window: int = 3, k: float = 0.04) -> FloatArray:
    """The Harris response (height, width) of a grey image, written out with numpy; for teaching.

    The gradient is Sobel's 3×3, the window a box of odd side; both are scaled as in ``cv2.cornerHarris``
    (1/4 and 1/window), with which this agrees for float images, away from the border.

    Raises:
        UsageError: the window's side is even.
    """
    if window % 2 == 0:
        raise UsageError(f"harris_response: window is {window}; an odd number of pixels is needed")
    padded = np.pad(np.asarray(image, dtype=np.float64), 1, mode="reflect")
    scale = 1.0 / (4.0 * window)
    across = padded[:, 2:] - padded[:, :-2]
    down = padded[2:, :] - padded[:-2, :]
    I_x = scale * (across[:-2] + 2.0 * across[1:-1] + across[2:])
    I_y = scale * (down[:, :-2] + 2.0 * down[:, 1:-1] + down[:, 2:])
    xx, xy, yy = (_box_sum(product, window) for product in (I_x * I_x, I_x * I_y, I_y * I_y))
    trace = xx + yy
    response: FloatArray = xx * yy - xy * xy - k * trace * trace
    return response


def harris_corners(
    image: NDArray[np.uint8],
    *,
    window: int = 3,
    k: float = 0.04,
    quality: float = 1e-3,
    count_max: int = 3000,
    border_px: int = 0,
    subpixel: bool = True,
) -> Corners:
    """Local maxima of the Harris response.

    Args:
        image: grey values (height, width).
        window: side of the box over which gradients are summed [px].
        k: Harris's constant.
        quality: smallest response, as a share of the image's largest.
        count_max: only so many of the strongest are returned.
        border_px: corners closer to the border are dropped and counted.
        subpixel: move each corner to the peak of a quadric through the nearest nine responses.
    """
    response = np.asarray(cv2.cornerHarris(image, window, 3, k))
    largest = float(response.max())
    if not largest > 0.0:
        return Corners(np.empty((0, 2)), np.empty(0), 0, 0)
    # A corner is the largest response among its eight neighbours.
    neighbourhood = cv2.dilate(response, np.ones((3, 3), dtype=np.uint8))
    flat = np.flatnonzero((response >= neighbourhood) & (response > quality * largest))
    rows, columns = np.divmod(flat, response.shape[1])
    found = flat.size
    # The outermost ring has no neighbours on all sides.
    margin = max(border_px, 1)
    inside = (
        (columns >= margin)
        & (columns < response.shape[1] - margin)
        & (rows >= margin)
        & (rows < response.shape[0] - margin)
    )
    rows, columns = rows[inside], columns[inside]
    strength = response[rows, columns]
    # Ties keep the order of the image: the same corners on every machine.
    order = np.argsort(-strength, kind="stable")[:count_max]
    rows, columns, strength = rows[order], columns[order], strength[order].astype(np.float64)
    xy = np.stack([columns, rows], axis=-1).astype(np.float64)
    if subpixel:
        xy += _quadric_peaks(response, rows, columns)
    return Corners(xy, strength, found, int(found - inside.sum()))


def _box_sum(values: FloatArray, window: int) -> FloatArray:
    """Sums over a centred square of odd side, by running sums along each axis."""
    half = window // 2
    padded = np.pad(values, ((half + 1, half), (half + 1, half)), mode="reflect")
    # The padding's first line only gives the running sum its zero.
    padded[0], padded[:, 0] = 0.0, 0.0
    running = padded.cumsum(axis=0).cumsum(axis=1)
    total: FloatArray = (
        running[window:, window:]
        - running[:-window, window:]
        - running[window:, :-window]
        + running[:-window, :-window]
    )
    return total


def _quadric_peaks(response: NDArray[np.float32], rows: IntArray, columns: IntArray) -> FloatArray:
    """Offsets (m, 2) in [-0.5, 0.5] px of the peak of a quadric through the nine responses around."""

    values, width = response.ravel(), response.shape[1]
    at = rows * width + columns

    def beside(down: int, right: int) -> FloatArray:
        value: FloatArray = values[at + (down * width + right)].astype(np.float64)
        return value

    centre = beside(0, 0)
    left, right, above, below = beside(0, -1), beside(0, 1), beside(-1, 0), beside(1, 0)
    slope_x, slope_y = 0.5 * (right - left), 0.5 * (below - above)
    bend_x, bend_y = right + left - 2.0 * centre, below + above - 2.0 * centre
    twist = 0.25 * (beside(1, 1) + beside(-1, -1) - beside(1, -1) - beside(-1, 1))
    determinant = bend_x * bend_y - twist * twist
    # No peak (a ridge, a plateau): the whole pixel stays.
    determinant = np.where(determinant > 0, determinant, np.inf)
    across = (twist * slope_y - bend_y * slope_x) / determinant
    down = (twist * slope_x - bend_x * slope_y) / determinant
    return np.clip(np.stack([across, down], axis=-1), -0.5, 0.5)
