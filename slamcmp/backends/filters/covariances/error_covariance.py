"""The covariance of a filter's error state: four verbs, each heard by whoever listens.

=========  ===========================================================================
verb       what becomes of the error and of P
=========  ===========================================================================
move       the pose's error e becomes F e, each landmark's r becomes D r, and noise joins
grow       new landmarks, whose errors are G e plus noise N of their own, join the state
observe    y = H (errors) + noise R: the mean error that this implies, and P given it
drop       some states are marginalised: their rows and columns go
=========  ===========================================================================

A filter's equations say F, G and H, and nothing else. What else needs them listens: the smoother
(rts_smoother.py) keeps every verb to run them backwards, the twin without a start (unanchored.py) does them
a second time on another prior. Nobody listens unless asked for, and then a verb costs nothing more.

A filter never holds a pose and its successor at once: ``move`` writes the new pose's rows over the old one's,
which is to add the odometry's cost and to marginalise the old pose, as nothing else will refer to it.

========  ==========================================================
symbol    meaning
========  ==========================================================
p, n      dimension of the pose's error, and of one landmark's
F, D      of the pose's error (p, p), and of each landmark's (n, n)
Q, W      noise of a step: covariance (p, p) on the pose, or root (states, q) on all
G, N      new states by the pose's error (a, p), and their own noise (a, a)
H, R, S   stacked Jacobian, measurement noise, innovation covariance
y, dx     innovation (k,) and the mean error given it (states,)
========  ==========================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy.linalg.lapack import dtrtrs

from slamcmp.backends.filters.covariances.covariance import JointCovariance, stacked
from slamcmp.backends.filters.covariances.postponed import PostponedCovariance
from slamcmp.backends.filters.reweighting import reweighted
from slamcmp.backends.robust import Kernel
from slamcmp.backends.whitening import whitened_update
from slamcmp.errors import DivergedError
from slamcmp.types import FloatArray, IntArray

BLOCKWISE_FROM = 48
"""Fewest observations for which H is multiplied block by block and not as a matrix that is mostly zero."""


class StackedJacobian:
    """H of m observations of one landmark each, without its zero columns, in the quickest form.

    Its columns are the pose's, then those of the m landmarks, block by block.

    Args:
        H_pose: derivatives by the pose's error, (m, d, p).
        H_land: by the landmark's, (m, d, n).
    """

    def __init__(self, H_pose: FloatArray, H_land: FloatArray) -> None:
        self._H_pose, self._H_land = H_pose, H_land
        self._H_t = self.dense().T if len(H_land) < BLOCKWISE_FROM else None

    def dense(self) -> FloatArray:
        """H (m d, p + m n) as a matrix."""
        return stacked(self._H_pose, self._H_land)

    def times(self, X: FloatArray) -> FloatArray:
        """H X (m d, s) for X (p + m n, s)."""
        if self._H_t is not None:
            # Transposed, so that LAPACK gets the layout that it can work on in place.
            HX: FloatArray = (X.T @ self._H_t).T
            return HX
        m, d, n = self._H_land.shape
        p = self._H_pose.shape[2]
        HX = np.matmul(self._H_land, X[p:].reshape(m, n, -1)).reshape(m * d, -1)
        HX += self._H_pose.reshape(m * d, p) @ X[:p]
        return HX


@dataclass(frozen=True)
class Step:
    """The errors moved, and noise joined; None: unchanged, or no such noise."""

    F: FloatArray | None
    D: FloatArray | None = None
    Q: FloatArray | None = None
    W: FloatArray | None = None


@dataclass(frozen=True)
class Growth:
    """New states at the end, G times the p states from ``first`` on, plus noise of covariance N."""

    G: FloatArray
    N: FloatArray
    first: int = 0


@dataclass(frozen=True)
class Correction:
    """A measurement was taken in: H (k, c) on the states touched (c,), with noise R, whitened by L."""

    touched: IntArray
    H: FloatArray
    R: FloatArray
    L: FloatArray
    W_t: FloatArray
    """(P H^T L^-T)^T, (k, states)."""
    e: FloatArray
    """L^-1 y, (k,)."""

    @property
    def H_white(self) -> FloatArray:
        """L^-1 H, (k, c)."""
        whitened, _ = dtrtrs(self.L, self.H, lower=1)
        return np.asarray(whitened, dtype=np.float64)


@dataclass(frozen=True)
class Removal:
    """States (s,) of ``size`` went, and the others closed ranks in their order."""

    states: IntArray
    size: int


@dataclass(frozen=True)
class Joining:
    """An increment's error of covariance Q (p, p) became states, the ``first`` and those after it."""

    Q: FloatArray
    first: int


