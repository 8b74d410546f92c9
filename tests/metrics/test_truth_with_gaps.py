"""Truth that is not known everywhere, and truth that is not exact."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from slamcmp.errors import DataError
from slamcmp.experiment.runner import run_experiment
from slamcmp.geometry import exp, se2
from slamcmp.metrics import accuracy, consistency, frame_table, metric_columns, score_run
from slamcmp.metrics.divergence import first_departure
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import metrics
from slamcmp.types import Detections, GroundTruth, Log, Problem, Run, Trajectory

GAP = slice(30, 40)
FRAMES = 80


def noisy_run(dim: int, run_of, seed: int = 0):
    """A run of 80 frames, its truth, and the truth with ten frames missing."""
    p = 3 if dim == 2 else 6
    rng = np.random.default_rng(seed)
    step = exp(
        np.concatenate([0.02 * np.ones(p - dim), [0.5], np.zeros(dim - 1)]) if dim == 3 else [0.5, 0, 0.05]
    )
    true = [np.eye(dim + 1)]
    for _ in range(FRAMES - 1):
        true.append(true[-1] @ step)
    true = np.array(true)
    P = np.tile(0.01 * np.eye(p), (FRAMES, 1, 1))
    run = run_of(true @ exp(0.1 * rng.standard_normal((FRAMES, p))), P, positions=np.ones((2, dim)))
    holes = true.copy()
    holes[GAP, 0, -1] = np.nan
    whole, gap = (
        GroundTruth(run.online.t, poses, np.array([10, 11]), np.zeros((2, dim))) for poses in (true, holes)
    )
    return run, whole, gap


@pytest.mark.parametrize("dim", [2, 3])
def test_scores_are_those_of_the_frames_that_are_known(dim, run_of):
    """Against the same frames taken out by hand."""
    run, whole, gap = noisy_run(dim, run_of)
    rows = np.r_[0:30, 40:FRAMES]
    short = Run(
        **{
            **{f: getattr(run, f) for f in run.__dataclass_fields__},
            "online": Trajectory(run.online.t[rows], run.online.T_world_body[rows], run.online.P[rows]),
        }
    )
    truth = GroundTruth(whole.t[rows], whole.T_world_body[rows], whole.ids, whole.positions)
    with_gap, by_hand = score_run(run, gap), score_run(short, truth)
    pairwise = {"rpe_translation", "rpe_rotation_deg", "rpe_per_metre", "rpe_rotation_deg_per_m"}
    compared = 0
    for name, column in metric_columns().items():
        if column.metric in pairwise or "truth" not in metrics.get(column.metric).traits["needs"]:
            continue
        if column.metric != "truth_share":
            assert with_gap[name] == pytest.approx(by_hand[name], rel=1e-12, nan_ok=True), name
            compared += math.isfinite(by_hand[name])
    assert compared >= 14
    assert with_gap["truth_share"] == 70 / 80
    assert score_run(run, whole)["truth_share"] == 1.0
    # Motion over the gap is not known: 29 + 39 pairs are left of 79.
    pairs = np.r_[0:29, 40 : FRAMES - 1]
    steps = [accuracy.rpe_translation(_cut(run, k), _cut(whole, k)) for k in pairs]
    assert with_gap["online_rpe_translation"] == pytest.approx(math.sqrt(np.mean(np.square(steps))), rel=1e-9)


def _cut(what, k):
    rows = slice(k, k + 2)
    if isinstance(what, GroundTruth):
        return GroundTruth(what.t[rows], what.T_world_body[rows], what.ids, what.positions)
    return Trajectory(what.online.t[rows], what.online.T_world_body[rows])


def test_segments_do_not_cross_a_gap(truth_of, trajectory_of):
    """A robot on a line whose odometry jumps by 1 m where nobody saw it: no segment shows the jump."""
    x = np.arange(40.0)
    poses = se2(x, 0, 0)
    jumped = se2(x + (x >= 20), 0, 0)
    holes = poses.copy()
    holes[18:22] = np.nan
    assert accuracy.rpe_per_metre(trajectory_of(jumped), truth_of(poses), lengths_m=[5.0]) > 1
    _, driven = accuracy.segment_errors(trajectory_of(jumped), truth_of(holes), [5.0])
    assert len(driven) == (18 - 5) + (18 - 5)
    assert accuracy.rpe_per_metre(trajectory_of(jumped), truth_of(holes), lengths_m=[5.0]) == 0


def test_the_first_pose_that_is_known_is_aligned(truth_of, trajectory_of):
    poses = se2([0, 1, 2, 3], 0, 0)
    holes = poses.copy()
    holes[0] = np.nan
    turned = se2(5, 6, 0.7) @ poses
    assert accuracy.ate_first_pose(trajectory_of(turned), truth_of(holes)) == pytest.approx(0, abs=1e-12)
    holes[:] = np.nan
    for name in ("ate", "ate_aligned", "ate_first_pose", "max_error", "rpe_translation", "rpe_per_metre"):
        assert math.isnan(getattr(accuracy, name)(trajectory_of(turned), truth_of(holes))), name


@pytest.mark.parametrize("dim", [2, 3])
def test_tables_and_diagnosis_leave_the_gap_open(dim, run_of):
    run, whole, gap = noisy_run(dim, run_of)
    table, full = frame_table(run, gap), frame_table(run, whole)
    for name in ("online_position_error_m", "online_nees", "online_err_0", "online_heading_error_deg"):
        assert table[name][GAP].isna().all()
        np.testing.assert_array_equal(table[name].drop(range(30, 40)), full[name].drop(range(30, 40)))
    assert first_departure(run, gap) is None


def test_a_landmark_without_truth_is_no_error(run_of):
    truth = GroundTruth([0.0], np.eye(3)[None], [10, 11], [[1.0, 2.0], [np.nan, 3.0]])
    run = run_of(np.eye(3)[None], positions=[[1.0, 2.5], [9.0, 9.0]])
    assert accuracy.landmark_rmse(run, truth) == pytest.approx(0.5)


# ---- a truth with a covariance ----


@pytest.mark.parametrize("dim", [2, 3])
def test_nees_against_the_sum_of_both_covariances(dim, run_of):
    """Errors of estimate and truth, drawn independently, fit their sum; the estimate's alone is too small."""
    p, frames = 3 * (dim - 1), 2000
    rng = np.random.default_rng(dim)
    A, B = 1e-3 * rng.standard_normal((2, p, p))
    P, P_truth = (M @ M.T + 1e-6 * np.eye(p) for M in (A, B))
    drawn = [exp(rng.multivariate_normal(np.zeros(p), C, size=frames)) for C in (P, P_truth)]
    run = run_of(drawn[0], np.tile(P, (frames, 1, 1)))
    t = run.online.t
    none = (np.empty(0, np.int64), np.empty((0, dim)))
    exact = GroundTruth(t, drawn[1], *none)
    measured = GroundTruth(t, drawn[1], *none, P=np.tile(P_truth, (frames, 1, 1)))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], p * frames) / frames
    assert low < consistency.pose_nees(run.online, measured) < high
    assert consistency.pose_nees(run.online, exact) > 1.3 * high
    for part, d in (("position", dim), ("heading", p - dim)):
        low, high = chi2.ppf([1e-4, 1 - 1e-4], d * frames) / frames
        found = getattr(consistency, f"{part}_nees")(run.online, measured)
        assert low < found < high


