"""Shares of Gauss-Newton steps on parabolas of known curvature."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.relaxation import relaxed_share


@pytest.mark.parametrize("curvature", [1.6, 2.0, 3.0, 10.0])
def test_the_step_after_a_jump_ends_at_the_minimum(curvature: float) -> None:
    """Cost c x²/2 whose Gauss-Newton step is -x, as if c were 1: a step over the minimum, then onto it."""
    x, last_step, share = np.array([0.7]), None, 1.0
    for _ in range(2):
        step = -curvature * x
        share, last_step = relaxed_share(step, last_step, share), step
        x = x + share * step
    assert share == pytest.approx(1.0 / curvature)
    np.testing.assert_allclose(x, 0.0, atol=1e-15)


@pytest.mark.parametrize("curvature", [0.1, 0.9, 1.0, 1.4])
def test_whole_steps_are_taken_where_they_shrink(curvature: float) -> None:
    step = np.array([2.0, -1.0])
    assert relaxed_share((1.0 - curvature) * step, step, 1.0) == 1.0


def test_the_first_step_is_whole() -> None:
    assert relaxed_share(np.array([3.0]), None, 0.2) == 1.0


def test_a_share_says_the_same_of_the_curvature_as_a_whole_step() -> None:
    step = np.array([2.0, -1.0])
    assert relaxed_share((1.0 - 0.25 * 3.0) * step, step, 0.25) == pytest.approx(1.0 / 3.0)
