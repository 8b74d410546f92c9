"""One landmark from several known poses: what the MSCKF makes of a track, to take the point out again."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.backends.entries import behind
from slamcmp.backends.robust import NOTHING, Kernel
from slamcmp.backends.sights import Sights
from slamcmp.types import FloatArray

TRIANGULATION_STEPS = 10
"""Gauss-Newton steps for one landmark; with a good first sight three suffice."""


def triangulate(
    sights: Sights, poses: FloatArray, z: FloatArray, W: FloatArray, start: FloatArray
) -> FloatArray | None:
    """The landmark (n,) that fits observations z (m, d) from known poses (m, …) best, or None.

    Gauss-Newton from ``start`` (n,); W (m, d, d) whitens. None where the observations do not determine it, or
    not in front of every camera.
    """
    m = len(z)
    position = start
    for _ in range(TRIANGULATION_STEPS):
        points = np.tile(position, (m, 1))
        H = (W @ sights.derivatives(poses, points, poses, points)[1]).reshape(z.size, -1)
        r = -(W @ sights.errors(poses, points, z)[..., None]).ravel()
        L, failed = dpotrf(H.T @ H, lower=1)
        if failed:
            return None
        step = dtrtrs(L, dtrtrs(L, H.T @ r, lower=1)[0], lower=1, trans=1)[0]
        position = position + step
        if np.abs(step).max() < 1e-10:
            break
    hidden = behind(sights.sensor, poses, np.tile(position, (m, 1)))
    return None if hidden is not None and hidden.any() else position


def best_supported(
    sights: Sights, poses: FloatArray, z: FloatArray, W: FloatArray, kernel: Kernel
) -> FloatArray:
    """Where one of the observations z (m, d) puts the landmark that costs all of them least, (n,)."""
    m = len(z)
    places = sights.entry_sensor.invert(poses, z)
    costs = [kernel.rho(lengths(sights, poses, z, W, np.tile(place, (m, 1)))).sum() for place in places]
    best: FloatArray = places[int(np.nanargmin(costs))]
    return best


def robust_triangulate(
    sights: Sights, poses: FloatArray, z: FloatArray, W: FloatArray, start: FloatArray, kernel: Kernel
) -> tuple[FloatArray | None, FloatArray]:
    """As ``triangulate``, with a kernel's weights (m,), which it tells; they begin at ``start`` (n,)."""
    m = len(z)
    position: FloatArray | None = start
    weights = np.ones(m)
    for _ in range(TRIANGULATION_STEPS):
        assert position is not None
        before, r = weights, lengths(sights, poses, z, W, np.tile(position, (m, 1)))
        weights = np.maximum(kernel.weight(r), NOTHING)
        position = triangulate(sights, poses, z, np.sqrt(weights)[:, None, None] * W, position)
        if position is None or np.abs(weights - before).max() < 1e-9:
            break
    return position, weights


def lengths(
    sights: Sights, poses: FloatArray, z: FloatArray, W: FloatArray, points: FloatArray
) -> FloatArray:
    """Of the whitened residuals, (m,)."""
    whitened = np.einsum("mij,mj->mi", W, sights.errors(poses, points, z))
    lengths: FloatArray = np.sqrt((whitened**2).sum(axis=1))
    return lengths
