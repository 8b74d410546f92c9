"""Association pair by pair: the nearest neighbour, and the likeliest assignment.

Both look at each pair's own innovation covariance only. The nearest neighbour compares Mahalanobis distances,
which favour a landmark whose place is uncertain: anything is near to it. The likelihood of a pair, the
normal density with -2 log = y^T S^-1 y + log |S| + const, makes it pay for that (Kaess and Dellaert 2009).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from slamcmp.association.compatibility import NOBODY, Innovations, gate
from slamcmp.types import IntArray


def nearest_neighbour(innovations: Innovations, probability: float) -> IntArray:
    """The landmark's row of each detection, (m,), or NOBODY; the nearest pair of all is taken first."""
    distances = innovations.squared_distances
    given = np.full(distances.shape[0], NOBODY, dtype=np.int64)
    rows, columns = np.nonzero(innovations.compatible(probability))
    taken: set[int] = set()
    for pair in np.argsort(distances[rows, columns], kind="stable").tolist():
        row, column = int(rows[pair]), int(columns[pair])
        if given[row] == NOBODY and column not in taken:
            given[row] = column
            taken.add(column)
    return given


def maximum_likelihood(innovations: Innovations, probability: float) -> IntArray:
    """The landmark's row of each detection, (m,), or NOBODY, so that the product of likelihoods is largest.

    A detection that stays without landmark costs as much as the worst pair that its gate could hold.
    """
    compatible = innovations.compatible(probability)
    count, landmarks = compatible.shape
    given = np.full(count, NOBODY, dtype=np.int64)
    rows = np.flatnonzero(compatible.any(axis=1))
    if not rows.size:
        return given
    determinants = innovations.log_determinants[rows]
    costs = innovations.squared_distances[rows] + determinants
    largest = np.where(compatible[rows], determinants, -np.inf).max(axis=1)
    alone = gate(innovations.dim, probability) + largest
    # Above any sum of what is allowed, so that no forbidden pair is ever worth it.
    forbidden = 2.0 * float(np.abs(costs[compatible[rows]]).sum() + np.abs(alone).sum()) + 1.0
    table = np.full((rows.size, landmarks + rows.size), forbidden)
    table[:, :landmarks] = np.where(compatible[rows], costs, forbidden)
    table[np.arange(rows.size), landmarks + np.arange(rows.size)] = alone
    chosen_rows, chosen = linear_sum_assignment(table)
    paired = chosen < landmarks
    given[rows[chosen_rows[paired]]] = chosen[paired]
    return given
