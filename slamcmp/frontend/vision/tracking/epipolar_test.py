"""Test the matches of all tracks against one epipolar geometry, where two images determine one."""

from __future__ import annotations

import numpy as np

from slamcmp.frontend.vision.geometry.degeneracy import Geometry, verify_matches
from slamcmp.frontend.vision.geometry.triangulation import PoseHistory
from slamcmp.frontend.vision.tracking.track_table import VIEWS, TrackTable
from slamcmp.models.camera import Camera
from slamcmp.types import BoolArray, FloatArray, IntArray

_PARALLAX_PX = 12.0
"""Between the two images, in the median."""
_SHARE_MIN = 0.5
"""Of the tracks that the last image shows: an older image that shows fewer is not used."""
_MATCHES_MIN = 16


def epipolar_test(
    tracks: TrackTable,
    rows: IntArray,
    now: FloatArray,
    camera: Camera,
    history: PoseHistory,
    *,
    seed: int,
    threshold_px: float,
) -> tuple[BoolArray, str]:
    """Which matches of ``rows`` with pixels ``now`` (m, 2) obey the geometry of two images.

    Tracks that the earlier image does not show pass, and so do all where the geometry is degenerate: no F is
    better than one that a plane or a rotation leaves open. The second answer then says why, in a phrase.
    """
    allowed = np.ones(len(rows), dtype=bool)
    if not len(rows):
        return allowed, ""
    shown, before = _earlier_view(tracks, rows, now, camera, history)
    answer = verify_matches(before, now[shown], seed=seed, threshold_px=threshold_px, K=camera.K)
    if answer.geometry is not Geometry.EPIPOLAR:
        return allowed, f"no epipolar test: {answer.geometry.replace('_', ' ')}"
    allowed[shown] = answer.inliers
    return allowed, ""


def _earlier_view(
    tracks: TrackTable, rows: IntArray, now: FloatArray, camera: Camera, history: PoseHistory
) -> tuple[IntArray, FloatArray]:
    """Which matches the latest image with enough parallax shows, and their pixels there.

    Two images taken a step apart hardly tell a room from a plane. Parallax is what the odometry's rotation
    leaves of the motion of the pixels.
    """
    shown, before = np.empty(0, np.int64), np.empty((0, 2))
    view_back, view_pixel = tracks.view_back[rows], tracks.view_pixel[rows]
    view_ray, R = camera.rays(view_pixel), history.camera_motion(camera)[:, :3, :3]
    for back in range(1, min(VIEWS, len(history.T_view))):
        candidates, view = (view_back == back).nonzero()
        if len(candidates) < max(_SHARE_MIN * len(shown), _MATCHES_MIN):
            break
        shown, before = candidates, view_pixel[candidates, view]
        parallax = (now[shown] - camera.project(view_ray[candidates, view] @ R[back])).T
        if _median(np.hypot(*parallax)) >= _PARALLAX_PX:
            break
    return shown, before


def _median(values: FloatArray) -> float:
    """Of those that are no NaN; a quarter of the time of ``np.median``, for up to seven images a frame."""
    ordered = np.sort(values)
    count = len(values) - int(np.isnan(values).sum())
    return float(0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]))
