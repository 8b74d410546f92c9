"""Nullity and information of roots whose answers are known, and the last values of series."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamcmp.metrics import metric_columns, score_run
from slamcmp.metrics.observability import last_value, nullity, unanchored_information
from slamcmp.types import Run, Trajectory


def test_nullity_counts_directions_below_the_jacobians_size() -> None:
    """Column sizes 100 and 1e-3 (metres and radians): only the share of each counts."""
    scale = np.array([100.0, 100.0, 1e-3])
    assert nullity(np.zeros((3, 3)), scale) == 3
    assert nullity(np.diag([1e-6, 1e-6, 1e-7]), scale) == 2
    assert nullity(np.diag([1e-2, 1e-6, 1e-7]), scale) == 1
    assert nullity(np.diag([1e-2, 1.0, 1e-7]), scale) == 0


def test_a_direction_may_be_a_mixture() -> None:
    """Knowing x + y alone leaves two directions; a third row that repeats it changes nothing."""
    root = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    assert nullity(root, np.ones(3)) == 2


def test_a_pose_that_no_jacobian_holds_is_unobservable() -> None:
    assert nullity(np.zeros((3, 3)), np.zeros(3)) == 3


def test_information_by_hand() -> None:
    """|R v|² of unit turns and shifts: planar (x, y, theta), spatial (omega, v)."""
    assert unanchored_information(np.diag([1.0, 2.0, 3.0])) == (9.0, 5.0)
    root = np.zeros((6, 6))
    root[0, :] = [1.0, 2.0, 2.0, 0.0, 3.0, 4.0]
    assert unanchored_information(root) == (9.0, 25.0)


def a_run(**series: list[float]) -> Run:
    t = np.arange(4.0)
    return Run(
        back_end="ekf",
        parameters={},
        digest="0",
        seed=0,
        frames=4,
        status="ok",
        message="",
        online=Trajectory(t, np.tile(np.eye(3), (4, 1, 1))),
        update_s=np.full(4, math.nan),
        estimate_s=np.full(4, math.nan),
        diagnostics={name: np.array(values) for name, values in series.items()},
    )


def test_scores_of_a_run_are_the_last_values_of_its_series() -> None:
    nan = math.nan
    run = a_run(
        nullity=[nan, 3, nan, 2],
        spurious_turn_per_rad2=[nan, 0.5, 7.0, nan],
        spurious_shift_per_m2=[nan, 0.0, 0.0, nan],
        drift_landmarks_m=[0.1, nan, 0.9, 0.2],
        kl_from_batch=[nan, 4.0, 1.0, 9.0],
    )
    scores = score_run(run, None)
    assert scores["nullity"] == 2
    assert scores["spurious_turn_per_rad2"] == 7.0
    assert scores["spurious_shift_per_m2"] == 0.0
    assert scores["linearisation_drift"] == pytest.approx(0.2)
    assert (scores["kl_from_batch"], scores["kl_from_batch_median"]) == (9.0, 4.0)
    # A run that records tells no times, not times of zero.
    assert math.isnan(scores["update_s"])
    assert math.isnan(scores["update_median_ms"])


def test_a_run_that_recorded_nothing_has_no_such_scores() -> None:
    scores = score_run(a_run(), None)
    assert math.isnan(last_value(a_run(nullity=[math.nan] * 4), "nullity"))
    for name in ("nullity", "spurious_turn_per_rad2", "linearisation_drift", "kl_from_batch"):
        assert math.isnan(scores[name])


def test_units() -> None:
    columns = metric_columns()
    names = ("spurious_turn_per_rad2", "spurious_shift_per_m2", "linearisation_drift", "kl_from_batch")
    assert [columns[name].unit for name in names] == ["1/rad²", "1/m²", "m", "nat"]