def test_joint_nees_with_a_measured_truth(run_of):
    """In closed form: pose error e with P and P_truth, one landmark apart from it."""
    joint = np.diag([0.1, 0.2, 0.3, 0.5, 0.5])
    run = run_of(se2([0.3], 0, 0), 0.1 * np.eye(3)[None], positions=[[1.0, 2.0]], joint_covariance=joint)
    truth = GroundTruth([0.0], np.eye(3)[None], [10], [[1.0, 3.0]], P=np.diag([0.4, 0.4, 0.4])[None])
    assert consistency.joint_nees_per_dof(run, truth) == pytest.approx((0.09 / 0.5 + 1 / 0.5) / 5)


# ---- in a log ----


def log_with(truth: GroundTruth | None) -> Log:
    nothing = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, int))
    problem = Problem(np.eye(3), np.eye(3), make_sensor("range_bearing", {}))
    steps = np.tile(np.eye(3), (4, 1, 1))
    return Log("own", problem, np.arange(4.0), steps, np.zeros((4, 3, 3)), (nothing,) * 4, truth)


def test_missing_stamps_become_gaps():
    none = (np.empty(0, np.int64), np.empty((0, 2)))
    poses, P = se2([5.0, 6.0], 0, 0), np.tile(np.eye(3), (2, 1, 1))
    truth = log_with(GroundTruth([0.0, 2.0], poses, *none, P=P)).truth
    assert truth.known().tolist() == [True, False, True, False]
    np.testing.assert_array_equal(truth.T_world_body[[0, 2]], poses)
    assert np.isnan(truth.P[[1, 3]]).all()
    assert np.isfinite(truth.P[[0, 2]]).all()
    for stamps, message in (([0.0, 2.5], "2.5.* is none of the log's"), ([1.0, 1.0], "two poses have one")):
        with pytest.raises(DataError, match=message):
            log_with(GroundTruth(stamps, poses, *none))
    with pytest.raises(DataError, match=r"GroundTruth\.P"):
        GroundTruth([0.0, 2.0], poses, *none, P=-P)


