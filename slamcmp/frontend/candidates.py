"""Landmarks that may be ghosts: confirmed by k sightings within n frames, deleted otherwise.

One sighting may be of anything. A landmark is believed when it is seen again where it was expected; clutter
is not. Only frames in which something was detected count, for in others nothing could have been.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Sighting = tuple[int, int]
"""A frame and the row of one of its detections."""


@dataclass
class Candidate:
    """A landmark of the front end's own map, confirmed or not."""

    born: int
    """The number of frames with detections before it."""
    sightings: list[Sighting] = field(default_factory=list)
    name: int | None = None
    """Its id in the stream, once it is confirmed."""


class Candidates:
    """Who is on the map, row by row, and under which id.

    Args:
        sightings: k.
        frames: n, the one of the first sighting included.
    """

    def __init__(self, sightings: int, frames: int) -> None:
        self._sightings, self._frames = sightings, frames
        self.rows: list[Candidate] = []
        self._named = 0

    def add(self, frame: int, sighting: Sighting) -> Candidate:
        """A new one, with its first sighting in the ``frame``-th frame that has detections."""
        self.rows.append(Candidate(frame))
        self.see(self.rows[-1], sighting)
        return self.rows[-1]

    def see(self, candidate: Candidate, sighting: Sighting) -> None:
        """One more sighting, which may confirm it."""
        candidate.sightings.append(sighting)
        if candidate.name is None and len(candidate.sightings) >= self._sightings:
            candidate.name = self._named
            self._named += 1

    def ghosts(self, frame: int) -> list[int]:
        """Rows of those that were not confirmed in time, last row first; they are taken off the list."""
        gone = [
            row
            for row, each in enumerate(self.rows)
            if each.name is None and frame - each.born + 1 >= self._frames
        ][::-1]
        for row in gone:
            del self.rows[row]
        return gone
