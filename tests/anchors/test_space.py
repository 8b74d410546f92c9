"""P4, the 3-D study of Zhang, Wu and Huang 2017: who stays consistent in space."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.anchors.shipped import verdict_of


def test_p4_right_invariant_stays_consistent_and_the_standard_filter_does_not(tmp_path: Path) -> None:
    """5 runs of 125 steps; published pose NEES / 6 over 100 runs of 500 steps: 1.01 and 3.1."""
    small = {"steps": 126, "loops": 2.0, "landmarks": 100, "range_max_m": 30.0}
    labels = ["right-invariant EKF", "SO(3)xR EKF"]
    verdict = verdict_of("p4", tmp_path, runs=5, labels=labels, source=small)
    noisy = [each for each in verdict.values if each.at["source.noise_scale"] == 5.0]
    nees = {each.label: each.measured for each in noisy if each.metric == "ensemble_nees_pose"}
    # chi²_30 / 30, were a run's error the same at all times: 99.9 % within [0.35, 2.1].
    assert 0.35 < nees["right-invariant EKF"] < 2.1
    assert nees["SO(3)xR EKF"] > nees["right-invariant EKF"]


@pytest.mark.slow
def test_p4_comes_out_as_published(tmp_path: Path) -> None:
    """RMSE within 15 %, NEES within 25 %: the right-invariant filter at 1 % and 5 % noise, FEJ at 5 %; there
    the published order, in which right-invariant and FEJ are 1 % apart, and a standard filter far off.
    FEJ and the standard filter at 1 % and the robocentric one are better here than published."""
    verdict = verdict_of("p4", tmp_path)
    for value in verdict.values:
        at_5 = value.at["source.noise_scale"] == 5.0
        if value.label == "right-invariant EKF" or (value.label == "FEJ-EKF" and at_5):
            assert abs(value.deviation) < (0.15 if "rmse" in value.metric else 0.25), value
        if value.label == "SO(3)xR EKF" and at_5 and value.metric == "ensemble_nees_pose":
            assert value.measured > 2.0
    for order in verdict.orders:
        assert order.verdict != "violated", order
        if order.at["source.noise_scale"] == 5.0:
            assert order.pairs[-1].verdict == "held", order
            assert order.verdict == "held" or order.metric != "ensemble_nees_pose", order
            assert order.factor > 1.4
