"""The motion between any two instants, from odometry of any kind; planar.

========  =====================================================================
symbol    meaning
========  =====================================================================
T(t)      pose of the body since the first row, from the odometry alone
W         diag of the noise's densities, [m²/s, m²/s, rad²/s], body tangent
A         adjoint of an increment's inverse: carries an error over it
========  =====================================================================

Increments may have covariances of their own (columns cov), in the tangent of their end; a part of one has its
share of them. Velocities and wheel counts hold until the next row (zero-order hold): an increment is
``exp((v, 0, omega) dt)``. Between increments and poses the motion is interpolated along the geodesic, the
path of constant velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.datasets.plain.column_files import Table
from slamcmp.errors import DataError
from slamcmp.geometry import adjoint_of_inverse, exp, inverse, local, se2
from slamcmp.types import FloatArray

KINDS = {
    "velocities": ("v", "omega"),
    "increments": ("dx", "dy", "dtheta"),
    "wheel counts": ("left", "right"),
    "poses": ("x", "y", "theta"),
}
"""Of each kind of odometry the columns beside ``t``."""

COVARIANCE = ("cov_xx", "cov_xy", "cov_xtheta", "cov_yy", "cov_ytheta", "cov_thetatheta")
"""Upper triangle of an increment's covariance."""


@dataclass(frozen=True)
class Motion:
    """Odometry rows as twists that hold from one stamp to the next."""

    t: FloatArray
    """(K,) [s], increasing."""
    twists: FloatArray
    """(K - 1, 3): body velocities [m/s, m/s, rad/s] between the stamps."""
    P: FloatArray | None = None
    """(K - 1, 3, 3): covariances of the motion from stamp to stamp, in the tangent at its end."""

    def between(self, start: float, end: float, densities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Increment (3, 3) and its covariance (3, 3) in the tangent at ``end``, within the rows' time.

        ``densities`` (3,) are sigmas of the velocities' white noise along x, y and about z, per sqrt(s); the
        rows' own covariances, where they have them, stand in their place.
        """
        first = int(np.searchsorted(self.t, start, side="right")) - 1
        T, Q = np.eye(3), np.zeros((3, 3))
        W = np.diag(np.square(densities))
        at = start
        for k in range(max(first, 0), len(self.twists)):
            until = min(end, float(self.t[k + 1]))
            dt = until - at
            if dt > 0:
                step = exp(self.twists[k] * dt)
                A = adjoint_of_inverse(step)
                added = W * dt
                if self.P is not None:
                    added = self.P[k] * (dt / float(self.t[k + 1] - self.t[k]))
                T, Q, at = T @ step, A @ Q @ A.T + added, until
            if until >= end:
                break
        return T, 0.5 * (Q + Q.T)


def read_motion(
    table: Table, *, metres_per_tick: float | None, track_m: float | None, offset_s: float = 0.0
) -> Motion:
    """The odometry of a table, its stamps moved by ``offset_s``.

    Raises:
        DataError: no or two kinds of odometry, fewer than two rows, stamps that do not increase, or wheel
            counts without their scale.
    """
    kinds = [kind for kind, columns in KINDS.items() if table.has("t", *columns)]
    if len(kinds) != 1:
        wanted = "; ".join(f"{kind}: t, {', '.join(columns)}" for kind, columns in KINDS.items())
        found = " and ".join(kinds) or "none"
        raise DataError(f"{table.path}: odometry is one of ({wanted}), with units; found {found}")
    t = table.columns["t"] + offset_s
    if t.size < 2:
        raise DataError(f"{table.path}: {t.size} row(s) of odometry; at least two are needed")
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        raise DataError(
            f"{table.where(int(back[0]) + 1)}: time {t[back[0] + 1]:.9g} s does not come after "
            f"{t[back[0]]:.9g} s of "
            "the row before; 'slamcmp data check' lists all such rows"
        )
    dt = np.diff(t)[:, None]
    columns = [table.columns[name] for name in KINDS[kinds[0]]]
    if kinds[0] == "velocities":
        v, omega = columns
        return Motion(t, np.stack([v, np.zeros_like(v), omega], axis=1)[:-1])
    if kinds[0] == "wheel counts":
        if metres_per_tick is None or track_m is None:
            raise DataError(f"{table.path}: wheel counts need metres_per_tick and track_m")
        left, right = (metres_per_tick * np.diff(each) for each in columns)
        return Motion(t, np.stack([(left + right) / 2, 0 * left, (right - left) / track_m], axis=1) / dt)
    T = se2(*columns)
    steps = T[1:] if kinds[0] == "increments" else inverse(T[:-1]) @ T[1:]
    P = _covariances(table) if kinds[0] == "increments" else None
    return Motion(t, local(np.eye(3), steps) / dt, P)


def _covariances(table: Table) -> FloatArray | None:
    """(K - 1, 3, 3) of the increments after the first row; None for a table without.

    Raises:
        DataError: some of the columns are missing, or one is no covariance.
    """
    found = [name for name in COVARIANCE if name in table.columns]
    if not found:
        return None
    if len(found) < len(COVARIANCE):
        missing = next(name for name in COVARIANCE if name not in found)
        raise DataError(f"{table.path}: has {', '.join(found)}, and no {missing}; all six are needed")
    P = np.zeros((len(table.lines), 3, 3))
    upper = np.triu_indices(3)
    P[:, upper[0], upper[1]] = P[:, upper[1], upper[0]] = np.stack(
        [table.columns[name] for name in COVARIANCE], axis=1
    )
    smallest = np.linalg.eigvalsh(P)
    bad = np.flatnonzero(smallest[:, 0] < -1e-9 * np.abs(smallest[:, -1]))
    if bad.size:
        raise DataError(
            f"{table.where(int(bad[0]))}: its cov columns are no covariance: negative along one axis"
        )
    return P[1:]
