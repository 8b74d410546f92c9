"""Parts of a gap: exact sums."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.errors import DataError
from slamcmp.metrics.attribution import telescoped


def test_parts_by_hand_and_their_sum() -> None:
    scores = np.array([[5.0, 4.0, 4.5, 1.0], [2.0, 2.5, 2.5, 2.0]])
    parts = telescoped(scores)
    np.testing.assert_allclose(parts, [[1.0, -0.5, 3.5], [-0.5, 0.0, 0.5]])
    np.testing.assert_allclose(parts.sum(axis=1), [4.0, 0.0])


def test_one_stage_has_no_gap() -> None:
    with pytest.raises(DataError, match="at least 2 stages"):
        telescoped(np.ones((3, 1)))
