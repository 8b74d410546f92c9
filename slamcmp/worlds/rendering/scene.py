"""A scene of textured rectangles, and exact rays through it.

A rectangle is corner + s edge_s + t edge_t with s, t in [0, 1]. With A = [edge_s, edge_t, corner] in the
camera frame, the pixel (u, v) looks at w = (K A)⁻¹ (u, v, 1)ᵀ, where s = w_0 / w_2, t = w_1 / w_2 and w_2 is
the inverse depth. All three are linear in the pixel, so that visibility needs no division and no tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamcmp.geometry import inverse, transform
from slamcmp.types import FloatArray

Texture = NDArray[np.uint8]


@dataclass(frozen=True)
class Panel:
    """A rectangle that is seen only from the side from which s runs right where t runs down."""

    corner: FloatArray
    """World (3,) [m], where the texture's top left corner goes."""
    edge_s: FloatArray
    """Along the texture's rows, (3,) [m]."""
    edge_t: FloatArray
    """Along the texture's columns, (3,) [m]."""
    texture: Texture
    """(height, width)."""
    brightness: float = 1.0


class Scene:
    """Rectangles with the smaller copies of their textures that distant views need.

    Large panels are cut into tiles, for each tile is drawn with one level of detail.
    """

    def __init__(self, panels: list[Panel], *, tile_m: float = 1.5) -> None:
        tiles = [tile for panel in panels for tile in _tiles(panel, tile_m)]
        self.corner = np.stack([tile.corner for tile in tiles])
        self.edge_s = np.stack([tile.edge_s for tile in tiles])
        self.edge_t = np.stack([tile.edge_t for tile in tiles])
        self.brightness = np.array([tile.brightness for tile in tiles])
        self.pyramids = [_pyramid(tile.texture) for tile in tiles]

    def in_camera(self, T_world_camera: FloatArray) -> FloatArray:
        """A = [edge_s, edge_t, corner] of every tile in the camera frame, (P, 3, 3)."""
        T_camera_world = inverse(T_world_camera)
        R = T_camera_world[:3, :3]
        corner = transform(T_camera_world, self.corner)
        return np.stack([self.edge_s @ R.T, self.edge_t @ R.T, corner], axis=-1)

    def depth_at(self, T_world_camera: FloatArray, K: FloatArray, pixels: FloatArray) -> FloatArray:
        """Depth (m,) [m] along the optical axis of what is seen at pixels (m, 2); NaN where nothing is."""
        A = self.in_camera(T_world_camera)
        A = A[faces_camera(A)]
        nearest = np.zeros(len(pixels))
        rays = np.linalg.solve(K, np.column_stack([pixels, np.ones(len(pixels))]).T)
        for w in np.linalg.solve(A, rays[None]):
            hit = (w[0] >= 0) & (w[0] <= w[2]) & (w[1] >= 0) & (w[1] <= w[2])
            np.maximum(nearest, np.where(hit, w[2], 0.0), out=nearest)
        return np.where(nearest > 0, 1.0 / np.where(nearest > 0, nearest, 1.0), np.nan)


def faces_camera(A: FloatArray) -> NDArray[np.bool_]:
    """Which tiles (P, 3, 3) turn their visible side to the camera."""
    # The visible side is the one from which edge_s × edge_t points away.
    turned: NDArray[np.bool_] = np.linalg.det(A) > 1e-9
    return turned


def _tiles(panel: Panel, tile_m: float) -> list[Panel]:
    rows, columns = panel.texture.shape
    across = max(1, round(float(np.linalg.norm(panel.edge_s)) / tile_m))
    down = max(1, round(float(np.linalg.norm(panel.edge_t)) / tile_m))
    tiles = []
    for j in range(down):
        for i in range(across):
            r0, r1 = j * rows // down, (j + 1) * rows // down
            c0, c1 = i * columns // across, (i + 1) * columns // across
            # Cut where the texture is cut, so that its pattern continues from tile to tile.
            corner = panel.corner + panel.edge_s * (c0 / columns) + panel.edge_t * (r0 / rows)
            tiles.append(
                Panel(
                    corner,
                    panel.edge_s * ((c1 - c0) / columns),
                    panel.edge_t * ((r1 - r0) / rows),
                    np.ascontiguousarray(panel.texture[r0:r1, c0:c1]),
                    panel.brightness,
                )
            )
    return tiles


def _pyramid(texture: Texture) -> list[Texture]:
    """The texture and halves of it, each the mean of 2×2 of the one before."""
    levels = [texture]
    while min(levels[-1].shape) >= 8:
        rows, columns = levels[-1].shape
        levels.append(
            np.asarray(
                cv2.resize(levels[-1], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA),
                dtype=np.uint8,
            )
        )
    return levels
