"""A filter's robust update: the minimum of prior plus kernels, by reweighted least squares on k x k blocks.

With weights w the update is the ordinary one, noise R / w in place of R. The residual that it leaves is
``v = (R / w) S^-1 y``, so the weights that belong to the minimum are found before P is touched: a solve with
S (k, k) an iteration. It is the same cost that a smoother minimises, and where h is linear the same minimum.

========  ==================================================================
symbol    meaning
========  ==================================================================
y, S      innovation (k,), its covariance H P H^T + R / w (k, k)
R, L      noise of each observation, R = L L^T, (m, d, d)
w, r      weights and lengths of L^-1 v, (m,)
========  ==================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from slamcmp.backends.robust import NOTHING, Kernel
from slamcmp.types import FloatArray

ITERATIONS = 200
"""Most of the last kernel; Huber's converge linearly."""
STAGE_ITERATIONS = 5
"""Of each kernel before the last, which only has to come near."""
RESTS = 1e-11
"""Change of a weight that is taken for none."""


@dataclass(frozen=True)
class Reweighted:
    """What the kernel makes of a frame's noise."""

    R: FloatArray
    """R / w as one matrix, (k, k)."""
    weights: FloatArray
    """(m,)."""
    nis: float | None
    """y^T S^-1 y of the noise as it was given, NaN where S is not positive definite; None: R is that."""


def reweighted(kernel: Kernel, S_known: FloatArray, R: FloatArray, y: FloatArray, d: int) -> Reweighted:
    """The noise with which the ordinary update stands at the minimum of the robust cost.

    Args:
        kernel: of every observation.
        S_known: covariance of the innovation without its noise R, (k, k).
        R: block-diagonal noise of the m observations, (k, k).
        y: innovation, (k,).
        d: components of an observation, k = m d.
    """
    m = y.size // d
    blocks = R.reshape(m, d, m, d)[np.arange(m), :, np.arange(m), :]
    whitener = np.linalg.inv(np.linalg.cholesky(blocks))
    w = np.ones(m)
    r, nis = _left(S_known, blocks, whitener, w, y)
    if not np.isfinite(nis):
        return Reweighted(R, w, nis)
    stages = kernel.stages(float(r.max(initial=0.0)))
    for stage in stages:
        last = stage is stages[-1]
        for _ in range(ITERATIONS if last else STAGE_ITERATIONS):
            before, w = w, np.maximum(stage.weight(r), NOTHING)
            if np.abs(w - before).max(initial=0.0) <= RESTS:
                break
            r, _ = _left(S_known, blocks, whitener, w, y)
    if (w == 1.0).all():
        return Reweighted(R, w, None)
    # A correlation between two components of one observation stays what it was.
    return Reweighted(R / np.repeat(w, d)[:, None], w, nis)


def _left(
    S_known: FloatArray, blocks: FloatArray, whitener: FloatArray, w: FloatArray, y: FloatArray
) -> tuple[FloatArray, float]:
    """Whitened lengths (m,) of the residuals that the update with weights w leaves, and y^T S^-1 y."""
    m, d, _ = blocks.shape
    noise = blocks / w[:, None, None]
    S = S_known.copy()
    S.reshape(m, d, m, d)[np.arange(m), :, np.arange(m), :] += noise
    _, gain, failed = dposv(S, y, lower=1)
    if failed or not np.isfinite(gain).all():
        return np.zeros(m), float("nan")
    left = np.einsum("mij,mjk,mk->mi", whitener, noise, gain.reshape(m, d))
    return np.sqrt((left**2).sum(axis=1)), float(y @ gain)
