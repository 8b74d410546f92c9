"""How probable each association is, over all that are jointly possible.

A hypothesis pairs each detection with one landmark or with none. Its weight is the joint density of its
innovations, times a density of what is not on the map for each detection without a landmark: detections of
clutter and of landmarks never seen are that frequent, anywhere. Normalised, the weights are probabilities;
summed over the hypotheses that agree about one detection, that detection's own (Bar-Shalom's joint
probabilistic association does the same; here nothing is averaged, only told). A detection with one landmark
in its gate, which no other detection has in its own, is taken for that landmark's in every hypothesis.
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.association.compatibility import Innovations, JointDistance
from slamcmp.types import FloatArray

MOST_NODES = 4_000
"""Hypotheses that are looked at; the rest is left out of the sum, nearest first."""


def marginals(innovations: Innovations, probability: float, unknown: float) -> FloatArray:
    """Of each detection the probability of each landmark, and last of none of them, (m, L + 1).

    Args:
        innovations: of the detections with the landmarks.
        probability: of the gate that each pair alone has to pass.
        unknown: density of what is not on the map, per unit of measurement space.
    """
    return _Sum(innovations, probability, unknown).marginals()


class _Sum:
    def __init__(self, innovations: Innovations, probability: float, unknown: float) -> None:
        self._innovations = innovations
        distances = innovations.squared_distances
        self._choices = [
            np.flatnonzero(row)[np.argsort(distances[i, row], kind="stable")].tolist()
            for i, row in enumerate(innovations.compatible(probability))
        ]
        wanted = np.bincount([column for row in self._choices for column in row], minlength=1)
        self._plain = [i for i, row in enumerate(self._choices) if len(row) == 1 and wanted[row[0]] == 1]
        open_rows = (i for i in range(len(self._choices)) if i not in self._plain)
        self._order = sorted(open_rows, key=lambda i: len(self._choices[i]))
        self._log_unknown = math.log(unknown)
        self._log_unit = 0.5 * innovations.dim * math.log(2.0 * math.pi)
        self._joint = JointDistance(innovations)
        self._base = 0
        self._found: list[tuple[float, list[tuple[int, int]]]] = []

    def marginals(self) -> FloatArray:
        count, landmarks = self._innovations.y.shape[:2]
        table = np.zeros((count, landmarks + 1))
        for row in self._plain:
            column = self._choices[row][0]
            table[row, column] = self._against_nobody(row, column)
            table[row, landmarks] = 1.0 - table[row, column]
        if not self._order:
            return table
        for row in self._plain:
            self._joint.push((row, self._choices[row][0]))
        self._base = len(self._joint.pairs)
        self._descend(0)
        logs = np.array([weight for weight, _ in self._found])
        weights = np.exp(logs - logs.max())
        for weight, (_, pairs) in zip(weights / weights.sum(), self._found, strict=True):
            table[self._order, landmarks] += weight
            for row, column in pairs[self._base :]:
                table[row, column] += weight
                table[row, landmarks] -= weight
        return table

    def _against_nobody(self, row: int, column: int) -> float:
        """The probability of a pair whose only rival is that the detection is of no landmark."""
        exponent = self._innovations.squared_distances[row, column]
        exponent += self._innovations.log_determinants[row, column]
        return float(1.0 / (1.0 + np.exp(self._log_unknown + self._log_unit + 0.5 * exponent)))

    def _descend(self, level: int) -> None:
        joint = self._joint
        if level == len(self._order):
            alone = len(self._order) + self._base - len(joint.pairs)
            density = -0.5 * (joint.distances[-1] + joint.log_determinants[-1])
            weight = density - len(joint.pairs) * self._log_unit + alone * self._log_unknown
            self._found.append((weight, list(joint.pairs)))
            return
        row = self._order[level]
        taken = {column for _, column in joint.pairs}
        for column in self._choices[row]:
            if column not in taken and len(self._found) < MOST_NODES:
                joint.push((row, column))
                self._descend(level + 1)
                joint.pop()
        if len(self._found) < MOST_NODES or not self._found:
            self._descend(level + 1)
