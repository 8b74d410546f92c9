"""From an error to a share of the points, and from any answer to arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.types import FloatArray


def log_linear(error: float, full: float, zero: float) -> float:
    """1 up to ``full``, 0 from ``zero`` on, in between linear in the logarithm; 0 for what is no number."""
    if not math.isfinite(error) or error >= zero:
        return 0.0
    if error <= full:
        return 1.0
    return math.log(zero / error) / math.log(zero / full)


def as_array(answer: Any, shape: tuple[int, ...], what: str) -> FloatArray:
    """An answer as numbers of the given shape.

    Raises:
        StudentError: it is something else; the message says what came and what is needed.
    """
    try:
        array = np.asarray(answer, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = None
    if answer is None:
        raise StudentError("TypeError", f"{what} is None; is a return statement missing?")
    if array is None:
        raise StudentError(
            "TypeError", f"{what} is {type(answer).__name__}; an array of shape {shape} is needed"
        )
    if array.shape != shape:
        raise StudentError("ValueError", f"{what} has shape {array.shape}; {shape} is needed")
    return array


def relative_error(answer: FloatArray, expected: FloatArray) -> float:
    """Largest difference over the largest expected entry; infinite where the answer is not finite."""
    if expected.size == 0:
        return 0.0
    if not np.isfinite(answer).all():
        return math.inf
    scale = float(np.abs(expected).max())
    return float(np.abs(answer - expected).max()) / (scale if scale > 0 else 1.0)


def leaves(answer: Any, path: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], Any]]:
    """Every array, number or text of an answer with its place in the tuples and dictionaries around it."""
    if isinstance(answer, list | tuple):
        for index, item in enumerate(answer):
            yield from leaves(item, (*path, index))
    elif isinstance(answer, dict):
        for key in sorted(answer):
            yield from leaves(answer[key], (*path, key))
    else:
        yield path, answer