@dataclass(frozen=True)
class Leaving:
    """These left: of the errors before, F and D moved pose and landmarks, W (states, p) shook all."""

    M: FloatArray
    """All of that in one, (states, states before)."""
    F: FloatArray
    D: FloatArray
    W: FloatArray


@dataclass(frozen=True)
class FrameEnd:
    """What the filter knew of its pose when a frame was over."""

    t: float
    mean: FloatArray
    """Its pose, or for a linear system its state."""
    rows: FloatArray
    """The pose's rows of P, (p, states)."""


Event = Step | Growth | Correction | Removal | Joining | Leaving | FrameEnd


class Listener(Protocol):
    """Hears of every verb, after it was done."""

    def hear(self, event: Event) -> None:
        """Take note of it."""


Heard = TypeVar("Heard", bound=Listener)


class ErrorCovariance:
    """P of a pose (first) and a map, changed by four verbs.

    Args:
        storage: P at the start, and how it is kept.
        n: dimension of a landmark's error.
    """

    def __init__(self, storage: JointCovariance | PostponedCovariance, n: int) -> None:
        self.storage = storage
        self.nis, self.nis_dof = 0.0, 0
        """Of the frame so far: y^T S^-1 y and the number of its components."""
        self.weights: FloatArray | None = None
        """Of the frame's observations, (m,), where a kernel gave them any."""
        self._kernel: Kernel | None = None
        self._components = 0
        self._n = n
        self._pose_states = np.arange(storage.size)
        self.frame = -1
        """Number of the frame in progress."""
        self._listeners: tuple[Listener, ...] = ()

    @property
    def size(self) -> int:
        """Number of states."""
        return self.storage.size

    @property
    def is_robust(self) -> bool:
        """Whether observations go through a kernel."""
        return self._kernel is not None

    @property
    def has_listeners(self) -> bool:
        """Whether anybody hears of the verbs."""
        return bool(self._listeners)

    def add_listener(self, listener: Heard) -> Heard:
        """Let the listener hear of every verb from now on."""
        self._listeners += (listener,)
        return listener

    def make_robust(self, kernel: Kernel, components: int) -> None:
        """Let every observation of so many components go through the kernel (reweighting.py)."""
        self._kernel, self._components = kernel, components

    def begin_frame(self, k: int) -> None:
        """What follows belongs to frame k."""
        self.frame = k
        self.nis, self.nis_dof = 0.0, 0
        self.weights = None

    def end_frame(self, t: float, mean: FloatArray) -> None:
        """The frame is over, its pose having the ``mean``: the next ``move`` will overwrite its rows."""
        if self._listeners:
            self._tell(FrameEnd(t, mean, self.pose_rows()))

    def move(
        self,
        F: FloatArray | None = None,
        D: FloatArray | None = None,
        Q: FloatArray | None = None,
        W: FloatArray | None = None,
    ) -> None:
        """The pose's error becomes F times itself, landmarks' D times themselves; None: unchanged.

        Args:
            F: (p, p).
            D: a rotation (n, n).
            Q: covariance of noise on the pose, (p, p).
            W: or root of noise that reaches all states, (states, q).
        """
        if D is not None:
            self._joint.turn_landmarks(D)
        if F is not None or Q is not None:
            self.storage.propagate(F, Q)
        if W is not None:
            self._joint.inflate(W.T)
        if self._listeners:
            self._tell(Step(F, D, Q, W))

    def grow(self, G: FloatArray, N: FloatArray) -> None:
        """New landmarks at the end: G (a, p) times the pose's error plus noise of covariance N (a, a)."""
        self.storage.augment(G, N)
        if self._listeners:
            self._tell(Growth(G, N))

    def touch(self, numbers: IntArray, landmarks: FloatArray) -> IntArray:
        """States (c,) of the pose and the landmarks (m,), for ``observe``; brings their means up to date.

        Args:
            numbers: places in the map.
            landmarks: means (L, n) of the whole map, changed in place where a correction was postponed.
        """
        return self.storage.touch(numbers, landmarks)

    def observe(
        self,
        touched: IntArray,
        H: FloatArray | StackedJacobian,
        R: FloatArray,
        y: FloatArray,
        beside: FloatArray | None = None,
    ) -> FloatArray:
        """Take in y = H (errors of the states touched) + noise; the mean error given it, (states,).

        With a kernel R is what it makes of it; NIS stays that of the noise as it was given.

        Args:
            touched: states (c,), the pose's first, as ``touch`` tells them.
            H: (k, c).
            R: noise of the measurements, (k, k).
            y: (k,).
            beside: covariance (k, k) of what else y is uncertain by, which no kernel doubts.

        Raises:
            DivergedError: S is not positive definite, or y not finite.
        """
        columns = self.storage.columns(touched, self._n)
        if isinstance(H, StackedJacobian):
            PHt_t = H.times(columns.T)
            S = H.times(PHt_t.T[touched])
        else:
            PHt_t = (columns @ H.T).T
            S = H @ PHt_t.T[touched]
        nominal: float | None = None
        if self._kernel is not None:
            R, nominal = self._robust(self._kernel, S if beside is None else S + beside, R, y)
        if beside is not None:
            R = R + beside
        S += R
        L, W_t, e, nis = whitened_update(S, PHt_t, y)
        if not math.isfinite(nis):
            raise lost_covariance(self.frame)
        # Before the downdate, which takes W from the cache.
        dx: FloatArray = e @ W_t
        self.storage.downdate(W_t)
        self.nis += nis if nominal is None else nominal
        self.nis_dof += y.size
        if self._listeners:
            matrix = H.dense() if isinstance(H, StackedJacobian) else H
            self._tell(Correction(self.storage.states(touched), matrix, R, L, W_t, e))
        return dx

    def drop(self, states: IntArray) -> None:
        """Marginalise landmarks' states (s,); the others close ranks in their order."""
        if self._listeners:
            self._tell(Removal(states, self.size))
        self._joint.remove(states)

    def shift(self, landmarks: FloatArray, dx: FloatArray) -> None:
        """Correct the means (L, n) of the map in place by dx (states,), or note it for later."""
        self.storage.shift(landmarks, dx)

    def settle(self, landmarks: FloatArray) -> None:
        """Give the means (L, n) the corrections that were noted for later, in place."""
        self.storage.settle(landmarks)

    def block(self, touched: IntArray) -> FloatArray:
        """P of the states touched, (c, c), a copy."""
        return self.storage.columns(touched, self._n)[touched]

    def pose_rows(self) -> FloatArray:
        """The pose's rows of P, (p, states), a copy."""
        return self.storage.columns(self._pose_states, self._n).T.copy()

    def pose_block(self) -> FloatArray:
        """(p, p), a copy."""
        return self.storage.pose_block()

    def dense(self) -> FloatArray:
        """P of all states, (states, states), a copy."""
        return self.storage.dense()

    def diagonal_blocks(self) -> FloatArray:
        """Each landmark's own block, (L, n, n), a copy."""
        return self.storage.diagonal_blocks(self._n)

    def noise_of(self, S_known: FloatArray, R: FloatArray, y: FloatArray) -> FloatArray:
        """R (k, k), or what a kernel makes of it; y (k,) has the covariance S_known (k, k) without R."""
        return R if self._kernel is None else self._robust(self._kernel, S_known, R, y)[0]

    def _robust(
        self, kernel: Kernel, S_known: FloatArray, R: FloatArray, y: FloatArray
    ) -> tuple[FloatArray, float | None]:
        found = reweighted(kernel, S_known, R, y, self._components)
        self.weights = found.weights
        return found.R, found.nis

    def _tell(self, event: Event) -> None:
        for listener in self._listeners:
            listener.hear(event)

    @property
    def _joint(self) -> JointCovariance:
        """The storage, for what cannot be postponed."""
        assert isinstance(self.storage, JointCovariance)
        return self.storage


def lost_covariance(k: int) -> DivergedError:
    """What a filter says whose innovation in frame k has no likelihood."""
    return DivergedError(
        f"frame {k}: the innovation covariance is not positive definite, or the innovation not finite; the "
        "filter has lost its covariance, or a measurement is spoilt"
    )
