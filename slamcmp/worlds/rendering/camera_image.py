"""Draw a scene as a camera sees it: perspective, texture, motion blur; and its exact depth."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from slamcmp.types import FloatArray
from slamcmp.worlds.rendering.scene import Scene, faces_camera

Image = NDArray[np.float32]
Size = tuple[int, int]

_NEAR_M = 0.02
_SAMPLES = ((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25))
"""Where inside a pixel the four exposures of an image are taken: together they smooth its edges."""


def render_exposure(scene: Scene, poses: list[FloatArray], K: FloatArray, size: Size) -> Image:
    """Brightness (height, width), 0 to 255, averaged over camera poses ``T_world_camera`` (four at best).

    The poses are those during one exposure, evenly spaced in time: their mean is motion blur. Each is drawn
    at another place inside the pixel, so that four of them also make a pixel a mean over its area.
    """
    total: Image = np.zeros((size[1], size[0]), dtype=np.float32)
    for i, pose in enumerate(poses):
        total += _draw(scene, pose, K, size, _SAMPLES[i % len(_SAMPLES)])
    total /= len(poses)
    return total


def render_depth(scene: Scene, T_world_camera: FloatArray, K: FloatArray, size: Size) -> Image:
    """Depth (height, width) [m] along the optical axis at the pixels' centres; 0 where nothing is seen."""
    nearest = np.zeros((size[1], size[0]), dtype=np.float32)
    for view in _views(scene, T_world_camera, K, size, (0.0, 0.0)):
        inverse_depth, hit = _cover(view)
        part = nearest[view[1], view[2]]
        np.copyto(part, inverse_depth, where=hit & (inverse_depth > part))
    return np.divide(1.0, nearest, out=np.zeros_like(nearest), where=nearest > 0)


_View = tuple[int, slice, slice, FloatArray]
"""A tile, the rows and columns that it may cover, and G from (column, row, 1) of that part to w."""


def _draw(scene: Scene, pose: FloatArray, K: FloatArray, size: Size, sample: tuple[float, float]) -> Image:
    image = np.zeros((size[1], size[0]), dtype=np.float32)
    nearest = np.zeros_like(image)
    for view in _views(scene, pose, K, size, sample):
        tile, rows, columns, G = view
        inverse_depth, hit = _cover(view)
        part = nearest[rows, columns]
        hit &= inverse_depth > part
        if not hit.any():
            continue
        np.copyto(part, inverse_depth, where=hit)
        drawn = _warp(scene.pyramids[tile], G, hit.shape)
        np.copyto(image[rows, columns], drawn * np.float32(scene.brightness[tile]), where=hit)
    return image


def _views(
    scene: Scene, pose: FloatArray, K: FloatArray, size: Size, sample: tuple[float, float]
) -> Iterator[_View]:
    A = scene.in_camera(pose)
    for tile in np.flatnonzero(faces_camera(A)):
        outline = _outline(A[tile], K)
        if outline is None:
            continue
        # One pixel more than the outline: the samples lie beside the centres.
        low = np.maximum(np.floor(outline.min(axis=0)) - 1, 0).astype(int)
        high = np.minimum(np.ceil(outline.max(axis=0)) + 2, size).astype(int)
        if (low >= high).any():
            continue
        G = np.linalg.inv(K @ A[tile])
        shift = np.array([[1.0, 0.0, low[0] + sample[0]], [0.0, 1.0, low[1] + sample[1]], [0.0, 0.0, 1.0]])
        yield int(tile), slice(low[1], high[1]), slice(low[0], high[0]), G @ shift


def _cover(view: _View) -> tuple[Image, NDArray[np.bool_]]:
    """Inverse depth over a view's part of the image, and where the tile is hit."""
    _, rows, columns, G = view
    across = np.arange(columns.stop - columns.start, dtype=np.float64)
    down = np.arange(rows.stop - rows.start, dtype=np.float64)[:, None]
    w0, w1, w2 = (
        (row[0] * across).astype(np.float32) + (row[1] * down + row[2]).astype(np.float32) for row in G
    )
    hit = (w0 >= 0) & (w0 <= w2) & (w1 >= 0) & (w1 <= w2)
    return w2, hit


def _warp(pyramid: list[NDArray[np.uint8]], G: FloatArray, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """The tile's texture over its part of the image, from the level with about one texel a pixel."""
    rows, columns = pyramid[0].shape
    centre = G @ [0.5 * shape[1], 0.5 * shape[0], 1.0]
    # Texels a pixel, as a side: the root of the area's factor, which for a homography is det / w³.
    if centre[2] > 0:
        texels = math.sqrt(abs(np.linalg.det(G)) / centre[2] ** 3 * rows * columns)
        level = min(max(math.floor(math.log2(max(texels, 1e-9)) + 0.5), 0), len(pyramid) - 1)
    else:
        level = 0
    texture = pyramid[level]
    height, width = texture.shape
    to_texel = np.array([[width, 0.0, -0.5], [0.0, height, -0.5], [0.0, 0.0, 1.0]]) @ G
    return np.asarray(
        cv2.warpPerspective(
            texture,
            to_texel,
            (shape[1], shape[0]),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=np.uint8,
    )


def _outline(A: FloatArray, K: FloatArray) -> FloatArray | None:
    """Pixels (n, 2) of the tile's outline, cut off just before the camera; None if it lies behind."""
    edge_s, edge_t, corner = A.T
    ring = [corner, corner + edge_s, corner + edge_s + edge_t, corner + edge_t]
    visible = []
    for here, there in zip(ring, ring[1:] + ring[:1], strict=True):
        if here[2] >= _NEAR_M:
            visible.append(here)
        if (here[2] >= _NEAR_M) != (there[2] >= _NEAR_M):
            share = (_NEAR_M - here[2]) / (there[2] - here[2])
            visible.append(here + share * (there - here))
    if not visible:
        return None
    seen = np.stack(visible) @ K.T
    pixels: FloatArray = seen[:, :2] / seen[:, 2:]
    return pixels
