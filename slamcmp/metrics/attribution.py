"""How much of the gap between a filter and a smoother each difference between them explains.

Estimators between the two, each one change from the last, are run on the same stream; the parts are the
differences of neighbours and sum to the whole gap exactly, run by run. A part may be negative: that change
made this run worse. The parts depend on the order of the changes, which is therefore fixed.
"""

from __future__ import annotations

import numpy as np

from slamcmp.errors import DataError
from slamcmp.types import FloatArray


def telescoped(scores: FloatArray) -> FloatArray:
    """Parts (runs, stages - 1) of scores (runs, stages), stages from filter to smoother.

    Part i is score i minus score i + 1: positive where the change lowers the score. They sum to the first
    score minus the last.

    Raises:
        DataError: not a table of at least two stages.
    """
    scores = np.asarray(scores, dtype=np.float64)
    if scores.ndim != 2 or scores.shape[1] < 2:
        raise DataError(f"scores: shape {scores.shape} where (runs, at least 2 stages) is needed")
    return scores[:, :-1] - scores[:, 1:]
