"""What goes wrong in a world on purpose: wrong labels, ghosts, bursts, and wheels that slip.

Each kind has a generator of its own, spawned from the trial's outliers, and draws the same numbers whatever
the other kinds are set to: none of them changes a world in which it is off, where it draws nothing at all.
A detection that went wrong looks like any other: its covariance, its place among the others and its label
tell nothing. Which they were is for the truth alone to say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class OutlierRates:
    """How often; every kind is off by default."""

    wrong_association_fraction: float = 0.0
    """Share of the detections that measure another landmark of the same frame than their label says."""
    clutter_per_frame: float = 0.0
    """Mean number of ghosts a frame, each under the label of a landmark that is not in sight."""
    burst_probability: float = 0.0
    """Chance that a burst begins with a frame; all that is seen in it is a draw from the field of view."""
    burst_frames: int = 5
    """Frames that a burst lasts."""
    slip_probability: float = 0.0
    """Chance that the wheels slip in a step: they turn further than the robot moves."""
    slip_share: float = 0.5
    """How much further, as a share of the step."""


class OutlierDraws:
    """The misfortunes of one trial, frame by frame.

    Args:
        rates: how often.
        generator: the trial's, for outliers; it is only spawned from.
    """

    def __init__(self, rates: OutlierRates, generator: np.random.Generator) -> None:
        self._rates = rates
        self._labels, self._clutter, self._bursts, self._slips = generator.spawn(4)
        self._burst_left = 0

    def slips(self, steps: int) -> FloatArray:
        """By which factor the wheels turn further than the robot moves, (steps,)."""
        slipping = self._slips.random(steps) < self._rates.slip_probability
        return np.where(slipping, 1.0 + self._rates.slip_share, 1.0)

    @property
    def only_slips(self) -> bool:
        """Whether nothing but wheels can go wrong: no frame then needs to be asked about."""
        rates = self._rates
        return not (rates.wrong_association_fraction or rates.clutter_per_frame or rates.burst_probability)

    def in_burst(self) -> bool:
        """Whether the next frame lies in a burst; call it once a frame."""
        if not self._rates.burst_probability:
            return False
        begins = self._bursts.random() < self._rates.burst_probability
        if begins and not self._burst_left:
            self._burst_left = self._rates.burst_frames
        inside = self._burst_left > 0
        self._burst_left -= inside
        return inside

    def measured_instead(self, seen: BoolArray) -> IntArray:
        """Which landmark each label's detection is of, (L,): its own, or another of those ``seen`` (L,)."""
        of = np.arange(seen.size)
        if not self._rates.wrong_association_fraction:
            return of
        luck = self._labels.random((seen.size, 2))
        visible = np.flatnonzero(seen)
        if visible.size < 2:
            return of
        wrong = visible[luck[visible, 0] < self._rates.wrong_association_fraction]
        # One of the others, all alike: a step of 1 to m - 1 along the circle of those in sight.
        places = np.searchsorted(visible, wrong)
        steps = 1 + (luck[wrong, 1] * (visible.size - 1)).astype(np.int64)
        of[wrong] = visible[(places + steps) % visible.size]
        return of

    def ghosts(self, seen: BoolArray) -> BoolArray:
        """Under which labels of landmarks that are not ``seen`` (L,) something is reported, (L,)."""
        mask = np.zeros(seen.size, dtype=bool)
        if not self._rates.clutter_per_frame:
            return mask
        count = int(self._clutter.poisson(self._rates.clutter_per_frame))
        order = self._clutter.permutation(seen.size)
        mask[order[~seen[order]][:count]] = True
        return mask
