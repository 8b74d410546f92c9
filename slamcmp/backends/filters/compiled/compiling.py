"""How kernels are compiled: once on a machine, then read from a cache on disk."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba as nb

Function = TypeVar("Function", bound=Callable[..., Any])

# Frames are read-only and may be strided: one signature that takes them all is one compilation.
GIVEN = [nb.types.Array(nb.float64, dimensions, "A", readonly=True) for dimensions in range(4)]
GIVEN_NUMBERS = nb.types.Array(nb.int64, 1, "A", readonly=True)
OWN = [nb.types.Array(nb.float64, dimensions, "C") for dimensions in range(4)]
OWN_NUMBERS = nb.types.Array(nb.int64, 1, "C")


def compiled(*signature: Any) -> Callable[[Function], Function]:
    """numba's njit with IEEE division and fused multiply-adds, cached where numba finds a place to write.

    Without a signature the function is compiled into those that call it.
    """
    options = {"error_model": "numpy", "fastmath": {"contract"}}

    def compile_function(function: Function) -> Function:
        if not signature:
            inner: Function = nb.njit(**options)(function)
            return inner
        try:
            made = nb.njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            made = nb.njit(**options)(function)
        _know_by_all_sources(made)
        made.compile(*signature)
        made.disable_compile()
        entry: Function = made
        return entry

    return compile_function


def _know_by_all_sources(made: Any) -> None:
    """Numba knows what it has kept by the function's own file alone; a change in another has to count too."""
    kept: Any = getattr(getattr(made, "_cache", None), "_cache_file", None)
    if hasattr(kept, "_source_stamp"):
        kept._source_stamp = sources_digest()


@functools.cache
def sources_digest() -> str:
    """sha256 of the text of all kernels."""
    texts = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"".join(texts)).hexdigest()
