"""The program on a GPU: the threads of a block share one run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import cuda

from slamcmp.types.arrays import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])


def body(function: Function) -> Function:
    """A device function."""
    made: Function = cuda.jit(device=True)(function)
    return made


@body
def lane() -> int:
    """The thread's number."""
    number: int = cuda.threadIdx.x
    return number


@body
def lanes() -> int:
    """The number of threads."""
    number: int = cuda.blockDim.x
    return number


@body
def sync() -> None:
    """Wait for the other threads of the block."""
    cuda.syncthreads()


@body
def add(sums: FloatArray, i: int, j: int, value: float) -> None:
    """Blocks add to the same sums."""
    cuda.atomic.add(sums, (i, j), value)
