"""Where in the new image to look for each track: about its predicted pixel, or along its epipolar line.

A placed point is looked for in an ellipse by its own covariance. A ray is looked for between where it would
be at infinity and where it would be at the smallest depth, as wide as odometry and pixel noise say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.frontend.vision.track_table import TrackTable
from slamcmp.frontend.vision.triangulation import PoseHistory
from slamcmp.geometry import inverse, transform
from slamcmp.models.camera import MonoCamera
from slamcmp.types import BoolArray, FloatArray, IntArray

Size = tuple[int, int]

_STEPS_AWAY = 4.0
"""What is nearer than so many of the robot's steps flies past too fast to be placed."""


@dataclass(frozen=True)
class Windows:
    """Segments of the image with a covariance about them, (m,)."""

    rows: IntArray
    """The tracks that should be in the image, and of which it is known well enough where."""
    start: FloatArray
    """(m, 2) [px]."""
    along: FloatArray
    """From there to the segment's end, (m, 2) [px]; zero for a placed point."""
    whitening: FloatArray
    """L⁻¹ of the covariance L Lᵀ, (m, 2, 2)."""
    deviation: FloatArray
    """By that covariance along either axis of the image, (m, 2) [px]."""

    def distances(self, which: IntArray, pixels: FloatArray) -> FloatArray:
        """Squared Mahalanobis distances (m,) of pixels (m, 2) from the windows ``which`` (m,)."""
        # Axis by axis and each window's own part once: thousands of pairs come through here.
        along_x, along_y = (self.whitening @ self.along[:, :, None])[:, :, 0].T
        length = np.maximum(along_x * along_x + along_y * along_y, 1e-12)
        x, y = (pixels - self.start[which]).T
        W = self.whitening[which]
        off_x, off_y = W[:, 0, 0] * x + W[:, 0, 1] * y, W[:, 1, 0] * x + W[:, 1, 1] * y
        along_x, along_y = along_x[which], along_y[which]
        share = np.clip((off_x * along_x + off_y * along_y) / length[which], 0.0, 1.0)
        squared: FloatArray = (off_x - share * along_x) ** 2 + (off_y - share * along_y) ** 2
        return squared

    def near(self, pixels: FloatArray, limit: float) -> BoolArray:
        """Which pixels (n, 2) lie within each window, (m, n), at squared distance ``limit`` or less."""
        # Bounding boxes first: few pairs are left for the exact test.
        reach = np.sqrt(limit) * self.deviation
        end = self.start + self.along
        low, high = np.minimum(self.start, end) - reach, np.maximum(self.start, end) + reach
        x, y = np.ascontiguousarray(pixels.T)
        allowed: BoolArray = (x >= low[:, :1]) & (x <= high[:, :1])
        allowed &= (y >= low[:, 1:]) & (y <= high[:, 1:])
        pairs = np.flatnonzero(allowed)
        which, pixel = np.divmod(pairs, len(pixels))
        np.put(allowed, pairs, self.distances(which, pixels[pixel]) <= limit)
        return allowed


def search_windows(
    tracks: TrackTable,
    camera: MonoCamera,
    history: PoseHistory,
    size: Size,
    *,
    sigma_px: float,
    depth_min_m: float,
    widest_px: float,
) -> Windows:
    """The windows of all tracks that should be in the image of ``size`` (width, height).

    Args:
        tracks: moved to the present frame.
        camera: the one that features are found with.
        history: whose entry 1 is the last image.
        size: of the image.
        sigma_px: deviation of a feature's position.
        depth_min_m: nothing is closer.
        widest_px: a deviation beyond this is too uncertain to look for.
    """
    noise = sigma_px**2 * np.eye(2)
    placed, rays = np.flatnonzero(tracks.placed), np.flatnonzero(~tracks.placed)
    start, covariance = tracks.predicted(placed, camera)
    far, near, doubt = _ray_segments(tracks.pixel[rays], camera, history, depth_min_m)
    rows = np.concatenate([placed, rays])
    starts = np.concatenate([start, far])
    along = np.concatenate([np.zeros_like(start), near - far])
    S = np.concatenate([covariance, np.tile(doubt, (rays.size, 1, 1)) + noise]) + noise
    with np.errstate(invalid="ignore"):
        inside = ((starts >= 0) & (starts <= np.array(size) - 1)).all(axis=1)
        known = np.trace(S, axis1=1, axis2=2) <= 2 * widest_px**2
    good = np.isfinite(starts).all(axis=1) & np.isfinite(along).all(axis=1) & inside & known
    S = S[good]
    return Windows(
        rows[good],
        starts[good],
        along[good],
        np.linalg.inv(np.linalg.cholesky(S)),
        np.sqrt(np.diagonal(S, axis1=1, axis2=2)),
    )


def _ray_segments(
    pixels: FloatArray, camera: MonoCamera, history: PoseHistory, depth_min_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels now of rays of the last image at infinity and at the smallest depth; their covariance (2, 2)."""
    if len(history.T_view) < 2 or not len(pixels):
        return pixels, pixels, np.zeros((2, 2))
    motion = inverse(camera.T_camera_body @ history.T_view[1] @ camera.T_body_camera)
    of_turn_and_step = np.stack([history.S[1][:3, :3], history.S[1][3:, 3:]])
    turn_doubt, step_doubt = np.linalg.eigvalsh(of_turn_and_step)[:, -1].tolist()
    step = float(np.linalg.norm(motion[:3, 3])) + np.sqrt(step_doubt)
    nearest = max(depth_min_m, _STEPS_AWAY * step)
    rays = camera.rays(pixels)
    far = camera.project(rays @ motion[:3, :3].T)
    near = camera.project(transform(motion, nearest * rays))
    largest = turn_doubt + step_doubt / nearest**2
    return far, near, max(camera.fx_px, camera.fy_px) ** 2 * largest * np.eye(2)
