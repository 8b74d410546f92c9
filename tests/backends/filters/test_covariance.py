"""The in-place covariance against plain numpy on full matrices, in both layouts."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.filters.covariances.covariance import FULL_LIMIT, JointCovariance, block_diagonal


def run_verbs(landmarks: int, size: int, p: int, seed: int) -> tuple[JointCovariance, np.ndarray]:
    """The same random sequence of verbs on a JointCovariance and on a dense matrix."""
    rng = np.random.default_rng(seed)

    def spd(n: int) -> np.ndarray:
        A = rng.normal(size=(n, n))
        return A @ A.T + n * np.eye(n)

    dense = spd(p)
    P = JointCovariance(dense)
    while P.size < p + size * landmarks:
        A, Q = np.linalg.qr(rng.normal(size=(p, p)))[0], spd(p)
        P.propagate(A, Q)
        F = np.eye(len(dense))
        F[:p, :p] = A
        dense = F @ dense @ F.T
        dense[:p, :p] += Q

        new = int(rng.integers(1, 8)) * size
        G, N = rng.normal(size=(new, p)), spd(new)
        P.augment(G, N)
        F = np.vstack([np.eye(len(dense)), np.hstack([G, np.zeros((new, len(dense) - p))])])
        dense = F @ dense @ F.T
        dense[-new:, -new:] += N

        chosen = rng.choice((P.size - p) // size, size=min(4, (P.size - p) // size), replace=False)
        states = np.concatenate([np.arange(p), (p + size * chosen[:, None] + np.arange(size)).ravel()])
        columns = P.columns(states, size)
        np.testing.assert_allclose(columns, dense[:, states], rtol=1e-11, atol=1e-11 * np.abs(dense).max())
        H = np.zeros((6, len(dense)))
        H[:, states] = rng.normal(size=(6, states.size))
        S = H @ dense @ H.T + np.eye(6) * np.abs(dense).max()
        W_t = np.linalg.solve(np.linalg.cholesky(S), H @ dense)
        P.downdate(W_t)
        dense = dense - W_t.T @ W_t
    return P, dense


@pytest.mark.parametrize(("landmarks", "size", "p"), [(40, 2, 3), (200, 2, 3), (120, 3, 6)])
def test_verbs_match_dense_algebra_across_the_layout_change(landmarks: int, size: int, p: int) -> None:
    P, dense = run_verbs(landmarks, size, p, seed=landmarks)
    assert (P.size > FULL_LIMIT) == (landmarks > 100)
    scale = np.abs(dense).max()
    np.testing.assert_allclose(P.dense(), dense, atol=1e-10 * scale)
    np.testing.assert_array_equal(P.dense(), P.dense().T)
    np.testing.assert_allclose(P.pose_block(), dense[:p, :p], atol=1e-10 * scale)
    blocks = P.diagonal_blocks(size)
    for number in (0, landmarks // 2, landmarks - 1):
        at = slice(p + size * number, p + size * (number + 1))
        np.testing.assert_allclose(blocks[number], dense[at, at], atol=1e-10 * scale)


def test_downdate_works_in_place_above_the_limit() -> None:
    """f2py copies a matrix it cannot pass on, silently; then the buffer would not change."""
    P = JointCovariance(np.eye(3))
    P.augment(np.zeros((400, 3)), np.eye(400))
    before = P._buffer
    W_t = np.zeros((1, 403))
    W_t[0, 7] = 0.5
    P.downdate(W_t)
    assert P._buffer is before
    assert P.dense()[7, 7] == 0.75


def test_block_diagonal_places_rectangular_blocks() -> None:
    blocks = np.arange(12.0).reshape(2, 2, 3)
    expected = np.zeros((4, 6))
    expected[:2, :3], expected[2:, 3:] = blocks
    np.testing.assert_array_equal(block_diagonal(blocks), expected)
