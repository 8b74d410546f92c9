"""The verbs of error_covariance.py as compiled loops: move, grow and observe, in the plane.

P is the buffer of JointCovariance in its layout of one triangle, transposed: rows are contiguous, the first n
rows and columns count, and of these the upper triangle; but the pose's own block is whole, so that the pose's
rows can be read from end to end.

========  =====================================================================
symbol    meaning (those of error_covariance.py)
========  =====================================================================
F, Q      of the pose's error (3, 3), and noise on the pose (3, 3)
b         per landmark: how the heading's error moves it, (count, 2)
G, N      of new states by the pose's error (a, 3), and their own noise (a, a)
H, R, S   Jacobian on the states touched (k, c), noise, innovation covariance
L, W, e   S = L L^T, W = L^-1 H P (k, n), e = L^-1 y
========  =====================================================================
"""

from __future__ import annotations

import math

import numpy as np

from slamcmp.backends.filters.compiled.compiling import compiled
from slamcmp.backends.filters.compiled.rank_update import downdate
from slamcmp.types import FloatArray, IntArray


@compiled()
def mirror_pose(P: FloatArray) -> None:
    """The lower half of the pose's own block from the upper."""
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@compiled()
def move(P: FloatArray, n: int, F: FloatArray, Q: FloatArray) -> None:
    """P_xx = F P_xx F^T + Q and P_xm = F P_xm."""
    f00, f01, f02 = F[0, 0], F[0, 1], F[0, 2]
    f10, f11, f12 = F[1, 0], F[1, 1], F[1, 2]
    f20, f21, f22 = F[2, 0], F[2, 1], F[2, 2]
    for j in range(n):
        a, b, d = P[0, j], P[1, j], P[2, j]
        P[0, j] = f00 * a + f01 * b + f02 * d
        P[1, j] = f10 * a + f11 * b + f12 * d
        P[2, j] = f20 * a + f21 * b + f22 * d
    for i in range(3):
        a, b, d = P[i, 0], P[i, 1], P[i, 2]
        P[i, 0] = f00 * a + f01 * b + f02 * d
        P[i, 1] = f10 * a + f11 * b + f12 * d
        P[i, 2] = f20 * a + f21 * b + f22 * d
    for i in range(3):
        for j in range(i, 3):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i]) + 0.5 * (Q[i, j] + Q[j, i])


@compiled()
def shake(P: FloatArray, noise: FloatArray, b: FloatArray) -> None:
    """P += [I; -B] noise [I; -B]^T, B being the column b times the heading's error."""
    for i in range(3):
        for j in range(3):
            P[i, j] += noise[i, j]
    for m in range(len(b)):
        for d in range(2):
            s, u = 3 + 2 * m + d, b[m, d]
            for i in range(3):
                P[i, s] -= noise[i, 2] * u
    for m in range(len(b)):
        for d in range(2):
            s, u = 3 + 2 * m + d, noise[2, 2] * b[m, d]
            if d == 0:
                P[s, s] += u * b[m, 0]
            P[s, 4 + 2 * m] += u * b[m, 1]
            for j in range(m + 1, len(b)):
                P[s, 3 + 2 * j] += u * b[j, 0]
                P[s, 4 + 2 * j] += u * b[j, 1]


@compiled()
def turn_landmarks(P: FloatArray, n: int, c: float, s: float) -> None:
    """P_mm = D P_mm D^T and P_xm = P_xm D^T, D = [[c, -s], [s, c]] on each landmark."""
    for i in range(3, n, 2):
        P[i + 1, i] = P[i, i + 1]
        for j in range(i, n):
            a, b = P[i, j], P[i + 1, j]
            P[i, j], P[i + 1, j] = c * a - s * b, s * a + c * b
    for i in range(n):
        for j in range(max(3, i - 1 + i % 2), n, 2):
            a, b = P[i, j], P[i, j + 1]
            P[i, j], P[i, j + 1] = c * a - s * b, s * a + c * b


@compiled()
def grow(P: FloatArray, n: int, G: FloatArray, N: FloatArray) -> None:
    """New states, G times the pose's error plus noise of covariance N."""
    a = len(G)
    for i in range(a):
        s = n + i
        for j in range(n):
            P[j, s] = G[i, 0] * P[0, j] + G[i, 1] * P[1, j] + G[i, 2] * P[2, j]
        for j in range(i + 1):
            value = 0.5 * (N[i, j] + N[j, i])
            for d in range(3):
                value += P[d, s] * G[j, d]
            P[n + j, s] = value


@compiled()
def block(P: FloatArray, touched: IntArray, P_touched: FloatArray) -> None:
    """``P_touched`` (c, c): P of the states touched."""
    for i in range(touched.size):
        for j in range(i + 1):
            a, b = touched[i], touched[j]
            P_touched[i, j] = P_touched[j, i] = P[min(a, b), max(a, b)]


@compiled()
def factor(S: FloatArray) -> bool:
    """L^T in the upper triangle of S, in place; False where S is not positive definite."""
    k = len(S)
    for b in range(k):
        if not S[b, b] > 0.0:
            return False
        S[b, b] = math.sqrt(S[b, b])
        scale = 1.0 / S[b, b]
        for a in range(b + 1, k):
            S[b, a] *= scale
        for a in range(b + 1, k):
            h = S[b, a]
            for c in range(a, k):
                S[a, c] -= h * S[b, c]
    return True


