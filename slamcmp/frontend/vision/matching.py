"""Match binary descriptors: nearest neighbour, mutual and clearly better than the second best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcmp.types import BoolArray, IntArray

_NEVER = 0xFFFF


@dataclass(frozen=True)
class Matches:
    """Pairs of features that look alike, with the number lost at each test."""

    pairs: IntArray
    """(m, 2): index in the first image, index in the second."""
    distance: IntArray
    """Hamming distance, (m,) bits."""
    tried: int
    """Features of the first image that had any candidate."""
    not_mutual: int
    ambiguous: int


def match_descriptors(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    *,
    ratio: float = 0.8,
    mutual: bool = True,
    allowed: BoolArray | None = None,
) -> Matches:
    """Match descriptors (n, bytes) of one image to (m, bytes) of another by Hamming distance.

    Args:
        first: bits packed into bytes, as ORB gives them; the number of bytes is a multiple of 8.
        second: the same of the other image.
        ratio: a match stays if it is closer than this share of the second best (Lowe 2004, section 7.1);
            1 switches the test off.
        mutual: a match stays only if it is also the best one seen from the other image.
        allowed: (n, m) mask of pairs that may match, for instance near a predicted place; None: all.
    """
    distance = _allowed_distances(first, second, allowed)
    rows = np.arange(len(first))
    if distance.size == 0:
        return Matches(np.empty((0, 2), np.int64), np.empty(0, np.int64), 0, 0, 0)
    best = distance.argmin(axis=1)
    closest = distance[rows, best].astype(np.int64)
    passed = closest < _NEVER
    tried = int(passed.sum())
    if mutual:
        passed &= distance.argmin(axis=0)[best] == rows
    after_mutual = int(passed.sum())
    if ratio < 1.0 and distance.shape[1] > 1:
        distance[rows, best] = _NEVER
        passed &= closest < ratio * distance.min(axis=1)
    kept = np.flatnonzero(passed)
    return Matches(
        np.stack([kept, best[kept]], axis=-1).astype(np.int64),
        closest[kept],
        tried,
        tried - after_mutual,
        after_mutual - kept.size,
    )


def match_candidates(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    here: IntArray,
    there: IntArray,
    *,
    ratio: float = 0.8,
) -> Matches:
    """:func:`match_descriptors` where few pairs may match, without a table of all.

    The pairs are ``here`` (p,) in the first image, sorted, and ``there`` (p,) in the second: near predicted
    places one in thirty.
    """
    if not here.size:
        return Matches(np.empty((0, 2), np.int64), np.empty(0, np.int64), 0, 0, 0)
    a = np.ascontiguousarray(first).view(np.uint64).take(here, axis=0)
    b = np.ascontiguousarray(second).view(np.uint64).take(there, axis=0)
    distance = np.bitwise_count(a ^ b).sum(axis=1, dtype=np.int64)
    begins = np.concatenate([[0], (here[1:] != here[:-1]).nonzero()[0] + 1])
    # Distance and index in one number: of equal distances the first index is the smaller.
    ranked = distance * len(second) + there
    closest, best = np.divmod(np.minimum.reduceat(ranked, begins), len(second))
    rows = here[begins]
    wanted_by = np.full(len(second), np.iinfo(np.int64).max)
    np.minimum.at(wanted_by, there, distance * len(first) + here)
    passed = wanted_by[best] % len(first) == rows
    after_mutual = int(passed.sum())
    if ratio < 1.0:
        lengths = np.diff(begins, append=here.size)
        others = np.where(there == np.repeat(best, lengths), _NEVER, distance)
        passed &= closest < ratio * np.minimum.reduceat(others, begins)
    kept = passed.nonzero()[0]
    return Matches(
        np.stack([rows[kept], best[kept]], axis=-1),
        closest[kept],
        len(rows),
        len(rows) - after_mutual,
        after_mutual - kept.size,
    )


def hamming_distances(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """How many bits differ, for every pair, (n, m).

    One table serves the test in both directions, where a matcher would go through all pairs twice.
    """
    a = np.ascontiguousarray(first).view(np.uint64)
    b = np.ascontiguousarray(second).view(np.uint64)
    distance = np.zeros((len(a), len(b)), dtype=np.uint16)
    for word in range(a.shape[1]):
        distance += np.bitwise_count(a[:, word, None] ^ b[None, :, word])
    return distance


def _allowed_distances(
    first: NDArray[np.uint8], second: NDArray[np.uint8], allowed: BoolArray | None
) -> NDArray[np.uint16]:
    """Hamming distances where they are allowed, and an impossible one elsewhere, (n, m)."""
    if allowed is None:
        return hamming_distances(first, second)
    pairs = np.flatnonzero(allowed)
    if pairs.size > 0.1 * allowed.size:
        distance = hamming_distances(first, second)
        distance[~allowed] = _NEVER
        return distance
    # Near a predicted place there are few: pair by pair is then faster than all of them.
    here, there = np.divmod(pairs, len(second))
    a = np.ascontiguousarray(first).view(np.uint64)[here]
    b = np.ascontiguousarray(second).view(np.uint64)[there]
    distance = np.full(allowed.shape, _NEVER, dtype=np.uint16)
    np.put(distance, pairs, np.bitwise_count(a ^ b).sum(axis=1, dtype=np.uint16))
    return distance
