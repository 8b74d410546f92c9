"""Rows of the results' tables: every column present, needs respected, failed runs without exceptions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from slamcmp.errors import DataError
from slamcmp.geometry import se2
from slamcmp.metrics import frame_table, landmark_table, metric_columns, reference_truth, score_run
from slamcmp.types import Run, Trajectory

P_HAND = np.diag([0.04, 0.01, 0.01])


@pytest.fixture
def straight(truth_of, run_of):
    """Three frames east, the estimate 0.2 m too far north, its final trajectory 0.1 m; one landmark."""
    truth = truth_of(se2([0, 1, 2], 0, 0), [[1.0, 1.0]])
    final = Trajectory(truth.t, se2([0, 1, 2], 0.1, 0), np.broadcast_to(P_HAND, (3, 3, 3)))
    run = run_of(
        se2([0, 1, 2], 0.2, 0),
        np.broadcast_to(P_HAND, (3, 3, 3)),
        [[1.0, 1.5]],
        covariances=0.25 * np.eye(2)[None],
        final=final,
        update_s=np.array([0.001, 0.002, 0.006]),
        estimate_s=np.array([0.010, 0.040, 0.020]),
        joint_covariance=np.diag([0.04, 0.01, 0.01, 0.25, 0.25]),
        diagnostics={"nis": np.array([math.nan, 1.0, 3.0]), "nis_dof": np.array([0.0, 2.0, 2.0])},
        peak_memory_mb=12.0,
    )
    return run, truth


def test_online_and_final_are_scored_apart(straight):
    scores = score_run(*straight)
    assert list(scores) == list(metric_columns())
    assert scores["online_ate"] == pytest.approx(0.2, abs=1e-15)
    assert scores["final_ate"] == pytest.approx(0.1, abs=1e-15)
    # 0.2² / 0.01 and 0.1² / 0.01.
    assert scores["online_pose_nees"] == pytest.approx(4.0, abs=1e-12)
    assert scores["final_pose_nees"] == pytest.approx(1.0, abs=1e-12)
    assert scores["landmark_rmse"] == pytest.approx(0.5, abs=1e-15)
    # The final trajectory is 0.1 m too far north, so 0.4 m remain of the landmark's 0.5.
    assert scores["landmark_rmse_aligned"] == pytest.approx(0.4, abs=1e-12)
    assert scores["landmark_nees"] == pytest.approx(1.0, abs=1e-12)
    assert scores["nis_per_dof"] == pytest.approx(1.0, abs=1e-15)


def test_cost(straight):
    scores = score_run(*straight)
    assert scores["completion"] == 1
    assert scores["update_s"] == pytest.approx(0.009)
    assert scores["estimate_s"] == pytest.approx(0.070)
    # Linear interpolation: the 95th percentile of 1, 2, 6 ms lies at 2 + 0.9 · 4.
    assert scores["update_median_ms"] == pytest.approx(2.0)
    assert scores["update_p95_ms"] == pytest.approx(5.6)
    assert scores["estimate_median_ms"] == pytest.approx(20.0)
    assert scores["estimate_p95_ms"] == pytest.approx(38.0)
    assert scores["peak_memory_mb"] == 12


def test_time_of_the_final_solution_is_told_where_there_is_one(straight, run_of):
    run, truth = straight
    assert run.final is not None
    assert score_run(dataclasses.replace(run, final_s=0.25), truth)["final_solution_s"] == 0.25
    assert math.isnan(score_run(dataclasses.replace(run, final=None), truth)["final_solution_s"])


def test_without_truth_only_what_needs_none_is_scored(straight):
    run, _ = straight
    known = {name for name, value in score_run(run, None).items() if not math.isnan(value)}
    assert known == {
        "nis_per_dof",
        "completion",
        "update_s",
        "estimate_s",
        "final_solution_s",
        "update_median_ms",
        "update_p95_ms",
        "estimate_median_ms",
        "estimate_p95_ms",
        "peak_memory_mb",
    }


def test_against_a_reference_nothing_is_called_consistent(straight):
    run, _ = straight
    scores = score_run(run, reference_truth(run), reference=True)
    assert scores["final_ate"] == 0
    assert scores["online_ate"] == pytest.approx(0.1, abs=1e-15)
    assert scores["landmark_rmse"] == 0
    nees = [name for name in scores if "nees" in name]
    assert nees
    assert all(math.isnan(scores[name]) for name in nees)
    frames = frame_table(run, reference_truth(run), reference=True)
    assert frames[["online_nees", "final_nees"]].isna().all(axis=None)
    landmarks = landmark_table(run, reference_truth(run), reference=True)
    assert landmarks["error_m"].tolist() == [0.0]
    assert landmarks["nees"].isna().all()


def test_a_run_that_crashed_at_once_has_its_columns_and_no_values(straight, run_of):
    _, truth = straight
    empty = run_of(np.empty((0, 3, 3)), frames=3, status="crashed", message="no memory")
    scores = score_run(empty, truth)
    assert list(scores) == list(metric_columns())
    assert scores["completion"] == 0
    assert math.isnan(scores["online_ate"])
    assert math.isnan(scores["landmark_rmse"])
    assert math.isnan(scores["update_median_ms"])
    assert len(frame_table(empty, truth)) == 0
    assert len(landmark_table(empty, truth)) == 0


def test_a_run_that_ended_early_is_scored_on_its_frames(straight, run_of):
    _, truth = straight
    half = run_of(se2([0, 1], [0.0, 0.2], 0), frames=3, status="diverged")
    scores = score_run(half, truth)
    assert scores["completion"] == pytest.approx(2 / 3)
    assert scores["online_ate"] == pytest.approx(math.sqrt(0.02), abs=1e-15)
    assert math.isnan(scores["online_last_pose_error"])
    assert math.isnan(scores["online_pose_nees"])
    assert len(frame_table(half, truth)) == 2


def test_not_a_number_gives_no_score(straight, run_of):
    _, truth = straight
    poses = se2([0.0, 1.0, math.nan], 0, 0)
    scores = score_run(run_of(poses, np.broadcast_to(P_HAND, (3, 3, 3)), positions=[[0.0, math.nan]]), truth)
    assert math.isnan(scores["online_ate"])
    assert math.isnan(scores["landmark_rmse_aligned"])
    final = Trajectory(truth.t, poses)
    lost = score_run(run_of(se2([0, 1, 2], 0, 0), positions=[[1.0, 1.0]], final=final), truth)
    assert lost["online_ate"] == 0.0
    assert math.isnan(lost["final_ate"])
    assert math.isnan(lost["landmark_rmse_aligned"])
    assert frame_table(run_of(poses), truth)["online_err_0"].isna().all()


def test_frame_table(straight):
    run, truth = straight
    table = frame_table(run, truth)
    assert table["k"].tolist() == [0, 1, 2]
    np.testing.assert_allclose(table["online_y"], 0.2)
    np.testing.assert_allclose(table["true_x"], [0, 1, 2])
    # The truth lies 0.2 m to the right of the estimate.
    np.testing.assert_allclose(table["online_err_1"], -0.2)
    np.testing.assert_allclose(table["final_err_1"], -0.1)
    np.testing.assert_allclose(
        table[["online_sigma_0", "online_sigma_1", "online_sigma_2"]], [[0.2, 0.1, 0.1]] * 3
    )
    np.testing.assert_allclose(table["online_position_error_m"], 0.2)
    np.testing.assert_allclose(table["final_position_error_m"], 0.1)
    np.testing.assert_allclose(table["online_nees"], 4.0)
    np.testing.assert_allclose(table["final_nees"], 1.0)
    np.testing.assert_allclose(table["nis"], [math.nan, 1.0, 3.0])
    np.testing.assert_allclose(table["update_s"], [0.001, 0.002, 0.006])


def test_heading_errors_of_the_frame_table_are_degrees_across_the_cut(truth_of, run_of):
    table = frame_table(run_of(se2([0.0], 0, -3.1)), truth_of(se2([0.0], 0, 3.1)))
    turn = 2 * math.pi - 6.2
    assert table["online_heading_error_deg"][0] == pytest.approx(math.degrees(turn), abs=1e-9)
    assert table["online_err_2"][0] == pytest.approx(-turn, abs=1e-12)


def test_position_covariance_is_turned_into_world_axes(truth_of, run_of):
    # Looking north-east, 30 degrees to the left of x: a narrow ellipse points there, not to the right.
    narrow = frame_table(run_of(se2([0.0], 0, math.pi / 6), P_HAND[None]), None).iloc[0]
    assert narrow["online_P_xy"] == pytest.approx(0.03 * math.sqrt(3) / 4)
    assert narrow["online_P_xx"] == pytest.approx((3 * 0.04 + 0.01) / 4)
    # Looking north: the 0.2 m along the body's x axis are north-south in the world.
    poses = se2([0.0], 0, math.pi / 2)
    row = frame_table(run_of(poses, P_HAND[None]), truth_of(poses)).iloc[0]
    np.testing.assert_allclose(
        row[["online_P_xx", "online_P_xy", "online_P_yy"]].astype(float), [0.01, 0, 0.04], atol=1e-15
    )
    assert row["online_heading_rad"] == pytest.approx(math.pi / 2)


def test_tables_in_space(truth_of, run_of):
    poses = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    poses[1, 2, 3] = 0.5
    P = np.broadcast_to(np.diag([0.01, 0.01, 0.01, 0.04, 0.09, 0.25]), (2, 6, 6))
    run = run_of(np.broadcast_to(np.eye(4), (2, 4, 4)), P, [[1.0, 2.0, 3.0]])
    table = frame_table(run, truth_of(poses, [[1.0, 2.0, 4.0]]))
    # 0.5 m along z, the last entry of (omega, v), with sigma 0.5 m: NEES 1.
    np.testing.assert_allclose(table["online_err_5"], [0.0, 0.5])
    np.testing.assert_allclose(table["online_nees"], [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(table["online_P_yy"], 0.09)
    np.testing.assert_allclose(table["true_z"], [0.0, 0.5])
    landmark = landmark_table(run, truth_of(poses, [[1.0, 2.0, 4.0]])).iloc[0]
    assert (landmark["z"], landmark["true_z"], landmark["error_m"]) == (3.0, 4.0, 1.0)
    assert landmark["nees"] == pytest.approx(1.0)


def test_landmark_table_keeps_landmarks_that_the_truth_does_not_know(straight, run_of):
    _, truth = straight
    run = run_of(
        se2([0, 1, 2], 0, 0),
        positions=[[7.0, 7.0], [1.0, 1.5]],
        ids=[99, 10],
        covariances=np.broadcast_to(0.25 * np.eye(2), (2, 2, 2)),
    )
    table = landmark_table(run, truth).set_index("id")
    assert math.isnan(table.loc[99, "error_m"])
    assert math.isnan(table.loc[99, "nees"])
    assert table.loc[10, "error_m"] == pytest.approx(0.5)
    assert table.loc[10, "nees"] == pytest.approx(1.0)


def test_a_diagnostic_does_not_replace_a_column(run_of):
    table = frame_table(run_of(se2([0, 1], 0, 0), diagnostics={"t": np.array([7.0, 8.0])}), None)
    assert table["t"].tolist() == [0.0, 1.0]
    assert table["t_diagnostic"].tolist() == [7.0, 8.0]


def test_reference_must_have_a_final_trajectory(run_of):
    with pytest.raises(DataError, match="'hand_made' has no final trajectory"):
        reference_truth(run_of(se2([0, 1], 0, 0)))


def test_a_reference_must_have_finished_and_is_its_hindsight(straight):
    run, _ = straight
    np.testing.assert_array_equal(reference_truth(run).T_world_body, run.final.T_world_body)
    with pytest.raises(DataError, match=r"no final trajectory \(status diverged\)"):
        reference_truth(dataclasses.replace(run, status="diverged"))


def test_a_reference_without_a_map_has_poses_only(straight):
    run, _ = straight
    reference = reference_truth(dataclasses.replace(run, landmarks=None))
    assert (reference.ids.shape, reference.positions.shape) == ((0,), (0, 2))
    scores = score_run(run, reference, reference=True)
    # The run against itself: no difference of poses, and no landmark to compare.
    assert scores["final_ate"] == 0.0
    assert math.isnan(scores["landmark_rmse"])


def test_every_metric_column_says_what_it_is():
    columns = metric_columns()
    assert columns["online_ate_aligned"].unit == "m"
    assert columns["online_ate_aligned"].lower_is_better is True
    assert "no scale" in columns["online_ate_aligned"].description
    assert columns["final_pose_nees"].trajectory == "final"
    assert columns["nis_per_dof"].trajectory == ""
    assert columns["nis_per_dof"].lower_is_better is None
    assert all(column.description.endswith(".") and column.unit for column in columns.values())


def test_diagnostics_never_take_the_name_of_a_column() -> None:
    run = Run(
        "b",
        {},
        "d",
        0,
        1,
        "ok",
        "",
        Trajectory([0.0], [np.eye(3)], [np.eye(3)]),
        np.ones(1),
        np.ones(1),
        diagnostics={name: np.full(1, 7.0) for name in ("k", "k_diagnostic", "seed", "source.x", "nis")},
    )
    table = frame_table(run, None, taken=("seed", "source.x"))
    assert table["k"][0] == 0
    for name in ("k_diagnostic", "k_diagnostic_diagnostic", "seed_diagnostic", "source.x_diagnostic", "nis"):
        assert table[name][0] == 7.0
    assert not {"seed", "source.x"} & set(table)
