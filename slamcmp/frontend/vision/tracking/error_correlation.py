"""What the errors of one track have in common from image to image, told by the tracker's own innovations.

A stream's measurements are independent by definition, and corners are not: the peak of a corner's response
wanders slowly over the surface as the view of it changes, an edge in the depth image pulls the same way for
a while, and so the next image repeats a good part of the error of this one. Many sightings then tell less
than the same number of independent ones would, and a back end that is not told so is far too sure. How much
is measured here by a track's innovations; no truth takes part.

========  ===============================================================================================
symbol    meaning
========  ===============================================================================================
w         an innovation over its stated deviation, component by component, (m, d)
c_l       mean product of two of them of one track that lie l images apart; c_0 = 1 where R is right
lambda    c_0 + 2 sum (1 - l / (L + 1)) c_l, l = 1…L: the variance of a track's mean over that of independent
          errors with the stated R (Newey and West 1987)
========  ===============================================================================================
"""

from __future__ import annotations

import numpy as np

from slamcmp.types import FloatArray

LAGS = 11
"""Longer memory is beyond most tracks, and what a track's point takes over of it does no harm."""
SETTLED = 3
"""Sightings before a track's innovations count: the first ones are differences of errors that are alike."""
_USUAL = 0.35 * 0.9 ** np.arange(LAGS + 1)
_USUAL[0] = 1.0
"""c_l / c_0 before anything was measured: what pieces of KITTI, TUM, 7-Scenes and rendered ones have."""
_WEIGHT = 300.0
"""Products that this guess counts for: those of one image."""
_BARTLETT = 2.0 * (1.0 - np.arange(LAGS + 1) / (LAGS + 1.0))
_BARTLETT[0] = 1.0


class ErrorCorrelation:
    """Running means of the products of innovations, over all tracks and images so far."""

    def __init__(self) -> None:
        self._sums = np.zeros(LAGS + 1)
        self._counts = np.zeros(LAGS + 1)

    def learn(self, latest: FloatArray, before: FloatArray) -> None:
        """Take in the innovations (m, d) of one image, and those of the same tracks before, (m, LAGS, d).

        Newest first; all of one is NaN where there is none.
        """
        now, then = np.isfinite(latest[:, 0]), np.isfinite(before[:, :, 0])
        latest = np.where(now[:, None], latest, 0.0)
        before = np.where(then[:, :, None], before, 0.0)
        self._sums[0] += (latest * latest).sum()
        self._sums[1:] += np.einsum("md,mld->l", latest, before)
        self._counts[0] += latest.shape[1] * now.sum()
        self._counts[1:] += latest.shape[1] * (now @ then.astype(np.float64))

    @property
    def means(self) -> FloatArray:
        """c_l for l = 0…LAGS."""
        variance = (_WEIGHT + self._sums[0]) / (_WEIGHT + self._counts[0])
        answer: FloatArray = (_WEIGHT * variance * _USUAL + self._sums) / (_WEIGHT + self._counts)
        answer[0] = variance
        return answer

    @property
    def factor(self) -> float:
        """lambda, by which a stream's R is multiplied; 1 at least, for what the user states is a floor."""
        return max(1.0, float(_BARTLETT @ self.means))
