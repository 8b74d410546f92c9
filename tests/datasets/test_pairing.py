"""Pairs by time against all distances."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from slamcmp.datasets.pairing import nearest_in_time


@pytest.mark.parametrize("count", [1, 2, 50])
def test_nearest_of_all_in_any_order(count: int) -> None:
    rng = np.random.default_rng(count)
    # Nanoseconds since 1970, which floats would round.
    t = 1_403_715_273_262_142_976 + rng.integers(0, 10**6, 80)
    others = 1_403_715_273_262_142_976 + rng.integers(0, 10**6, count)
    index, off = nearest_in_time(t, others)
    distances = np.abs(others[None, :] - t[:, None])
    np.testing.assert_array_equal(off, distances.min(axis=1))
    np.testing.assert_array_equal(distances[np.arange(80), index], off)


def test_knowing_the_sources_needs_no_opencv() -> None:
    """Planar experiments list the sources too, and would pay for loading it."""
    code = "from slamcmp.registry import sources; import sys; sources.names(); sys.exit('cv2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
