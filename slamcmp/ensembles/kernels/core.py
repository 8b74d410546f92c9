"""The program on one core: a block of a single thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba as nb

from slamcmp.types.arrays import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])


def body(function: Function) -> Function:
    """numba's njit with IEEE division and fused multiply-adds, compiled into what calls it."""
    made: Function = nb.njit(error_model="numpy", fastmath={"contract"})(function)
    return made


@body
def lane() -> int:
    """The only one."""
    return 0


@body
def lanes() -> int:
    """One."""
    return 1


@body
def sync() -> None:
    """Nobody to wait for."""


@body
def add(sums: FloatArray, i: int, j: int, value: float) -> None:
    """Every core has sums of its own."""
    sums[i, j] += value
