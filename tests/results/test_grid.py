"""Grid points, their rows and their names; which rows are chosen for a reader."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.results.grid import (
    at_point,
    grid_points,
    has_values,
    labels,
    middle_point,
    milliseconds_per_frame,
    point_name,
    pose_dimension,
    reference_name,
    trial_name,
    value_text,
)
from tests.results.hand_made import results_of, runs

GATE, NOISE = "front_end.gate_probability", "source.noise_scale"


def test_a_swept_null_is_a_point_of_its_own() -> None:
    rows = (
        runs("A", [1.0], **{GATE: None}) + runs("A", [2.0], **{GATE: 0.99}) + runs("A", [3.0], **{GATE: None})
    )
    trials = results_of(rows).trials
    points = grid_points(trials)
    assert len(points) == 2
    assert at_point(trials, points[0])["online_ate"].tolist() == [1.0, 3.0]
    assert at_point(trials, {GATE: None})["online_ate"].tolist() == [1.0, 3.0]
    assert at_point(trials, points[1])["online_ate"].tolist() == [2.0]
    assert [point_name(point) for point in points] == ["gate probability = none", "gate probability = 0.99"]


def test_points_come_in_the_tables_order_and_hold_every_path() -> None:
    rows = [{"seed": 0, NOISE: noise, "source.steps": steps} for noise in (4.0, 0.5) for steps in (20, 10)]
    trials = results_of(rows).trials
    assert grid_points(trials) == [{NOISE: n, "source.steps": s} for n in (4.0, 0.5) for s in (20, 10)]
    assert len(at_point(trials, {NOISE: 0.5})) == 2
    assert grid_points(results_of(runs("A", [1.0])).trials) == [{}]
    # A path that the table does not have leaves all its rows.
    assert len(at_point(trials, {"back_ends.A.window": 3})) == 4


def test_the_middle_point_is_one_with_a_finished_run() -> None:
    def at(noise: float, status: str) -> dict[str, object]:
        return {"seed": 0, NOISE: noise, "status": status, "trial": int(10 * noise)}

    failed = results_of([at(0.1, "ok"), at(0.2, "crashed"), at(0.3, "ok")])
    assert middle_point(failed) == {NOISE: 0.3}
    assert middle_point(results_of([at(n, "ok") for n in (0.1, 0.2, 0.3)])) == {NOISE: 0.2}
    assert middle_point(results_of([at(n, "crashed") for n in (0.1, 0.2, 0.3)])) == {NOISE: 0.2}


def test_the_typical_trial_is_one_that_all_finished() -> None:
    """Errors of the trials: 1, 2, 3, 4 (mean of two back ends); B failed in the one of 2."""
    rows = runs("A", [1.0, 2.0, 3.0, 4.0]) + runs("B", [1.0, 2.0, 3.0, 4.0], failed=(1,))
    assert typical_trial(results_of(rows)) == 2
    # Of an even number the lower middle one; of trials that nobody finished whole, any finished run counts.
    assert typical_trial(results_of(runs("A", [4.0, 3.0, 2.0, 1.0]))) == 2
    rows = runs("A", [1.0, 2.0, 5.0], failed=(0,)) + runs("B", [9.0, 8.0, 7.0], failed=(1, 2))
    assert typical_trial(results_of(rows)) == 2
    nothing = replace(results_of(rows), trials=results_of(rows).trials[:0])
    with pytest.raises(NotDrawable, match="no trial"):
        typical_trial(nothing)


def test_names() -> None:
    results = results_of(runs("B", [1.0, 2.0], **{NOISE: 0.1}) + runs("A", [1.0], **{NOISE: 0.1}))
    assert labels(results) == ["B", "A"]
    assert trial_name(results, 1) == "trial 1 (seed 1, noise scale = 0.1)"
    texts = [value_text(value) for value in (None, math.nan, 0.25, np.float64(2.0), "lm", True)]
    assert texts == ["none", "none", "0.25", "2", "lm", "True"]
    rows = runs("A", [1.0], reference="none") + runs("B", [1.0], reference="batch (final)")
    assert reference_name(results_of(rows)) == "batch (final)"
    assert reference_name(results_of(runs("A", [1.0], reference="none"))) == "none"


def test_times_are_per_finished_frame() -> None:
    half = {"frames": 10, "completion": 0.5, "update_s": 0.020, "estimate_s": 0.005}
    rows = [half, half | {"completion": 1.0}, half | {"estimate_s": math.nan}, half | {"completion": 0.0}]
    trials = results_of(rows).trials
    assert milliseconds_per_frame(trials, "update_s").tolist()[:3] == pytest.approx([4.0, 2.0, 4.0])
    both = milliseconds_per_frame(trials, "update_s", "estimate_s")
    assert both.tolist()[:2] == pytest.approx([5.0, 2.5])
    assert both[2:].isna().all()


def test_whether_poses_lie_in_space_is_asked_of_the_columns() -> None:
    """Not of their values: a run without truth has the columns and no errors."""
    planar = pd.DataFrame({"online_err_0": [0.1], "online_err_2": [0.1]})
    assert pose_dimension(planar) == 3
    assert pose_dimension(planar.assign(online_err_5=math.nan)) == 6
    assert has_values(planar, ["online_err_0", "online_err_2"])
    assert not has_values(planar.assign(online_err_5=math.nan), ["online_err_0", "online_err_5"])
