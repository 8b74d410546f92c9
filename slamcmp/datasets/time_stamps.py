"""Time stamps in any unit, as seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from slamcmp.errors import DataError
from slamcmp.types import FloatArray

TimeUnit = Literal["auto", "s", "ms", "us", "ns"]

SECONDS: dict[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_SINCE_1970 = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))
"""From which size on stamps since 1970 are of this unit: 1e11 s is the year 5138, 1e11 ms 1973."""
_STEPS = (("ms", 10.0, 1e3), ("s", 0.0, 10.0), ("us", 1e4, 1e6), ("ns", 1e7, 1e9))
"""Median steps: sensors run at 1 to 100 Hz; what is under 10 is taken for seconds."""


def in_seconds(
    path: Path, t: FloatArray, unit: TimeUnit, *, parameter: str, told: list[str] | None = None
) -> FloatArray:
    """The stamps t (K,) of a file in seconds.

    ``auto`` tells the unit by their size where they count from 1970, else by their steps; what it finds, if
    it is not seconds, is appended to ``told``.

    Raises:
        DataError: the unit cannot be told; the message names the ``parameter`` that says it.
    """
    if unit == "auto":
        unit = _unit_of(path, t, parameter)
        if unit != "s" and told is not None:
            told.append(f"{path.name}: time stamps are taken for {_NAMES[unit]} ({parameter})")
    return t if unit == "s" else t * SECONDS[unit]


def _unit_of(path: Path, t: FloatArray, parameter: str) -> TimeUnit:
    if t.size < 2:
        return "s"
    largest = float(np.abs(t).max())
    for unit, least in _SINCE_1970:
        if largest >= least:
            return unit  # type: ignore[return-value]
    step = float(np.median(np.abs(np.diff(t))))
    for unit, low, high in _STEPS:
        if low <= step <= high:
            return unit  # type: ignore[return-value]
    raise DataError(
        f"{path}: time stamps {step:g} apart, which may be of more than one unit; set {parameter} to "
        "s, ms, us or ns"
    )
