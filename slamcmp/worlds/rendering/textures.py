"""Grey textures with the corners that a feature detector lives on: posters, bricks, tiles, planks.

Every function takes a size in texels and a generator; brightness is 0 to 255.
"""

from __future__ import annotations

import string

import cv2
import numpy as np
from numpy.typing import NDArray

Texture = NDArray[np.uint8]
Field = NDArray[np.float32]


def plaster(rows: int, columns: int, generator: np.random.Generator, *, level: float = 165.0) -> Texture:
    """Uneven paint with stains and specks."""
    surface = level + 14.0 * _clouds(rows, columns, generator)
    _specks(surface, generator, count=rows * columns // 900, contrast=45.0)
    return _bytes(surface)


def bricks(rows: int, columns: int, generator: np.random.Generator, *, height: int = 30) -> Texture:
    """Courses of bricks, each with a brightness of its own, and pale joints."""
    surface = 175.0 + 6.0 * _clouds(rows, columns, generator)
    length, joint = 3 * height, max(2, height // 10)
    for course, top in enumerate(range(0, rows, height)):
        for left in range(-(course % 2) * length // 2, columns, length):
            box = np.s_[top + joint : top + height, max(left + joint, 0) : max(left + length, 0)]
            surface[box] += generator.uniform(-95.0, -35.0)
    _specks(surface, generator, count=rows * columns // 1500, contrast=35.0)
    return _bytes(surface)


def tiles(rows: int, columns: int, generator: np.random.Generator, *, side: int = 100) -> Texture:
    """Square tiles of varying brightness, some with a pattern, and dark joints."""
    surface = 130.0 + 10.0 * _clouds(rows, columns, generator)
    for top in range(0, rows, side):
        for left in range(0, columns, side):
            box = surface[top + 2 : top + side, left + 2 : left + side]
            box += generator.uniform(-40.0, 40.0)
            if generator.random() < 0.3 and min(box.shape) > side // 2:
                inset = side // 4
                box[inset:-inset, inset:-inset] += generator.choice([-50.0, 50.0])
    surface[::side] = surface[1::side] = 60.0
    surface[:, ::side] = surface[:, 1::side] = 60.0
    _specks(surface, generator, count=rows * columns // 1200, contrast=50.0)
    return _bytes(surface)


def planks(rows: int, columns: int, generator: np.random.Generator, *, width: int = 40) -> Texture:
    """Wooden boards with grain, nails and a stencilled label."""
    grain = _clouds(rows, max(columns // 8, 2), generator)
    surface = 120.0 + 22.0 * cv2.resize(grain, (columns, rows), interpolation=cv2.INTER_LINEAR)
    for top in range(0, rows, width):
        surface[top : top + width] += generator.uniform(-30.0, 30.0)
        surface[top : top + 2] = 40.0
        for left in (width // 3, columns - width // 3):
            cv2.circle(surface, (left, min(top + width // 2, rows - 1)), 3, 30.0, -1)
    boards = _bytes(surface)
    label = "".join(generator.choice(list(string.ascii_uppercase + string.digits), 4))
    scale = columns / 150.0
    cv2.putText(boards, label, (columns // 6, rows // 2), cv2.FONT_HERSHEY_DUPLEX, scale, (25,), 4)
    return boards


def poster(rows: int, columns: int, generator: np.random.Generator) -> Texture:
    """A sheet of random shapes over lines of text, with a white margin."""
    sheet = np.full((rows, columns), int(generator.integers(150, 236)), dtype=np.uint8)
    for _ in range(int(generator.integers(9, 16))):
        _shape(sheet[: int(0.72 * rows)], generator)
    line = max(rows // 16, 8)
    letters = np.array(list(string.ascii_letters + string.digits + "     "))
    for top in range(int(0.78 * rows), rows - line, int(1.4 * line)):
        text = "".join(generator.choice(letters, 2 * columns // line))
        cv2.putText(sheet, text, (line, top + line), cv2.FONT_HERSHEY_SIMPLEX, line / 22.0, (35,), 2)
    margin = max(3, rows // 40)
    sheet[:margin] = sheet[-margin:] = sheet[:, :margin] = sheet[:, -margin:] = 245
    return sheet


def _shape(sheet: Texture, generator: np.random.Generator) -> None:
    rows, columns = sheet.shape
    grey = int(generator.integers(15, 241))
    kind = int(generator.integers(4))
    x, y = int(generator.integers(columns)), int(generator.integers(rows))
    size = int(generator.integers(min(rows, columns) // 10, min(rows, columns) // 3))
    if kind == 0:
        cv2.rectangle(sheet, (x - size, y - size // 2), (x + size // 2, y + size), grey, -1)
    elif kind == 1:
        cv2.circle(sheet, (x, y), size, grey, -1)
    elif kind == 2:
        corners = np.array([x, y]) + generator.integers(-size, size + 1, (3, 2))
        cv2.fillPoly(sheet, [corners.astype(np.int32)], grey)
    else:
        cell = max(size // 4, 3)
        patch = sheet[max(y - size, 0) : y + size, max(x - size, 0) : x + size]
        across = np.arange(patch.shape[1]) // cell
        down = np.arange(patch.shape[0])[:, None] // cell
        patch[:] = np.where((across + down) % 2 == 0, grey, 255 - grey)


def _clouds(rows: int, columns: int, generator: np.random.Generator) -> Field:
    """Smooth noise of unit deviation: octaves from an eighth of the size down to two texels."""
    total = np.zeros((rows, columns), dtype=np.float32)
    cell, weight = max(rows, columns) / 8.0, 1.0
    while cell >= 2.0:
        coarse = generator.standard_normal((int(rows / cell) + 2, int(columns / cell) + 2))
        total += weight * cv2.resize(
            coarse.astype(np.float32), (columns, rows), interpolation=cv2.INTER_LINEAR
        )
        cell, weight = cell / 2.0, weight * 0.75
    normal: Field = (total - total.mean()) / max(float(total.std()), 1e-6)
    return normal


def _specks(surface: Field, generator: np.random.Generator, *, count: int, contrast: float) -> None:
    rows, columns = surface.shape
    for x, y, size, change in zip(
        generator.integers(0, columns, count).tolist(),
        generator.integers(0, rows, count).tolist(),
        generator.integers(2, 7, count).tolist(),
        generator.uniform(-contrast, contrast, count).tolist(),
        strict=True,
    ):
        surface[y : y + size, x : x + size] += change


def _bytes(surface: Field) -> Texture:
    return np.clip(np.rint(surface), 0, 255).astype(np.uint8)
