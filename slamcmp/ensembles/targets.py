"""Where an ensemble runs, and the program compiled for it."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Literal

from slamcmp.errors import UsageError

Target = Literal["cpu", "cuda"]
BODIES = "slamcmp.ensembles.kernels"
_choice: list[Target] = ["cpu"]


def chosen() -> Target:
    """What bodies are compiled for that are imported now."""
    return _choice[-1]


@functools.cache
def load(target: Target) -> ModuleType:
    """The module ``cpu_entry`` or ``cuda_entry``: the entry into the program compiled for that target.

    Raises:
        UsageError: numba is not installed; for "cuda" numba-cuda is not, or there is no GPU.
    """
    if importlib.util.find_spec("numba") is None:
        raise UsageError("an ensemble needs numba: pip install 'slamcmp[fast]'")
    if target == "cpu":
        return importlib.import_module(f"{BODIES}.cpu_entry")
    reason = why_no_gpu()
    if reason is not None:
        raise UsageError(f"no ensemble on a GPU: {reason}")
    with _fresh("cuda"):
        return importlib.import_module(f"{BODIES}.cuda_entry")


def why_no_gpu() -> str | None:
    """Why nothing can run on a GPU here; None where it can, numba's simulator included."""
    try:
        from numba import cuda

        if cuda.is_available():
            return None
    except Exception as error:  # whatever a driver that does not fit raises
        return f"numba's CUDA does not load: {error}"
    if importlib.util.find_spec("numba_cuda") is None:
        return "numba finds no GPU, and numba-cuda is not installed: pip install 'slamcmp[cuda]'"
    return "numba-cuda finds no GPU"


@contextlib.contextmanager
def _fresh(target: Target) -> Iterator[None]:
    """Import the bodies anew for a target, and leave those that were imported before in place."""
    kept = {name: module for name, module in sys.modules.items() if name.startswith(BODIES)}
    for name in kept:
        del sys.modules[name]
    _choice.append(target)
    try:
        yield
    finally:
        _choice.pop()
        for name in [name for name in sys.modules if name.startswith(BODIES)]:
            del sys.modules[name]
        sys.modules.update(kept)
