"""The two furnished buildings: a room and a corridor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slamcmp.types import FloatArray
from slamcmp.worlds.rendering import textures
from slamcmp.worlds.rendering.scene import Panel, Scene

Paint = Callable[[int, int, np.random.Generator], NDArray[np.uint8]]

_WALL_TEXEL_M = 0.005
_POSTER_TEXEL_M = 0.0025
_HEIGHT_M = 2.8
_AXES = np.eye(3)


def room(low: FloatArray, high: FloatArray, generator: np.random.Generator) -> Scene:
    """Four walls with posters about the floor from ``low`` to ``high`` (2,) [m], crates along the walls."""
    panels = _shell(low, high, generator, [textures.bricks, textures.plaster] * 2)
    panels += _posters(low, high, generator, spacing_m=1.15)
    for x in np.arange(low[0] + 0.9, high[0] - 0.8, 2.3):
        for y in (low[1] + 0.35, high[1] - 0.35):
            if generator.random() < 0.75:
                panels += _crate(np.array([x + generator.uniform(-0.4, 0.4), y]), generator)
    return Scene(panels)


def corridor(low: FloatArray, high: FloatArray, generator: np.random.Generator) -> Scene:
    """A long passage from ``low`` to ``high`` (2,) [m] with posters, and pilasters that stand out."""
    panels = _shell(low, high, generator, [textures.plaster, textures.bricks] * 2)
    panels += _posters(low, high, generator, spacing_m=1.4)
    for x in np.arange(low[0] + 2.0, high[0] - 1.0, 4.0):
        for y in (low[1], high[1]):
            panels += _pilaster(np.array([x + generator.uniform(-0.5, 0.5), y]), generator)
    return Scene(panels)


def _shell(
    low: FloatArray, high: FloatArray, generator: np.random.Generator, paints: list[Paint]
) -> list[Panel]:
    """Floor, ceiling and four walls, all seen from inside."""
    (x0, y0), (x1, y1) = low, high
    ring = [np.array([x0, y0]), np.array([x1, y0]), np.array([x1, y1]), np.array([x0, y1])]
    panels = []
    for i, paint in enumerate(paints):
        # Seen from inside, a wall's left end is the one further round the ring (counter-clockwise).
        left, right = ring[(i + 1) % 4], ring[i]
        corner = np.array([*left, _HEIGHT_M])
        across = np.array([*(right - left), 0.0])
        panels.append(_painted(corner, across, -_HEIGHT_M * _AXES[2], paint, generator, 1.0 - 0.07 * i))
    width, depth = x1 - x0, y1 - y0
    panels.append(
        _painted(
            np.array([x0, y1, 0.0]), width * _AXES[0], -depth * _AXES[1], textures.tiles, generator, 0.85
        )
    )
    panels.append(
        _painted(
            np.array([x0, y0, _HEIGHT_M]),
            width * _AXES[0],
            depth * _AXES[1],
            textures.plaster,
            generator,
            1.1,
        )
    )
    return panels


def _posters(
    low: FloatArray, high: FloatArray, generator: np.random.Generator, *, spacing_m: float
) -> list[Panel]:
    """Boards a finger's breadth in front of the walls, at changing distances, for they may overlap."""
    panels = []
    for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1)):
        # Walls along x stand at y = low or high, and the other way round.
        length = high[axis] - low[axis]
        inward = 1.0 if side == 0 else -1.0
        for i, along in enumerate(np.arange(low[axis] + 0.8, low[axis] + length - 0.8, spacing_m)):
            width, height = generator.uniform(0.5, 0.95), generator.uniform(0.6, 1.1)
            centre = np.zeros(3)
            centre[axis] = along + generator.uniform(-0.25, 0.25)
            centre[1 - axis] = (low, high)[side][1 - axis] + (0.01 + 0.01 * (i % 3)) * inward
            centre[2] = generator.uniform(1.0, 1.7)
            normal = inward * _AXES[1 - axis]
            right = np.cross(_AXES[2], normal)
            corner = centre - 0.5 * width * right + 0.5 * height * _AXES[2]
            panels.append(
                Panel(
                    corner,
                    width * right,
                    -height * _AXES[2],
                    textures.poster(
                        round(height / _POSTER_TEXEL_M), round(width / _POSTER_TEXEL_M), generator
                    ),
                )
            )
    return panels


def _crate(position: FloatArray, generator: np.random.Generator) -> list[Panel]:
    """A wooden box on the floor: its four sides and its lid."""
    size = generator.uniform([0.5, 0.4, 0.4], [0.8, 0.55, 1.0])
    return _box(
        np.array([*position, 0.0]) - [size[0] / 2, size[1] / 2, 0.0], size, textures.planks, generator
    )


def _pilaster(position: FloatArray, generator: np.random.Generator) -> list[Panel]:
    """A pillar from floor to ceiling, half inside the wall."""
    size = np.array([0.4, 0.4, _HEIGHT_M])
    return _box(
        np.array([*position, 0.0]) - [size[0] / 2, size[1] / 2, 0.0], size, textures.bricks, generator
    )


def _box(low: FloatArray, size: FloatArray, paint: Paint, generator: np.random.Generator) -> list[Panel]:
    x, y, z = (size[i] * _AXES[i] for i in range(3))
    top = low + z
    faces = [
        (top, x, -z, 0.95),
        (top + x, y, -z, 0.8),
        (top + x + y, -x, -z, 0.9),
        (top + y, -y, -z, 0.75),
        (top + y, x, -y, 1.05),
    ]
    return [_painted(corner, s, t, paint, generator, light) for corner, s, t, light in faces]


def _painted(
    corner: FloatArray,
    edge_s: FloatArray,
    edge_t: FloatArray,
    paint: Paint,
    generator: np.random.Generator,
    brightness: float,
) -> Panel:
    rows, columns = (max(8, round(float(np.linalg.norm(e)) / _WALL_TEXEL_M)) for e in (edge_t, edge_s))
    return Panel(corner, edge_s, edge_t, paint(rows, columns, generator), brightness)
