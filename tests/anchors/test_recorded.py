"""P6, Victoria Park's published optima, with both residuals."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.anchors.shipped import verdict_of


@pytest.mark.slow
def test_p6_batch_reaches_the_optimum_that_the_ekf_is_far_from(tmp_path: Path) -> None:
    for value in verdict_of("p6", tmp_path).values:
        assert value.verdict == "inside", value