SOURCE = """
import numpy as np
from slamcmp.geometry import se2
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Detections, GroundTruth, Log, Problem


def recorded(seed=0):
    steps = 80
    t, increments = np.arange(steps) * 1.0, np.tile(np.eye(3), (steps, 1, 1))
    increments[1:] = se2(1.0, 0.0, 0.1)
    truth = [np.eye(3)]
    for _ in range(1, steps):
        truth.append(truth[-1] @ se2(1.05, 0.0, 0.1))
    truth = np.array(truth)
    truth[30:40] = np.nan
    Q = np.tile(np.diag([0.05, 0.05, 0.02]) ** 2, (steps, 1, 1))
    Q[0] = 0.0
    nothing = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, int))
    problem = Problem(np.eye(3), np.eye(3) * 1e-12, make_sensor("range_bearing", {}))
    known = GroundTruth(t, truth, np.empty(0, int), np.empty((0, 2)))
    return Log("own", problem, t, increments, Q, (nothing,) * steps, known)
"""


def test_an_experiment_over_a_gap(tmp_path: Path) -> None:
    """A robot on a circle whose odometry is 5 % too short: the error in closed form, over 70 of 80 frames."""
    (tmp_path / "own.py").write_text(SOURCE)
    (tmp_path / "gap.yaml").write_text(
        "source: {name: 'own.py:recorded'}\nback_ends: [{name: dead_reckoning}, {name: ekf_ideal}]\n"
    )
    results = run_experiment(tmp_path / "gap.yaml", folder=tmp_path / "r", jobs=1)
    rows = results.trials.set_index("label")
    k = np.r_[0:30, 40:80]
    # Both go round circles of chords 1 and 1.05 with the same headings.
    errors = 0.05 * np.abs(np.sin(0.05 * k) / np.sin(0.05))
    assert rows["online_ate"]["dead_reckoning"] == pytest.approx(math.sqrt(np.mean(errors**2)), rel=1e-12)
    assert rows["truth_share"]["dead_reckoning"] == 70 / 80
    assert rows["status"].to_dict() == {"dead_reckoning": "ok", "ekf_ideal": "crashed"}
    assert "the truth has a gap at frame 30; it needs every frame's" in rows["message"]["ekf_ideal"]
    told = "the truth knows the pose in 70 of 80 frames (not in frames 30 to 39)"
    assert any(told in warning for warning in results.manifest["warnings"])


def test_without_truth_the_reference_is_asked_for(tmp_path: Path) -> None:
    """And landmarks are listed under the names that their file gives them."""
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0 4 0 0 4 0 4" for k in range(3)]
    names = (-1, -2, 7782220156096217089)
    lines += [f"EDGE_SE2_XY {k} {name} {2 - k} 3 100 0 100" for k in range(4) for name in names]
    (tmp_path / "my.g2o").write_text("\n".join(lines) + "\n")
    text = "source: {name: graph_file, path: my.g2o}\nback_ends: [{name: batch}, {name: dead_reckoning}]\n"
    (tmp_path / "plain.yaml").write_text(text)
    results = run_experiment(tmp_path / "plain.yaml", folder=tmp_path / "r", jobs=1)
    assert sorted(results.landmarks["id"]) == sorted(names)
    assert any("no truth: set reference to the label" in each for each in results.manifest["warnings"])
    (tmp_path / "named.yaml").write_text(text + "reference: batch\n")
    results = run_experiment(tmp_path / "named.yaml", folder=tmp_path / "n", jobs=1)
    assert not any("no truth" in each for each in results.manifest["warnings"])
    assert results.trials["online_ate"].notna().all()
