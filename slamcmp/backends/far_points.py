"""When points of linearisation that stay behind are too far from the estimates that moved on.

Whatever keeps first estimates (FEJ) or the null space that they span (OC) computes every later correction
for points of the past. A correction of the heading moves a landmark at r from the robot by as much as r is
long, and was computed for r + d. Where it is wholly trusted it leaves |d| / |r + d| of what it should have
removed: from |d| = |r| on it may help nothing, and beyond it makes more of it, time after time. No
correction is wholly trusted, so a filter lives beyond that, until the errors that it makes are larger than
those that it removes. They grow from one landmark on, while the others of a frame are in place: the farthest
counts, not the mean.

========  ===================================================================
symbol    meaning
========  ===================================================================
r + d     a landmark from the robot by the points of linearisation, (m, n)
r         the same by the estimates, (m, n)
========  ===================================================================
"""

from __future__ import annotations

import math

from slamcmp.errors import DivergedError
from slamcmp.types import FloatArray

FARTHEST = 5.0
"""How far a landmark's point of linearisation may lie from its estimate, both as the robot sees them, in
units of the distance from which landmarks were placed.

In the published loops of P2, which all filters survive, the farthest of fifty runs is at 4.0 (FEJ, seed
33). A toy world with twenty times the usual noise passes 5 while FEJ and OC filters still err by less than
20 m; left alone they go on to 2000 km and to 54 m, where the plain filter stays within 8 m."""


class FarPoints:
    """Compares points with estimates, in units of the distance from which landmarks were placed.

    That distance, root-mean-square over all landmarks so far, is what was measured when they were new: pose
    and map of a filter that diverges fly apart together, and the distances between them grow with its
    errors.
    """

    def __init__(self) -> None:
        self._squares, self._placed = 0.0, 0

    def placed(self, r: FloatArray) -> None:
        """Count landmarks that are new, (m, n) from the robot."""
        self._squares += float((r**2).sum())
        self._placed += len(r)

    def require_near(self, k: int, r_at: FloatArray, r: FloatArray) -> None:
        """Compare landmarks by the points (m, n) with the same by the estimates, both from the robot.

        Args:
            k: the frame, for the message.
            r_at, r: see the module.

        Raises:
            DivergedError: one of them lies farther off than :data:`FARTHEST` times the distance of landmarks.
        """
        if not len(r):
            return
        distance = math.sqrt(self._squares / self._placed)
        apart = math.sqrt(float(((r_at - r) ** 2).sum(axis=1).max()))
        if apart > FARTHEST * distance:
            raise far_off(k, apart, distance)


def far_off(k: int, apart: float, distance: float) -> DivergedError:
    """What a filter says in frame k whose points lie ``apart`` from the estimates.

    Landmarks were placed from a ``distance``; both in metres.
    """
    return DivergedError(
        f"frame {k}: first-estimate Jacobians are far from the estimates, a landmark's by "
        f"{apart:.3g} m where landmarks were placed from {distance:.3g} m; the map has "
        "moved too far since"
    )
