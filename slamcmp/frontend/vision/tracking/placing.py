"""Delayed initialisation: a ray that has gathered enough parallax becomes a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from slamcmp.frontend.vision.geometry.triangulation import PoseHistory, parallax_deg, triangulate
from slamcmp.frontend.vision.tracking.track_table import TrackTable
from slamcmp.models.camera import MonoCamera
from slamcmp.types import FloatArray, IntArray

_VIEWS_MIN = 3
"""Two views fit all but one of their four numbers by themselves: hardly anything tests the point."""
_INVERSE_DEPTH_PRECISION = 0.12
"""Largest deviation of the inverse depth as a share of it, before the factor below is put on its square:
with more, a filter that linearises once goes astray."""
_SHARING = 10.0
"""Points that owe their depth to the same increments. They share those increments' errors, which a stream
of independent measurements cannot say; n times each one's covariance bounds n fully correlated ones."""
_PLACING = 1.5
SIGHTING = 3.0
"""The pixels that placed a point and those that it is measured by later are of one corner, whose place on
the surface is wrong in the same way (error_correlation.py): the later ones tell less anew than they seem to.
How much less is unknown, and covariances over w and 1 - w bound two pieces of information whatever they have
in common (Julier and Uhlmann 1997). w is two thirds: a placed point, already vague in depth, stands less of
it than a pixel. A point with a depth of its own needs no pixels before its first sighting."""


@dataclass(frozen=True)
class Placed:
    """Rays that are points from now on, and rays that are neither."""

    rows: IntArray
    """Of the track table, (m,)."""
    z: FloatArray
    """(m, 3), by the camera's entry sensor."""
    R: FloatArray
    """(m, 3, 3), for points whose errors are taken as independent."""
    contradicted: IntArray
    """Rows of rays whose views no point explains."""


def place_rays(
    tracks: TrackTable,
    rows: IntArray,
    camera: MonoCamera,
    history: PoseHistory,
    *,
    sigma_px: float,
    parallax_min_deg: float,
    depth_min_m: float,
    gate_probability: float,
) -> Placed:
    """Triangulate those of ``rows``, rays that the present image shows, that are due and well conditioned."""
    back, pixels = tracks.view_back[rows], tracks.view_pixel[rows]
    used = back >= 0
    every, oldest = np.arange(len(rows)), used.argmax(axis=1)
    angle = parallax_deg(camera, history, pixels[:, -1], pixels[every, oldest], back[every, oldest])
    due = (angle >= parallax_min_deg) & (used.sum(axis=1) >= _VIEWS_MIN)
    rows, used, back, pixels = rows[due], used[due], np.maximum(back[due], 0), pixels[due]
    if not rows.size:
        return Placed(rows, np.empty((0, 3)), np.empty((0, 3, 3)), rows)
    found = triangulate(camera, history, pixels, back, used, sigma_px=sigma_px)
    pair = camera.entry_sensor
    difference = np.array([1.0, -1.0, 0.0])
    disparity = found.z @ difference
    deviation = np.sqrt(difference @ found.R @ difference)
    fits = found.misfit <= chdtri(found.dof, 1.0 - gate_probability)
    good = found.in_front & fits & (deviation <= _INVERSE_DEPTH_PRECISION * disparity)
    good &= disparity <= pair.fx_px * pair.baseline_m / depth_min_m
    tracks.place(rows[good], pair, found.z[good], found.R[good])
    return Placed(rows[good], found.z[good], _bounded(found.R[good]), rows[~fits])


def _bounded(R: FloatArray) -> FloatArray:
    """R (m, 3, 3) as large as what the points have in common, and what with later pixels, asks for."""
    to_disparity = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    # The change of axes is its own inverse.
    B = to_disparity @ np.diag(np.sqrt([_PLACING, _SHARING, _PLACING])) @ to_disparity
    larger = B @ R @ B.T
    bounded: FloatArray = 0.5 * (larger + np.swapaxes(larger, 1, 2))
    return bounded
