"""How many landmarks a world needs, so that a stated number is in sight on average."""

from __future__ import annotations

from slamcmp.errors import UsageError
from slamcmp.types import BoolArray


def landmarks_for(in_view: float, seen: BoolArray) -> int:
    """The number of landmarks of which on average ``in_view`` are seen from one place.

    Args:
        in_view: wanted, > 0.
        seen: of equally likely places of a landmark those that are in sight.

    Raises:
        UsageError: none of them is.
    """
    share = float(seen.mean())
    if share == 0.0:
        raise UsageError(
            f"in_view is {in_view:g}, and no landmark would ever be in sight: range, field of view and where "
            "landmarks may stand do not meet"
        )
    return max(1, round(in_view / share))
