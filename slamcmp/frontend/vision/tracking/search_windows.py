"""Where in the new image to look for each track: about its predicted pixel, or along its epipolar line.

A placed point is looked for in an ellipse by its own covariance. A ray is looked for between where it would
be at infinity and where it would be at the smallest depth, as wide as odometry and pixel noise say.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slamcmp.frontend.vision.geometry.triangulation import PoseHistory
from slamcmp.frontend.vision.tracking.track_table import TrackTable
from slamcmp.geometry import inverse, transform
from slamcmp.models.camera import MonoCamera
from slamcmp.types import FloatArray, IntArray

Size = tuple[int, int]

_STEPS_AWAY = 4.0
"""What is nearer than so many of the robot's steps flies past too fast to be placed."""
_BOX_PX = 0.1
_EYE = np.eye(2)


@dataclass(frozen=True)
class Windows:
    """Segments of the image with a covariance about them, (m,)."""

    rows: IntArray
    """The tracks that should be in the image, and of which it is known well enough where."""
    start: FloatArray
    """(m, 2) [px]."""
    along: FloatArray
    """From there to the segment's end, (m, 2) [px]; zero for a placed point."""
    covariance: FloatArray
    """(m, 2, 2) [px²]."""

    @cached_property
    def _whitened(self) -> FloatArray:
        """Each window's numbers in the coordinates L⁻¹ u of its covariance L Lᵀ, (8, m).

        The entries 11, 21 and 22 of L⁻¹, the start in pixels, the segment in those coordinates, its length².
        """
        root = np.sqrt(self.covariance[:, 0, 0])
        below = self.covariance[:, 1, 0] / root
        w_22 = 1.0 / np.sqrt(self.covariance[:, 1, 1] - below * below)
        w_11 = 1.0 / root
        w_21 = -below * w_11 * w_22
        along_x = w_11 * self.along[:, 0]
        along_y = w_21 * self.along[:, 0] + w_22 * self.along[:, 1]
        length = np.maximum(along_x * along_x + along_y * along_y, 1e-12)
        return np.stack([w_11, w_21, w_22, *self.start.T, along_x, along_y, length])

    def distances(self, which: IntArray, pixels: FloatArray) -> FloatArray:
        """Squared Mahalanobis distances (m,) of pixels (m, 2) from the windows ``which`` (m,)."""
        # Axis by axis and each window's own part once: thousands of pairs come through here.
        w_11, w_21, w_22, x_0, y_0, along_x, along_y, length = self._whitened.take(which, axis=1)
        x, y = pixels[:, 0] - x_0, pixels[:, 1] - y_0
        off_x, off_y = w_11 * x, w_21 * x + w_22 * y
        share = (off_x * along_x + off_y * along_y) / length
        share = np.minimum(np.maximum(share, 0.0), 1.0)
        off_x -= share * along_x
        off_y -= share * along_y
        squared: FloatArray = off_x * off_x + off_y * off_y
        return squared

    def near(self, pixels: FloatArray, limit: float) -> tuple[IntArray, IntArray]:
        """Windows and pixels (n, 2) within them, at squared distance ``limit`` or less, (p,) and (p,).

        By window, and within each by pixel.
        """
        # Bounding boxes first, in single precision and wider for it: few pairs are left for the exact test.
        reach = np.sqrt(limit * self.covariance.diagonal(axis1=1, axis2=2)) + _BOX_PX
        end = self.start + self.along
        low = (np.minimum(self.start, end) - reach).astype(np.float32)
        high = (np.maximum(self.start, end) + reach).astype(np.float32)
        x, y = pixels.T.astype(np.float32)
        boxed = x >= low[:, :1]
        boxed &= x <= high[:, :1]
        boxed &= y >= low[:, 1:]
        boxed &= y <= high[:, 1:]
        which: IntArray
        pixel: IntArray
        which, pixel = np.divmod(boxed.ravel().nonzero()[0], len(pixels))
        inside = self.distances(which, pixels.take(pixel, axis=0)) <= limit
        return which[inside], pixel[inside]


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
    noise = sigma_px**2 * _EYE
    placed, rays = tracks.placed.nonzero()[0], (~tracks.placed).nonzero()[0]
    start, covariance = tracks.predicted(placed, camera)
    far, near, doubt = _ray_segments(tracks.pixel[rays], camera, history, depth_min_m)
    rows = np.concatenate([placed, rays])
    starts = np.concatenate([start, far])
    along = np.zeros_like(starts)
    along[placed.size :] = near - far
    S = np.empty((rows.size, 2, 2))
    S[: placed.size] = covariance
    S[placed.size :] = doubt + noise
    S += noise
    x, y = starts.T
    # No comparison with NaN is true.
    good = (x >= 0) & (x <= size[0] - 1) & (y >= 0) & (y <= size[1] - 1)
    good &= S[:, 0, 0] + S[:, 1, 1] <= 2 * widest_px**2
    good &= np.isfinite(along[:, 0] + along[:, 1])
    return Windows(rows[good], starts[good], along[good], S[good])


def _ray_segments(
    pixels: FloatArray, camera: MonoCamera, history: PoseHistory, depth_min_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels now of rays of the last image at infinity and at the smallest depth; their covariance (2, 2)."""
    if len(history.T_view) < 2 or not len(pixels):
        return pixels, pixels, np.zeros((2, 2))
    motion = inverse(history.camera_motion(camera)[1])
    of_turn_and_step = np.stack([history.S[1][:3, :3], history.S[1][3:, 3:]])
    turn_doubt, step_doubt = np.linalg.eigvalsh(of_turn_and_step)[:, -1].tolist()
    step = float(np.linalg.norm(motion[:3, 3])) + np.sqrt(step_doubt)
    nearest = max(depth_min_m, _STEPS_AWAY * step)
    rays = camera.rays(pixels)
    far = camera.project(rays @ motion[:3, :3].T)
    near = camera.project(transform(motion, nearest * rays))
    largest = turn_doubt + step_doubt / nearest**2
    return far, near, max(camera.fx_px, camera.fy_px) ** 2 * largest * _EYE