@compiled()
def entries_of(H: FloatArray) -> tuple[IntArray, IntArray]:
    """Where each row of H (k, c) is not zero, (k, c), and how many such places it has, (k,)."""
    k, c = H.shape
    places, counts = np.empty((k, c), dtype=np.int64), np.zeros(k, dtype=np.int64)
    for a in range(k):
        for t in range(c):
            if H[a, t] != 0.0:
                places[a, counts[a]] = t
                counts[a] += 1
    return places, counts


@compiled()
def combine(
    to: FloatArray, a: int, size: int, H: FloatArray, places: IntArray, count: int, rows: FloatArray
) -> None:
    """Row a of ``to`` = row a of H times ``rows``, on ``size`` columns; H is not zero at ``count`` places.

    Several rows in one loop, which is begun less often and stores less; entries by two indices, for numba
    counts references to rows.
    """
    first = 0
    if count == 5:
        # A landmark seen from a pose in the plane.
        p0, p1, p2, p3, p4 = places[a, 0], places[a, 1], places[a, 2], places[a, 3], places[a, 4]
        h0, h1, h2, h3, h4 = H[a, p0], H[a, p1], H[a, p2], H[a, p3], H[a, p4]
        for j in range(size):
            to[a, j] = (
                h0 * rows[p0, j] + h1 * rows[p1, j] + h2 * rows[p2, j] + h3 * rows[p3, j] + h4 * rows[p4, j]
            )
        return
    for j in range(size):
        to[a, j] = 0.0
    while first + 4 <= count:
        p0, p1, p2, p3 = places[a, first], places[a, first + 1], places[a, first + 2], places[a, first + 3]
        h0, h1, h2, h3 = H[a, p0], H[a, p1], H[a, p2], H[a, p3]
        for j in range(size):
            to[a, j] += h0 * rows[p0, j] + h1 * rows[p1, j] + h2 * rows[p2, j] + h3 * rows[p3, j]
        first += 4
    while first < count:
        p0 = places[a, first]
        h0 = H[a, p0]
        for j in range(size):
            to[a, j] += h0 * rows[p0, j]
        first += 1


@compiled()
def eliminate(rows: FloatArray, a: int, size: int, L_t: FloatArray) -> None:
    """Row a of ``rows`` becomes that of L^-1 rows, those before it being so already; L_t is L^T."""
    b = 0
    while b + 4 <= a:
        h0, h1, h2, h3 = L_t[b, a], L_t[b + 1, a], L_t[b + 2, a], L_t[b + 3, a]
        for j in range(size):
            rows[a, j] -= h0 * rows[b, j] + h1 * rows[b + 1, j] + h2 * rows[b + 2, j] + h3 * rows[b + 3, j]
        b += 4
    while b < a:
        h0 = L_t[b, a]
        for j in range(size):
            rows[a, j] -= h0 * rows[b, j]
        b += 1
    h0 = 1.0 / L_t[a, a]
    for j in range(size):
        rows[a, j] *= h0


@compiled()
def innovation(P_touched: FloatArray, H: FloatArray, S: FloatArray) -> None:
    """S += H P_touched H^T; zeros of H cost nothing."""
    k, c = H.shape
    places, counts = entries_of(H)
    HP, PHt = np.empty((k, c)), np.empty((c, k))
    for a in range(k):
        combine(HP, a, c, H, places, counts[a], P_touched)
        for j in range(c):
            PHt[j, a] = HP[a, j]
    for a in range(k):
        combine(HP, a, k, H, places, counts[a], PHt)
        for b in range(k):
            S[a, b] += HP[a, b]


@compiled()
def observe(
    P: FloatArray,
    n: int,
    touched: IntArray,
    H: FloatArray,
    S: FloatArray,
    y: FloatArray,
    dx: FloatArray,
    blas: int,
) -> float:
    """Take in y = H (errors of the states touched) + noise; the NIS, NaN where it has no likelihood.

    ``S`` is the noise R when it comes, ``y`` becomes e, and ``dx`` (n,) the mean error given y. Where the NIS
    is NaN, P is what it was.
    """
    k, c = H.shape
    rows, W = np.empty((c, n)), np.empty((k, n))
    _rows(P, n, touched, rows)
    places, counts = entries_of(H)
    for a in range(k):
        combine(W, a, n, H, places, counts[a], rows)
    for b in range(k):
        for i in range(counts[b]):
            h, s = H[b, places[b, i]], touched[places[b, i]]
            for a in range(b, k):
                S[b, a] += h * W[a, s]
    if not factor(S):
        return np.nan
    nis = 0.0
    for a in range(k):
        for b in range(a):
            y[a] -= S[b, a] * y[b]
        y[a] /= S[a, a]
        nis += y[a] * y[a]
    if not math.isfinite(nis):
        return np.nan
    dx[:] = 0.0
    for a in range(k):
        eliminate(W, a, n, S)
        e = y[a]
        for j in range(n):
            dx[j] += e * W[a, j]
    downdate(P, n, W, blas)
    mirror_pose(P)
    return nis


@compiled()
def _rows(P: FloatArray, n: int, touched: IntArray, rows: FloatArray) -> None:
    """The rows of P (c, n) of the pose and of each landmark touched."""
    for i in range(3):
        rows[i] = P[i, :n]
    for t in range(3, touched.size, 2):
        s = touched[t]
        # Above the landmark its two columns lie side by side, from the landmark on its two rows.
        for j in range(s):
            rows[t, j], rows[t + 1, j] = P[j, s], P[j, s + 1]
        rows[t, s:] = P[s, s:n]
        rows[t + 1, s:] = P[s + 1, s:n]
        rows[t + 1, s] = P[s, s + 1]
