"""What an estimator would know about its pose from measurements alone, had it known nothing at the start.

Nothing that a robot measures tells where in the world its map lies: a correct estimator would know nothing.
One whose Jacobians do not fit each other takes information about directions that no measurement sees; this
module lets its own linear system run a second time, without the prior on the first pose, and asks what is
left on the current pose once the map is eliminated. The null space of that information is carried by the
steps from that of the observability matrix [H_0; H_1 F_1; H_2 F_2 F_1; …] (Huang, Mourikis, Roumeliotis 2010,
eq. 22), so both have the same nullity: a row is zero for a direction exactly if the direction costs nothing.

The information is kept as a square root, as rows of R with cost |R x|² (Bierman 1977, ch. V and VI), because
zero is then told from rounding at 1e-16 of the Jacobians and not of their squares.

The numbers that filters (filters/unanchored.py) and windows (window/unanchored.py) tell, and their algebra.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.types import FloatArray


@dataclass(frozen=True)
class Linearisation:
    """What a frame's linear system claims, and where its Jacobians were taken."""

    root: FloatArray
    """Square root (p, p) of the information about the current pose without a start, in the body tangent:
    its square is zero for a correct estimator."""
    scale: FloatArray
    """(p,): root-sum-square of the whitened observations' Jacobians by the pose, to judge zero by."""
    T_world_body: FloatArray | None = None
    """Pose (n+1, n+1) of the frame's observation Jacobians; None where there are none."""
    landmarks_at: FloatArray | None = None
    """Landmarks (m, n) of the frame's observation Jacobians."""
    landmarks: FloatArray | None = None
    """Where the estimate now has them, (m, n)."""


def triangular(rows: FloatArray) -> FloatArray:
    """The triangular factor of rows (m, c): the same cost in at most c rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def last_block(R: FloatArray, p: int) -> FloatArray:
    """The last block (p, p) of a triangular factor that may lack its last rows."""
    block = R[R.shape[1] - p :, -p:]
    return np.pad(block, ((0, p - len(block)), (0, 0)))
