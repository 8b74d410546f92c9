"""The joint covariance in a block's memory: what moves, grows and corrects it, by all threads together.

Of P (n, n) the upper triangle is valid, row by row; the pose's three states come first.

========  =====================================================================
symbol    meaning
========  =====================================================================
H         Jacobian, a row by the pose's three states and its own landmark's two, (k, 5)
S, L      innovation covariance (k, k), upper triangle; S = L L^T, L^T in its place
W         L^-1 H P, and in column n the vector L^-1 y, (k, n + 1)
========  =====================================================================
"""

from __future__ import annotations

import math

from slamcmp.ensembles.kernels.target import body, lane, lanes, sync
from slamcmp.types.arrays import FloatArray, IntArray


@body
def move(P: FloatArray, n: int, f0: float, f1: float, noise: FloatArray) -> None:
    """P = F P F^T + noise on the pose, F being the identity but for f0 and f1 in the heading's column."""
    for j in range(3 + lane(), n, lanes()):
        P[0, j] += f0 * P[2, j]
        P[1, j] += f1 * P[2, j]
    if lane() == 0:
        a, b, c, d, e, f = P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]
        P[0, 0] = a + 2.0 * f0 * c + f0 * f0 * f + noise[0, 0]
        P[0, 1] = b + f0 * e + f1 * c + f0 * f1 * f + noise[0, 1]
        P[0, 2] = c + f0 * f + noise[0, 2]
        P[1, 1] = d + 2.0 * f1 * e + f1 * f1 * f + noise[1, 1]
        P[1, 2] = e + f1 * f + noise[1, 2]
        P[2, 2] = f + noise[2, 2]
    sync()


@body
def shake(P: FloatArray, n: int, landmarks: FloatArray, x: float, y: float, noise: FloatArray) -> None:
    """P += [I; -B] noise [I; -B]^T: in the right-invariant chart landmarks turn with the heading's noise.

    B has a column for the heading alone, the landmark's lever from the start (x, y) turned by a right angle.
    """
    for i in range(3 + lane(), n, lanes()):
        of, axis = (i - 3) // 2, (i - 3) % 2
        u = y - landmarks[of, 1] if axis == 0 else landmarks[of, 0] - x
        P[0, i] -= noise[0, 2] * u
        P[1, i] -= noise[1, 2] * u
        P[2, i] -= noise[2, 2] * u
        u *= noise[2, 2]
        if axis == 0:
            P[i, i] += u * (y - landmarks[of, 1])
        P[i, 4 + 2 * of] += u * (landmarks[of, 0] - x)
        for other in range(of + 1, (n - 3) // 2):
            P[i, 3 + 2 * other] += u * (y - landmarks[other, 1])
            P[i, 4 + 2 * other] += u * (landmarks[other, 0] - x)
    if lane() == 0:
        for i in range(3):
            for j in range(i, 3):
                P[i, j] += noise[i, j]
    sync()


@body
def grow(P: FloatArray, n: int, G: FloatArray, N: FloatArray) -> None:
    """Two new states, G (2, 3) times the pose's error plus noise N (2, 2); each thread has its own G, N."""
    for j in range(lane(), n, lanes()):
        p0, p1, p2 = P[min(0, j), j], P[min(1, j), max(1, j)], P[min(2, j), max(2, j)]
        P[j, n] = G[0, 0] * p0 + G[0, 1] * p1 + G[0, 2] * p2
        P[j, n + 1] = G[1, 0] * p0 + G[1, 1] * p1 + G[1, 2] * p2
    sync()
    if lane() == 0:
        P[n, n] = P[0, n] * G[0, 0] + P[1, n] * G[0, 1] + P[2, n] * G[0, 2] + N[0, 0]
        P[n, n + 1] = P[0, n + 1] * G[0, 0] + P[1, n + 1] * G[0, 1] + P[2, n + 1] * G[0, 2] + N[0, 1]
        P[n + 1, n + 1] = P[0, n + 1] * G[1, 0] + P[1, n + 1] * G[1, 1] + P[2, n + 1] * G[1, 2] + N[1, 1]
    sync()


@body
def project(P: FloatArray, n: int, H: FloatArray, own: IntArray, k: int, W: FloatArray) -> None:
    """W = H P; ``own`` (k / 2,) is where each landmark's states begin."""
    for a in range(k):
        s = own[a // 2]
        h0, h1, h2, h3, h4 = H[a, 0], H[a, 1], H[a, 2], H[a, 3], H[a, 4]
        for j in range(lane(), 3, lanes()):
            W[a, j] = (
                h0 * P[min(0, j), max(0, j)]
                + h1 * P[min(1, j), max(1, j)]
                + h2 * P[min(2, j), max(2, j)]
                + h3 * P[j, s]
                + h4 * P[j, s + 1]
            )
        for j in range(3 + lane(), s, lanes()):
            W[a, j] = h0 * P[0, j] + h1 * P[1, j] + h2 * P[2, j] + h3 * P[j, s] + h4 * P[j, s + 1]
        for j in range(s + lane(), n, lanes()):
            below = P[s, s + 1] if j == s else P[s + 1, j]
            W[a, j] = h0 * P[0, j] + h1 * P[1, j] + h2 * P[2, j] + h3 * P[s, j] + h4 * below
    sync()


@body
def innovation(
    H: FloatArray, own: IntArray, k: int, W: FloatArray, first: float, second: float, S: FloatArray
) -> None:
    """S = H P H^T + R, R being diagonal with two variances in turn; upper triangle."""
    for b in range(lane(), k, lanes()):
        s = own[b // 2]
        for a in range(b + 1):
            S[a, b] = (
                H[b, 0] * W[a, 0]
                + H[b, 1] * W[a, 1]
                + H[b, 2] * W[a, 2]
                + H[b, 3] * W[a, s]
                + H[b, 4] * W[a, s + 1]
            )
        S[b, b] += first if b % 2 == 0 else second
    sync()


@body
def factor(S: FloatArray, k: int) -> bool:
    """L^T in the upper triangle of S, in place; False where S is not positive definite."""
    for b in range(k):
        pivot = S[b, b]
        if not pivot > 0.0:
            return False
        root = math.sqrt(pivot)
        sync()
        for a in range(b + lane(), k, lanes()):
            S[b, a] = S[b, a] / root
        sync()
        for a in range(b + 1 + lane(), k, lanes()):
            for c in range(a, k):
                S[a, c] -= S[b, a] * S[b, c]
        sync()
    return True


@body
def eliminate(S: FloatArray, k: int, W: FloatArray, columns: int) -> None:
    """W = L^-1 W; every thread has columns of its own."""
    for a in range(k):
        for b in range(a):
            h = S[b, a]
            for j in range(lane(), columns, lanes()):
                W[a, j] -= h * W[b, j]
        scale = 1.0 / S[a, a]
        for j in range(lane(), columns, lanes()):
            W[a, j] *= scale
    sync()


@body
def downdate(P: FloatArray, n: int, W: FloatArray, k: int, dx: FloatArray) -> None:
    """P -= W^T W, and the mean error ``dx`` (n,) = W^T L^-1 y."""
    for j in range(lane(), n, lanes()):
        dx[j] = 0.0
    for a in range(k):
        e = W[a, n]
        for j in range(lane(), n, lanes()):
            dx[j] += e * W[a, j]
    for i in range(n):
        # Lanes begin at a fixed column, so that each element is always the same thread's.
        for a in range(k):
            h = W[a, i]
            for j in range(i + lane(), n, lanes()):
                P[i, j] -= h * W[a, j]
    sync()
