"""The textbook's observability matrix of a filter, from the events that its smoother keeps."""

from __future__ import annotations

import numpy as np

from slamcmp.backends.filters.covariances.error_covariance import Correction, Growth, Joining, Leaving, Step
from slamcmp.backends.filters.rts_smoother import History


def observability_matrix(history: History) -> np.ndarray:
    """Every observation's whitened H carried back to the first frame, (rows, states).

    A landmark's first observation counts too: it is the row [-G, I] of the states it adds. The null space
    holds what the filter believes it cannot see (Huang, Mourikis, Roumeliotis 2010, eq. 11).
    """
    p, n = history.p, history.n
    states = p + sum(event.G.shape[0] for event in history.events if isinstance(event, Growth))
    carried = np.eye(p, states)
    unknowns = p
    blocks = [np.empty((0, states))]
    for event in history.events:
        if isinstance(event, Step):
            if event.F is not None:
                carried[:p] = event.F @ carried[:p]
            if event.D is not None:
                carried[p:] = (event.D @ carried[p:].reshape(-1, n, states)).reshape(-1, states)
        elif isinstance(event, Correction):
            blocks.append(event.H_white @ carried[event.touched])
        elif isinstance(event, Joining):
            # Noise is no unknown of this matrix.
            carried = np.concatenate([carried, np.zeros((len(event.Q), states))])
        elif isinstance(event, Leaving):
            carried = event.M @ carried
        elif isinstance(event, Growth):
            added = np.eye(len(event.G), states, unknowns)
            unknowns += len(event.G)
            follows = slice(event.first, event.first + event.G.shape[1])
            blocks.append(added - event.G @ carried[follows])
            carried = np.concatenate([carried, added])
    return np.concatenate(blocks)


def textbook_nullity(history: History) -> int:
    """Columns less singular values above 1e-9 of the largest."""
    matrix = observability_matrix(history)
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return matrix.shape[1] - int(np.count_nonzero(sizes > 1e-9 * sizes[0]))
