"""Published planar results reproduced: P1 (ukfm's SLAM benchmark), P2 (Huang 2010), P3 (Brossard 2018).

The short versions keep what few runs can show, the orders, paired over the same streams; the full ones
(``-m slow``) hold the published numbers to RMSE within 15 % and NEES within 25 %.
"""

from __future__ import annotations

import statistics
from typing import Any

import pytest

from slamcmp.backends.ekf_variants import (
    FirstEstimatesEkf,
    IdealEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.backends.robocentric_ekf import RobocentricEkf
from slamcmp.backends.ukf_slam import UkfSlam
from tests.anchors.planar import Errors, monte_carlo, p1, p2, p3
from tests.oracles.filters import Make, maker

UPDATE_FIRST = "update_first"
"""The protocol of all three: one stacked update, then new landmarks."""


def filters(*classes: Any) -> dict[str, Make]:
    return {one.__name__: maker(one, new_landmarks=UPDATE_FIRST) for one in classes}


def unscented(retraction: str) -> dict[str, Make]:
    return {retraction: maker(UkfSlam, retraction=retraction, new_landmarks=UPDATE_FIRST)}


def p1_numbers(errors: Errors) -> tuple[float, float, float, float]:
    """Heading RMSE [deg], position RMSE [m], NEES of heading and of position / 2, as ukfm prints them."""
    return (
        errors.heading_rmse_deg(),
        errors.position_rmse(),
        errors.mean_nees("heading_nees"),
        errors.mean_nees("position_nees") / 2,
    )


def test_p1_order_of_standard_and_right_invariant() -> None:
    """12 runs of 2500 steps. Published: 3.02 deg, 0.67 m, 2.88, 2.56 and 2.51 deg, 0.55 m, 1.01, 1.17."""
    errors = monte_carlo(p1(), filters(WorldEkf, RightInvariantEkf), seeds=range(12), steps=2500)
    standard, invariant = p1_numbers(errors["WorldEkf"]), p1_numbers(errors["RightInvariantEkf"])
    assert all(worse > better for worse, better in zip(standard, invariant, strict=True))
    # 12 runs: a NEES of one degree of freedom, all runs independent and each constant in time, lies in
    # chi²_12 / 12, 99.9 % of it within [0.19, 2.9]; the standard filter's position leaves no doubt.
    assert 0.19 < invariant[2] < 2.9
    assert 0.25 < invariant[3] < 2.4
    assert standard[2] > 1.4 * invariant[2]
    assert standard[3] > 1.4 * invariant[3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "published"),
    [
        (filters(WorldEkf), (3.02, 0.67, 2.88, 2.56)),
        (filters(RightInvariantEkf), (2.51, 0.55, 1.01, 1.17)),
        (unscented("additive"), (3.01, 0.67, 2.93, 2.63)),
        (unscented("right_invariant"), (2.51, 0.55, 1.01, 1.09)),
    ],
    ids=["ekf", "right_invariant", "ukf", "right_ukf"],
)
def test_p1_published_numbers(make: dict[str, Make], published: tuple[float, ...]) -> None:
    (errors,) = monte_carlo(p1(), make, seeds=range(100), steps=2500).values()
    numbers = p1_numbers(errors)
    print(published, numbers)
    assert numbers[:2] == pytest.approx(published[:2], rel=0.15)
    assert numbers[2:] == pytest.approx(published[2:], rel=0.25)


@pytest.mark.slow
def test_p1_left_ukf_is_the_worst_by_far() -> None:
    """Published: 3.30 deg, 0.75 m, NEES 10.38 and 118.6, which single runs decide: the order only."""
    (errors,) = monte_carlo(p1(), unscented("left_invariant"), seeds=range(100), steps=2500).values()
    heading, position, heading_nees, position_nees = p1_numbers(errors)
    print(heading, position, heading_nees, position_nees)
    assert heading > 3.02
    assert position > 0.67
    assert heading_nees > 5
    assert position_nees > 50


P2 = (IdealEkf, RightInvariantEkf, ObservabilityConstrainedEkf, FirstEstimatesEkf, WorldEkf)


def test_p2_order_of_the_consistent_filters() -> None:
    """8 runs on one map: ideal <= right-invariant <= OC <= FEJ << standard in position RMSE."""
    errors = monte_carlo(p2(map_seed=6), filters(*P2), seeds=range(8), steps=2500)
    position = [errors[one.__name__].mean_rmse()[0] for one in P2]
    nees = [errors[one.__name__].mean_nees("pose_nees") for one in P2]
    assert position == sorted(position)
    assert position[-1] > 1.5 * position[-2]
    assert nees[1:] == sorted(nees[1:])
    assert nees[-1] > 3 * nees[-2]


@pytest.mark.slow
def test_p2_order_over_forty_runs() -> None:
    """The order shows in consistency; in position, ideal and right-invariant are equal to 1 %.

    Medians over runs for NEES: FEJ's mean is one run's, not the filter's.
    """
    errors = monte_carlo(p2(map_seed=5), filters(*P2), seeds=range(40), steps=2500)
    position = [errors[one.__name__].mean_rmse()[0] for one in P2]
    nees = [statistics.median(errors[one.__name__].nees_of_runs()) for one in P2]
    print(position, nees)
    assert position[1] == pytest.approx(position[0], rel=0.03)
    assert position[1:] == sorted(position[1:])
    assert nees == sorted(nees)
    assert nees[-1] > 3 * nees[-2]


def test_p3_consistent_filters_are_equal_and_the_standard_one_is_not() -> None:
    """40 runs of 400 steps: RI, FEJ, OC, robocentric, ideal within 2 % of one another and consistent."""
    errors = monte_carlo(p3(map_seed=1), filters(*P2, RobocentricEkf), seeds=range(40), steps=400)
    position = {name: one.mean_rmse()[0] for name, one in errors.items()}
    nees = {name: one.mean_nees("pose_nees") for name, one in errors.items()}
    for name in ("FirstEstimatesEkf", "ObservabilityConstrainedEkf", "IdealEkf", "RobocentricEkf"):
        assert position[name] == pytest.approx(position["RightInvariantEkf"], rel=0.02)
        # chi²_120 / 40: 99.9 % within [1.87, 4.46], were a run's error the same at all times.
        assert 1.87 < nees[name] < 4.46
    assert position["WorldEkf"] > 1.05 * position["RightInvariantEkf"]
    assert nees["WorldEkf"] > 1.3 * nees["RightInvariantEkf"]


@pytest.mark.slow
def test_p3_over_a_hundred_runs() -> None:
    """Computed for another map: standard 0.264 m and NEES 5.73, the consistent filters 0.215 m and 3.00."""
    errors = monte_carlo(p3(map_seed=1), filters(*P2), seeds=range(100), steps=400)
    print({n: (one.position_rmse(), one.mean_nees("pose_nees")) for n, one in errors.items()})
    invariant = errors["RightInvariantEkf"]
    assert invariant.position_rmse() == pytest.approx(0.215, rel=0.15)
    assert invariant.mean_nees("pose_nees") == pytest.approx(3.0, rel=0.25)
    assert errors["WorldEkf"].position_rmse() > 1.05 * invariant.position_rmse()
    assert errors["WorldEkf"].mean_nees("pose_nees") > 1.3 * invariant.mean_nees("pose_nees")
