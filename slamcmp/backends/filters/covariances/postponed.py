"""The joint covariance again, with the part nobody looks at brought up to date late: exact, and cheaper.

While a robot observes only landmarks near it, the update of all the others has a form that can wait
("compressed" filter, Guivant and Nebot 2001; "postponement", Knight, Davison, Reid 2001). Let A be the pose
and the near landmarks, F the far ones, and 0 the last flush. All the frames since have changed

    P_AF = Phi P_AF(0),    P_FF = P_FF(0) - W_F W_F^T with W_F^T = V P_AF(0),    x_F = x_F(0) + P_FA(0) u

so only Phi, V and u have to be kept. This is a filter itself: u is a set of extra states, as many as A had at
the flush, whose cross-covariance with A starts as the identity. A :class:`JointCovariance` of A and u, a few
hundred states at most, takes every verb unchanged, Phi is its off-diagonal block, and V is what each downdate
``W W^T`` does in the columns of u.

A far landmark that comes into view joins without a flush: x_f = x_f(0) + P_fA(0) u + independent noise, and
then u grows by as many states as the landmark has. A flush is needed only when the near set would outgrow
its capacity. It keeps only what is in view: a landmark kept costs the next flush as much as one that returns.

V is kept as rows and not as the product V^T V, which would square its condition number.

========  ===========================================================================
symbol    meaning
========  ===========================================================================
A, F      states of the pose and the near landmarks, and of the far landmarks
u         extra states; their means are the postponed correction of x_F
Phi       cross-covariance of A and u
V         whitened innovations' covariance with u, one row a measured component
B         P_AF(0), a row for each u (and a column for every state: A's are not used)
W         square root of the downdate, (n, k)
========  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.linalg import qr

from slamcmp.backends.filters.covariances.covariance import JointCovariance
from slamcmp.types import FloatArray, IntArray

COMPRESS_AT = 8
"""Rows of V for each u before they are replaced by their triangular factor."""


class PostponedCovariance:
    """P of a pose (first) and a growing map of which only the near landmarks are always up to date.

    The verbs are those of :class:`JointCovariance`; ``columns`` and ``downdate`` work on the near states.

    Args:
        P: covariance of the pose, (p, p).
        size: n, states a landmark.
        capacity: most near landmarks; a frame that sees more of them has all of those near.
    """

    def __init__(self, P: FloatArray, size: int, capacity: int) -> None:
        self._pose_states = np.arange(P.shape[0])
        self._axes = np.arange(size)
        self._capacity = capacity
        self._n = P.shape[0]
        # As of the last flush; of the near states only the far ones' view of them is stale as well.
        self._all = JointCovariance(P)
        self._near = JointCovariance(P)
        # Landmark number -> its first state in _near, the longest unseen first.
        self._slots: dict[int, int] = {}
        self._in_view = 0
        self._u = np.empty(0, dtype=np.int64)
        self._B = np.empty((0, self._n))
        self._V = [np.empty((0, 0))]
        self._u_mean = np.empty(0)
        self._overdue = np.zeros(self._n)

    @property
    def size(self) -> int:
        """n, the number of states, near and far."""
        n: int = self._n
        return n

    def pose_block(self) -> FloatArray:
        """(p, p), a copy."""
        return self._near.pose_block()

    def dense(self) -> FloatArray:
        """P of all states, (n, n), a copy; flushes."""
        self._flush(len(self._slots))
        return self._all.dense()

    def diagonal_blocks(self, size: int) -> FloatArray:
        """Every landmark's own block, (L, size, size), a copy; flushes."""
        self._flush(len(self._slots))
        return self._all.diagonal_blocks(size)

    def touch(self, numbers: IntArray, landmarks: FloatArray) -> IntArray:
        """Make landmarks near; their states and the pose's, (c,), as ``columns`` counts them.

        Args:
            numbers: the landmarks' places in the map, (m,).
            landmarks: means of the whole map, (L, n), brought up to date in place.
        """
        wanted = numbers.tolist()
        far = [number for number in wanted if number not in self._slots]
        for number in wanted:
            if number in self._slots:
                self._slots[number] = self._slots.pop(number)
        if far:
            if len(self._slots) + len(far) > self._capacity:
                self._flush(len(wanted) - len(far))
            self.settle(landmarks)
            self._approach(np.array(far))
        self._in_view = len(wanted)
        return self._near_states(wanted)

    def states(self, touched: IntArray) -> IntArray:
        """Places in P, all landmarks counted, of the states that ``touch`` told."""
        numbers = {first: number for number, first in self._slots.items()}
        starts = touched[self._pose_states.size :: self._axes.size]
        return self._all_states([numbers[first] for first in starts.tolist()])

    def columns(self, states: IntArray, size: int) -> FloatArray:
        """Columns of the near part of P, with the rows of u, for ``states`` from ``touch``."""
        return self._near.columns(states, size)

    def propagate(self, A: FloatArray | None, Q: FloatArray | None) -> None:
        """Move the pose: P_xx = A P_xx A^T + Q, P_mx = P_mx A^T; None: A is the identity, Q zero."""
        self._near.propagate(A, Q)

    def augment(self, G: FloatArray, N: FloatArray) -> None:
        """Add near landmarks l = G xi + noise of covariance N (a, a), uncorrelated with all else."""
        size, p = self._axes.size, self._pose_states.size
        for offset in range(0, G.shape[0], size):
            self._slots[(self._n - p + offset) // size] = self._near.size + offset
        self._near.augment(G, N)
        self._n += G.shape[0]
        if len(self._slots) > self._capacity:
            self._flush(min(self._in_view + G.shape[0] // size, self._capacity))

    def downdate(self, W_t: FloatArray) -> None:
        """``P -= W W^T`` from the near part of W^T."""
        self._near.downdate(W_t)
        if self._u.size:
            self._V.append(W_t[:, self._u])
            if sum(map(len, self._V)) > COMPRESS_AT * self._u.size:
                self._compressed()

    def shift(self, landmarks: FloatArray, dx: FloatArray) -> None:
        """Correct the means (L, n) of the near landmarks in place, those of the far ones later."""
        slots = np.fromiter(self._slots.values(), dtype=np.int64, count=len(self._slots))
        landmarks[list(self._slots)] += dx[slots[:, None] + self._axes]
        self._u_mean += dx[self._u]

    def settle(self, landmarks: FloatArray) -> None:
        """Give the means (L, n) of the far landmarks their postponed correction, in place."""
        self._collect_mean()
        p, size = self._pose_states.size, self._axes.size
        correction = self._overdue[p:].reshape(-1, size)
        landmarks[: len(correction)] += correction
        self._overdue[:] = 0.0

    def _flush(self, keep: int) -> None:
        """Bring everything up to date and start anew with the ``keep`` landmarks seen last."""
        near, p, size = list(self._slots), self._pose_states.size, self._axes.size
        here, there = self._near_states(near), self._all_states(near)
        P = self._near.dense()
        P_A = P[np.ix_(here, here)]
        known = self._all.size
        rows = np.zeros((here.size, self._n))
        if self._u.size:
            self._collect_mean()
            rows[:, :known] = P[np.ix_(here, self._u)] @ self._B
            V = self._compressed()
            # BLAS takes no product of no rows.
            if len(V):
                W_t = V @ self._B
                W_t[:, there[there < known]] = 0.0
                self._all.downdate(W_t)
        new = self._n - known
        self._all.append(np.zeros((new, known)), np.zeros((new, new)))
        rows[:, there] = P_A
        self._all.overwrite(there, rows, size)
        self._overdue = np.concatenate([self._overdue, np.zeros(new)])

        kept = near[len(near) - keep :] if keep < len(near) else near
        chosen = np.concatenate([self._pose_states, np.arange(here.size - len(kept) * size, here.size)])
        P_kept = P_A[np.ix_(chosen, chosen)]
        self._near = JointCovariance(P_kept[:p, :p])
        self._near.append(P_kept[p:, :p], P_kept[p:, p:])
        self._slots = {number: p + size * place for place, number in enumerate(kept)}
        everything_is_near = p + size * len(kept) == self._n
        u_count = 0 if everything_is_near else chosen.size
        self._u = chosen.size + np.arange(u_count)
        self._near.append(np.eye(u_count, chosen.size), np.zeros((u_count, u_count)))
        self._B = rows[chosen[:u_count]]
        self._V = [np.empty((0, u_count))]
        self._u_mean = np.zeros(u_count)

    def _approach(self, numbers: IntArray) -> None:
        """Make far landmarks near: their present covariance with the near states, and u's for their own."""
        p, size = self._pose_states.size, self._axes.size
        there = self._all_states(numbers.tolist())
        P_0 = self._all.columns(there, size)[:, p:]
        there = there[p:]
        B, V = self._B[:, there], self._compressed()
        W_t = V @ B
        rows = B.T @ self._near.dense()[self._u]
        rows[:, self._u] = -W_t.T @ V
        first = self._near.size
        self._near.append(rows, P_0[there] - W_t.T @ W_t)
        identity = np.zeros((there.size, self._near.size))
        identity[:, first:] = np.eye(there.size)
        self._u = np.concatenate([self._u, self._near.size + np.arange(there.size)])
        self._near.append(identity, np.zeros((there.size, there.size)))
        self._B = np.concatenate([self._B, P_0.T])
        self._u_mean = np.concatenate([self._u_mean, np.zeros(there.size)])
        for place, number in enumerate(numbers.tolist()):
            self._slots[number] = first + size * place

    def _collect_mean(self) -> None:
        """Move the postponed correction of the far means from u into states."""
        if self._u.size:
            correction = self._u_mean @ self._B
            near = self._all_states(self._slots)
            correction[near[near < correction.size]] = 0.0
            self._overdue += correction
            self._u_mean[:] = 0.0

    def _compressed(self) -> FloatArray:
        """V with a column for every u and at most as many rows, V^T V unchanged."""
        V: FloatArray = np.zeros((sum(map(len, self._V)), self._u.size))
        row = 0
        for part in self._V:
            V[row : row + len(part), : part.shape[1]] = part
            row += len(part)
        if len(V) > self._u.size:
            (triangle,) = qr(V, mode="r", overwrite_a=True, check_finite=False)
            V = np.asarray(triangle[: self._u.size], dtype=np.float64)
        self._V = [V]
        return V

    def _near_states(self, numbers: list[int]) -> IntArray:
        """The states of the pose and these near landmarks in ``_near``."""
        starts = np.array([self._slots[number] for number in numbers], dtype=np.int64)
        return np.concatenate([self._pose_states, (starts[:, None] + self._axes).ravel()])

    def _all_states(self, numbers: Iterable[int]) -> IntArray:
        """The states of the pose and these landmarks in ``_all``."""
        starts = self._pose_states.size + self._axes.size * np.array(list(numbers), dtype=np.int64)
        return np.concatenate([self._pose_states, (starts[:, None] + self._axes).ravel()])
