"""Which landmarks leave the state of a smoother with a window when it holds too many for long runs.

Each frame of a window costs with the landmarks in it, seen or not: a robot that goes on and on has to let go
of some, or never ends. Those go that it saw longest ago, with a marginal prior on what stays; seen again they
start anew. Their loops are not closed: who needs that keeps every one, and pays for it.
"""

from __future__ import annotations

from collections.abc import Collection

from slamcmp.types import Frame

MOST_LANDMARKS = 200
"""In the state, by default: above it a frame of the own window takes more than tens of milliseconds."""


class RecentLandmarks:
    """When each landmark was seen last."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._last_seen: dict[int, int] = {}

    def see(self, frame: Frame) -> None:
        """Take in what a frame sees."""
        seen = frame.ids.tolist()
        if frame.entries is not None:
            seen += frame.entries.ids.tolist()
        for landmark_id in seen:
            self._last_seen[landmark_id] = frame.k

    def too_many(self, held: Collection[int], *, unseen_since: int) -> list[int]:
        """Of the landmarks in the state, those that leave it: the longest unseen of all above the number.

        A landmark that was seen in frame ``unseen_since`` or later stays, however many there are.
        """
        excess = len(held) - self._most
        if excess <= 0:
            return []
        old = [i for i in held if self._last_seen.get(i, -1) < unseen_since]
        leaving = sorted(old, key=lambda i: self._last_seen.get(i, -1))[:excess]
        for landmark_id in leaving:
            self._last_seen.pop(landmark_id, None)
        return leaving
