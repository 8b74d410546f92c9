"""Counter-based noise: any draw of any run by its number, in any order, on any machine.

Philox4x32-10 (Salmon, Moraes, Dror and Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3"): ten rounds
of multiplications over a counter of 128 bits under a key of 64. Its four words make two uniform numbers of
53 bits, and those two normal ones by Box and Muller (1958). The key is the run's seed; the counter is the
frame, what is drawn, and which of these.
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.ensembles.kernels.target import body

PRIOR, PART, SLIP, SENSOR, MAP = 0, 1, 2, 3, 4
"""What is drawn: the start, the noise of a part of a step, side slip, a measurement, a landmark's place."""
_WORD = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_LOW = np.uint64(5)
_MIDDLE = np.uint64(6)
_SHIFT = np.uint64(26)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)


@body
def philox(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Four words of 32 bits from a counter of four and a key of two."""
    for _ in range(10):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _HALF) ^ c1 ^ k0, p1 & _WORD, (p0 >> _HALF) ^ c3 ^ k1, p0 & _WORD
        k0, k1 = (k0 + _W0) & _WORD, (k1 + _W1) & _WORD
    return c0, c1, c2, c3


@body
def uniforms(seed: int, frame: int, what: int, which: int) -> tuple[float, float]:
    """Two independent numbers in (0, 1)."""
    key = np.uint64(seed)
    a, b, c, d = philox(
        np.uint64(frame),
        np.uint64(what),
        np.uint64(which),
        np.uint64(0),
        key & _WORD,
        (key >> _HALF) & _WORD,
    )
    scale = 1.0 / 9007199254740992.0
    u = float((a >> _LOW) << _SHIFT | (b >> _MIDDLE))
    v = float((c >> _LOW) << _SHIFT | (d >> _MIDDLE))
    # Half a step away from 0, whose logarithm does not exist.
    return (u + 0.5) * scale, (v + 0.5) * scale


@body
def normals(seed: int, frame: int, what: int, which: int) -> tuple[float, float]:
    """Two independent standard normal numbers."""
    u, v = uniforms(seed, frame, what, which)
    r = math.sqrt(-2.0 * math.log(u))
    return r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v)
