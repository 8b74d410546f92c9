"""P7, towns like that of cityTrees10000: a healthy NIS, a filter astray, and what alignment hides."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.anchors.shipped import measured, verdict_of


def check(found: dict[str, dict[str, float]], nees: float, odometry: float, left: float) -> None:
    """At least: the EKF's NEES and odometry's error over the EKF's; at most: the share of the EKF's error
    that alignment leaves. All online, as a filter's columns are."""
    assert found["online_pose_nees"]["EKF"] > nees
    assert found["online_ate"]["odometry"] > odometry * found["online_ate"]["EKF"]
    assert found["online_ate_aligned"]["EKF"] < left * found["online_ate"]["EKF"]


def test_p7_in_a_short_drive(tmp_path: Path) -> None:
    """3 towns, 1500 steps: 3900 degrees of freedom, 99.9 % of their chi-square per dof in 1 +- 0.075."""
    verdict = verdict_of("p7", tmp_path, runs=3, source={"steps": 1500})
    found = measured(verdict)
    assert found["chi2_per_dof"]["batch"] == pytest.approx(1.0, abs=0.075)
    assert found["nis_per_dof"]["EKF"] == pytest.approx(1.0, abs=0.075)
    check(found, nees=6.0, odometry=3.0, left=0.75)


@pytest.mark.slow
def test_p7_over_ten_thousand_steps(tmp_path: Path) -> None:
    verdict = verdict_of("p7", tmp_path)
    for value in verdict.values:
        assert value.verdict in ("inside", "not judged"), value
    for order in verdict.orders:
        # Of fewer than 20 towns no interval is told.
        assert order.verdict in ("held", "tie", "too few runs"), order
        assert order.pairs[-1].verdict in ("held", "too few runs"), order
    check(measured(verdict), nees=9.0, odometry=5.0, left=0.75)
