"""All frames of a stream as one array a field: what is asked of each frame is asked of all at once.

Thousands of small arrays cost more to look at than to fill; a stream of 2500 planar frames has 12 500.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from slamcmp.types.arrays import FloatArray, IntArray


class Step(Protocol):
    """What is taken of a frame."""

    @property
    def k(self) -> int: ...
    @property
    def t(self) -> float: ...
    @property
    def T_prev_body(self) -> FloatArray: ...
    @property
    def Q(self) -> FloatArray: ...
    @property
    def ids(self) -> IntArray: ...
    @property
    def z(self) -> FloatArray: ...
    @property
    def R(self) -> FloatArray: ...


@dataclass(frozen=True)
class Columns:
    """K frames and their M observations, frame after frame."""

    k: IntArray
    """(K,)."""
    t: FloatArray
    """(K,) [s]."""
    T_prev_body: FloatArray
    """(K, n+1, n+1)."""
    Q: FloatArray
    """(K, p, p)."""
    sizes: IntArray
    """Observations of each frame, (K,)."""
    ids: IntArray
    """(M,)."""
    z: FloatArray
    """(M, d)."""
    R: FloatArray
    """(M, d, d)."""

    def sees_one_twice(self) -> bool:
        """Whether an id stands twice in a frame."""
        frames = np.repeat(np.arange(self.sizes.size), self.sizes)
        order = np.lexsort((self.ids, frames))
        frames, ids = frames[order], self.ids[order]
        return bool(((np.diff(frames) == 0) & (np.diff(ids) == 0)).any())

    def content(self) -> bytes:
        """Frame after frame ``k``, the number of observations, t, T_prev_body, Q, ids, z and R.

        Each a little-endian word of eight bytes, matrices by rows: what a digest is taken of.
        """
        K, d = self.sizes.size, self.z.shape[1]
        head = np.concatenate(
            [
                np.stack([self.k, self.sizes], axis=1).astype("<i8"),
                *(_words(part.reshape(K, -1)) for part in (self.t, self.T_prev_body, self.Q)),
            ],
            axis=1,
        )
        width = head.shape[1]
        # An observation's words are its id, d of z and d² of R, but ids, z and R of a frame stand apart.
        lengths = width + self.sizes * (1 + d + d * d)
        starts = np.cumsum(lengths) - lengths
        words = np.empty(int(lengths.sum()), dtype="<i8")
        words[starts[:, None] + np.arange(width)] = head
        frames = np.repeat(np.arange(K), self.sizes)
        place = np.arange(self.ids.size) - (np.cumsum(self.sizes) - self.sizes)[frames]
        behind = starts[frames] + width
        words[behind + place] = self.ids.astype("<i8")
        behind += self.sizes[frames]
        words[(behind + place * d)[:, None] + np.arange(d)] = _words(self.z)
        behind += self.sizes[frames] * d
        words[(behind + place * d * d)[:, None] + np.arange(d * d)] = _words(self.R.reshape(-1, d * d))
        return words.tobytes()


def columns_of(frames: Sequence[Step]) -> Columns:
    """The columns of frames whose arrays have one shape each, but for the number of observations."""
    K = len(frames)
    first = frames[0]
    return Columns(
        np.fromiter((frame.k for frame in frames), dtype=np.int64, count=K),
        np.fromiter((frame.t for frame in frames), dtype=np.float64, count=K),
        np.concatenate([frame.T_prev_body for frame in frames]).reshape(K, *first.T_prev_body.shape),
        np.concatenate([frame.Q for frame in frames]).reshape(K, *first.Q.shape),
        np.fromiter((frame.ids.size for frame in frames), dtype=np.int64, count=K),
        np.concatenate([frame.ids for frame in frames]),
        np.concatenate([frame.z for frame in frames]),
        np.concatenate([frame.R for frame in frames]),
    )


def parts(column: NDArray[Any], sizes: IntArray) -> Iterator[NDArray[Any]]:
    """The rows of a column, so many for each frame, as views."""
    end = 0
    for size in sizes.tolist():
        start, end = end, end + size
        yield column[start:end]


def own_parts(column: NDArray[Any], sizes: IntArray) -> Iterator[NDArray[Any]]:
    """The same as copies that cannot be written to: a view's base is the whole column, and the future."""
    for part in parts(column, sizes):
        yield _alone(part)


def own_rows(column: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Each row as a copy that cannot be written to."""
    return map(_alone, column)


def _alone(part: NDArray[Any]) -> NDArray[Any]:
    own = part.copy()
    own.flags.writeable = False
    return own


def _words(values: FloatArray) -> NDArray[np.int64]:
    """Rows of numbers as the words of eight bytes that hold them."""
    return np.ascontiguousarray(values, dtype="<f8").view("<i8")
