"""What a filter did to its error state, step by step: enough to smooth it.

The smoother is Rauch, Tung and Striebel's in the form of Bryson and Frazier (Bierman 1973): from the last
frame backwards an adjoint vector and matrix collect what later innovations say,

    correction:  lam <- (I - K H)^T lam + H^T S^-1 y,   Lam <- (I - K H)^T Lam (I - K H) + H^T S^-1 H,
    step:        lam <- F^T lam,                        Lam <- F^T Lam F,

and a frame's smoothed error is P lam with covariance P - P Lam P. No covariance is inverted, so exact starts
and singular Q are no special cases, and a frame stores the pose's rows of P and the gain, (states, p + k),
not (states, states).

========  ===========================================================================
symbol    meaning
========  ===========================================================================
F, D      a step's transition of the pose's error (p, p); rotation of each landmark's error (n, n)
G         new states' derivative by the pose's error, (a, p)
H, W, e   L^-1 H on the touched states (k, c), P H^T L^-T (states, k), L^-1 y, with S = L L^T
lam, Lam  the adjoints, (states,) and (states, states)
========  ===========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slamcmp.backends.filters.covariances.error_covariance import (
    Correction,
    Event,
    FrameEnd,
    Growth,
    Joining,
    Leaving,
    Removal,
    Step,
)
from slamcmp.types import FloatArray


@dataclass
class History:
    """The events of a run, in order, as a covariance tells them.

    Args:
        p: dimension of the pose's error.
        n: dimension of a landmark's error.
    """

    p: int
    n: int
    events: list[Event] = field(default_factory=list)

    def hear(self, event: Event) -> None:
        """Keep it."""
        self.events.append(event)

    def smoothed_errors(self) -> tuple[list[FrameEnd], FloatArray, FloatArray]:
        """The frames, their pose's error with hindsight (K, p), and its covariance (K, p, p).

        Both are in the filter's own chart, about the filter's mean.
        """
        p = self.p
        states = p
        for event in self.events:
            if isinstance(event, Growth):
                states += event.G.shape[0]
            elif isinstance(event, Joining):
                states += event.Q.shape[0]
            elif isinstance(event, Leaving):
                states = event.M.shape[0]
            elif isinstance(event, Removal):
                states -= event.states.size
        lam, Lam = np.zeros(states), np.zeros((states, states))
        frames: list[FrameEnd] = []
        errors, covariances = [], []
        for event in reversed(self.events):
            if isinstance(event, FrameEnd):
                rows = event.rows
                frames.append(event)
                errors.append(rows @ lam)
                covariances.append(rows[:, :p] - rows @ Lam @ rows.T)
            elif isinstance(event, Correction):
                _uncorrect(event, lam, Lam)
            elif isinstance(event, Step):
                self._unstep(event, lam, Lam)
            elif isinstance(event, Growth):
                lam, Lam = _ungrow(event, lam, Lam)
            elif isinstance(event, Joining):
                lam, Lam = lam[: event.first], Lam[: event.first, : event.first]
            elif isinstance(event, Leaving):
                lam, Lam = event.M.T @ lam, event.M.T @ Lam @ event.M
            else:
                lam, Lam = _unremove(event, lam, Lam)
        P = np.array(covariances[::-1]).reshape(-1, p, p)
        return frames[::-1], np.array(errors[::-1]).reshape(-1, p), 0.5 * (P + np.swapaxes(P, 1, 2))

    def _unstep(self, step: Step, lam: FloatArray, Lam: FloatArray) -> None:
        p, n = self.p, self.n
        if step.F is not None:
            lam[:p] = step.F.T @ lam[:p]
            Lam[:p] = step.F.T @ Lam[:p]
            Lam[:, :p] = Lam[:, :p] @ step.F
        if step.D is not None:
            size = lam.size
            lam[p:] = (lam[p:].reshape(-1, n) @ step.D).ravel()
            Lam[p:] = (step.D.T @ Lam[p:].reshape(-1, n, size)).reshape(-1, size)
            Lam[:, p:] = (Lam[:, p:].reshape(size, -1, n) @ step.D).reshape(size, -1)


def _uncorrect(event: Correction, lam: FloatArray, Lam: FloatArray) -> None:
    H, W_t, touched = event.H_white, event.W_t, event.touched
    lam[touched] += H.T @ (event.e - W_t @ lam)
    # (I - K H)^T from the left, then its transpose from the right: multiplied out, the terms would cancel
    # and rounding would grow from frame to frame.
    Lam[touched] -= H.T @ (W_t @ Lam)
    Lam[:, touched] -= (Lam @ W_t.T) @ H
    Lam[touched[:, None], touched] += H.T @ H
    Lam += Lam.T.copy()
    Lam *= 0.5


def _ungrow(event: Growth, lam: FloatArray, Lam: FloatArray) -> tuple[FloatArray, FloatArray]:
    G = event.G
    old = lam.size - G.shape[0]
    of = slice(event.first, event.first + G.shape[1])
    lam_old, Lam_old = lam[:old].copy(), Lam[:old, :old].copy()
    lam_old[of] += G.T @ lam[old:]
    # [I; G 0]^T Lam [I; G 0]: the error that made the new states now also stands for them.
    across = G.T @ Lam[old:, :old]
    Lam_old[of] += across
    Lam_old[:, of] += across.T
    Lam_old[of, of] += G.T @ Lam[old:, old:] @ G
    return lam_old, Lam_old


def _unremove(event: Removal, lam: FloatArray, Lam: FloatArray) -> tuple[FloatArray, FloatArray]:
    keep = np.delete(np.arange(event.size), event.states)
    lam_old, Lam_old = np.zeros(event.size), np.zeros((event.size, event.size))
    # No later innovation says anything about a state that has gone.
    lam_old[keep] = lam
    Lam_old[np.ix_(keep, keep)] = Lam
    return lam_old, Lam_old
