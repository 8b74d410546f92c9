"""Joint compatibility branch and bound (Neira and Tardós 2001, figure 4).

A hypothesis pairs each detection with one landmark or none. Its pairs must agree with each other, not only
each with its landmark: the squared Mahalanobis distance of all innovations together, with the correlations
that one pose gives them, must pass the gate of its degrees of freedom. Wanted is the hypothesis of most
pairs; among those the one of the least distance.
"""

from __future__ import annotations

import numpy as np

from slamcmp.association.compatibility import Innovations, JointDistance, as_rows, gate
from slamcmp.types import IntArray

MOST_NODES = 20_000
"""Of the tree that are looked at for one frame; what is best by then is the answer."""


def joint_compatibility(innovations: Innovations, probability: float) -> IntArray:
    """The landmark's row of each detection, (m,), or NOBODY."""
    return as_rows(_Search(innovations, probability).best(), innovations.y.shape[0])


class _Search:
    """Depth first; landmarks of a detection nearest first, so that a good hypothesis is found soon."""

    def __init__(self, innovations: Innovations, probability: float) -> None:
        distances = innovations.squared_distances
        choices = [
            np.flatnonzero(row)[np.argsort(distances[i, row], kind="stable")].tolist()
            for i, row in enumerate(innovations.compatible(probability))
        ]
        # Detections of few choices first: the tree is narrow where its bound knows least.
        self._order = sorted(
            (i for i in range(len(choices)) if choices[i]),
            key=lambda i: (len(choices[i]), distances[i, choices[i][0]]),
        )
        self._choices = choices
        self._gates = [gate(k * innovations.dim, probability) for k in range(1, len(self._order) + 1)]
        self._joint = JointDistance(innovations)
        self._best: list[tuple[int, int]] = []
        self._best_distance = 0.0
        self._nodes = 0

    def best(self) -> list[tuple[int, int]]:
        self._descend(0)
        return self._best

    def _descend(self, level: int) -> None:
        self._nodes += 1
        joint = self._joint
        if self._beats(len(joint.pairs)):
            self._best, self._best_distance = list(joint.pairs), joint.distances[-1]
        if level == len(self._order):
            return
        row, left = self._order[level], len(self._order) - level
        taken = {column for _, column in joint.pairs}
        for column in self._choices[row]:
            if column in taken or not self._promises(len(joint.pairs) + left):
                continue
            joint.push((row, column))
            if joint.distances[-1] <= self._gates[len(joint.pairs) - 1]:
                self._descend(level + 1)
            joint.pop()
        if self._promises(len(joint.pairs) + left - 1):
            self._descend(level + 1)

    def _beats(self, pairs: int) -> bool:
        """Whether so many pairs, at the distance so far, are better than the best; it only grows below."""
        most = len(self._best)
        return pairs > most or (pairs == most and self._joint.distances[-1] < self._best_distance)

    def _promises(self, reachable: int) -> bool:
        return self._nodes < MOST_NODES and self._beats(reachable)
