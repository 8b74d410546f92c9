"""Synthetic matches of a rigid scene in two views, with known truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.geometry import exp, hat, inverse, transform

K = np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]])
TURN = np.array([0.02, -0.06, 0.03])


@dataclass(frozen=True)
class TwoViews:
    first: np.ndarray
    second: np.ndarray
    right: np.ndarray
    """Which matches are correct, (m,)."""
    F: np.ndarray
    """The true fundamental matrix, of norm 1 (zero without translation)."""


def two_views(
    seed: int,
    count: int = 300,
    *,
    wrong: float = 0.0,
    noise_px: float = 0.4,
    plane: bool = False,
    translation: tuple[float, float, float] = (0.5, 0.05, 0.15),
    turn: np.ndarray = TURN,
) -> TwoViews:
    """Points 3 to 9 m away (or on one slanting plane); a share of the matches replaced by random pixels."""
    rng = np.random.default_rng(seed)
    first = rng.uniform([20, 20], [620, 460], (count, 2))
    rays = np.column_stack([(first - K[:2, 2]) / 400.0, np.ones(count)])
    # The plane 0.3 x + 0.2 y + z = 5 m.
    depth = 5.0 / (rays @ [0.3, 0.2, 1.0]) if plane else rng.uniform(3.0, 9.0, count)
    T_1_2 = exp(np.concatenate([turn, np.zeros(3)]))
    T_1_2[:3, 3] = translation
    T_2_1 = inverse(T_1_2)
    seen = transform(T_2_1, rays * depth[:, None]) @ K.T
    second = seen[:, :2] / seen[:, 2:]
    K_inv = np.linalg.inv(K)
    F = K_inv.T @ hat(T_2_1[:3, 3]) @ T_2_1[:3, :3] @ K_inv
    F /= max(np.linalg.norm(F), 1e-300)
    first = first + noise_px * rng.standard_normal((count, 2))
    second = second + noise_px * rng.standard_normal((count, 2))
    bad = rng.permutation(count)[: round(wrong * count)]
    right = np.ones(count, dtype=bool)
    right[bad] = False
    second[bad] = rng.uniform([0, 0], [640, 480], (bad.size, 2))
    return TwoViews(first, second, right, F)
