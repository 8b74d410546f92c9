"""NEES in its chart, NIS and chi-square against hand-computed values and the chi-square law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from slamcmp.geometry import retract, se2
from slamcmp.metrics import consistency
from slamcmp.types import Trajectory

P_HAND = np.diag([0.04, 0.01, 0.01])


def test_nees_is_in_the_body_tangent(truth_of, trajectory_of):
    # Looking north, the truth lies 0.2 m east: 0.2 m to the right of the robot, sigma_y = 0.1 m: NEES 4.
    # In world axes the same P would give 0.2² / 0.04 = 1.
    truth = truth_of(se2([0.2], 0, math.pi / 2))
    trajectory = trajectory_of(se2([0.0], 0, math.pi / 2), P_HAND[None])
    assert consistency.pose_nees(trajectory, truth) == pytest.approx(4.0, abs=1e-12)
    assert consistency.position_nees(trajectory, truth) == pytest.approx(4.0, abs=1e-12)
    assert consistency.heading_nees(trajectory, truth) == pytest.approx(0.0, abs=1e-12)


def test_heading_nees_and_median(truth_of, trajectory_of):
    # Heading errors 0.2, 0.1 and 0 rad with sigma 0.1: NEES 4, 1, 0; mean 5/3, median 1.
    truth = truth_of(se2(0, 0, [0.2, 0.1, 0.0]))
    trajectory = trajectory_of(se2(np.zeros(3), 0, 0), np.broadcast_to(P_HAND, (3, 3, 3)))
    assert consistency.heading_nees(trajectory, truth) == pytest.approx(5 / 3, abs=1e-12)
    assert consistency.pose_nees(trajectory, truth) == pytest.approx(5 / 3, abs=1e-12)
    assert consistency.pose_nees_median(trajectory, truth) == pytest.approx(1.0, abs=1e-12)
    # The two-sided 95 % band for 3 degrees of freedom is [0.216, 9.348]: the frame without error is outside.
    assert consistency.nees_inside_95(trajectory, truth) == pytest.approx(2 / 3, abs=1e-12)


@pytest.mark.parametrize("p", [3, 6])
def test_errors_drawn_from_P_have_mean_nees_p(p, truth_of, trajectory_of):
    rng = np.random.default_rng(5)
    frames = 4000
    roots = rng.normal(size=(frames, p, p)) * 0.05
    P = roots @ np.swapaxes(roots, 1, 2) + 1e-4 * np.eye(p)
    xi = np.einsum("kij,kj->ki", np.linalg.cholesky(P), rng.normal(size=(frames, p)))
    start = np.broadcast_to(np.eye(3 if p == 3 else 4), (frames, *([3, 3] if p == 3 else [4, 4])))
    trajectory, truth = trajectory_of(start, P), truth_of(retract(start, xi))
    # Independent draws: frames · mean is chi-square with frames · dim degrees (99.9 % band).
    for metric, dim in (
        (consistency.pose_nees, p),
        (consistency.position_nees, 2 if p == 3 else 3),
        (consistency.heading_nees, 1 if p == 3 else 3),
    ):
        low, high = chi2.interval(0.999, frames * dim)
        assert low / frames < metric(trajectory, truth) < high / frames
    # Binomial(4000, 0.95): standard deviation 0.0034, 3.3 of them.
    assert consistency.nees_inside_95(trajectory, truth) == pytest.approx(0.95, abs=0.0114)
    # Bias of the median is below the Monte-Carlo error; three of its standard deviations.
    assert consistency.pose_nees_median(trajectory, truth) == pytest.approx(chi2.median(p), rel=0.07)


def test_the_parts_of_a_pose_in_space(truth_of, trajectory_of):
    """A tangent is (omega, v): 0.2 rad with sigma 0.1 rad gives 4, 0.6 m with sigma 0.2 m gives 9."""
    xi = np.array([[0.2, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.6, 0.0]])
    start = np.broadcast_to(np.eye(4), (2, 4, 4))
    P = np.broadcast_to(np.diag([0.01] * 3 + [0.04] * 3), (2, 6, 6))
    trajectory, truth = trajectory_of(start, P), truth_of(retract(start, xi))
    assert consistency.heading_nees(trajectory, truth) == pytest.approx(4 / 2, abs=1e-12)
    assert consistency.position_nees(trajectory, truth) == pytest.approx(9 / 2, abs=1e-12)
    assert consistency.pose_nees(trajectory, truth) == pytest.approx(13 / 2, abs=1e-12)


def test_median_of_an_even_number_of_frames(truth_of, trajectory_of):
    truth = truth_of(se2(0, 0, [0.4, 0.1, 0.2, 0.0]))
    trajectory = trajectory_of(se2(np.zeros(4), 0, 0), np.broadcast_to(P_HAND, (4, 3, 3)))
    # NEES 16, 1, 4, 0: half way between 1 and 4.
    assert consistency.pose_nees_median(trajectory, truth) == pytest.approx(2.5, abs=1e-12)


def test_singular_covariances_are_skipped_and_counted(truth_of, trajectory_of):
    P = np.stack(
        [
            np.zeros((3, 3)),  # a start known exactly
            np.diag([0.01, 0.0, 0.01]),  # one direction known exactly
            np.outer([1.0, 2.0, 0.3], [1.0, 2.0, 0.3]),  # rank 1, all variances positive
            np.full((3, 3), math.nan),
            np.diag([0.01, 0.01, -0.01]),  # indefinite
            np.diag([0.01, 0.01, 0.01]),
        ]
    )
    truth = truth_of(se2(np.full(6, 0.3), 0, 0))
    trajectory = trajectory_of(se2(np.zeros(6), 0, 0), P)
    # Only the last frame counts: 0.3² / 0.01 = 9.
    assert consistency.pose_nees(trajectory, truth) == pytest.approx(9.0, abs=1e-12)
    assert consistency.nees_skipped_frames(trajectory, truth) == 5


def test_mixed_units_are_not_mistaken_for_a_singular_matrix():
    # sigma 1 km and 1 µrad: the eigenvalues differ by 10^18, yet both errors of one sigma give 1 + 1.
    value = consistency.quadratic_forms(np.array([1e3, 1e-6]), np.diag([1e6, 1e-12]))
    assert float(value) == pytest.approx(2.0, rel=1e-12)


def test_landmark_nees(truth_of, run_of):
    poses = se2([0.0], 0, 0)
    truth = truth_of(poses, [[0.0, 0.0], [5.0, 0.0]])
    # 0.2 m with sigma 0.1 m: 4; (0.1, 0.1) m with sigma 0.1 m each: 2. Mean 3.
    run = run_of(
        poses,
        P_HAND[None],
        [[0.2, 0.0], [5.1, 0.1]],
        covariances=np.broadcast_to(0.01 * np.eye(2), (2, 2, 2)),
    )
    assert consistency.landmark_nees(run, truth) == pytest.approx(3.0, abs=1e-12)


def test_joint_nees_puts_the_pose_first_and_marginalises_unknown_landmarks(truth_of, run_of):
    # Pose error (0.2, 0, 0), landmark 10 off by (0.1, 0). Their x components: P = [[0.04, 0.01],
    # [0.01, 0.01]], det 3e-4, so e^T P^-1 e = (0.01·0.04 - 2·0.01·0.02 + 0.04·0.01) / 3e-4 = 4/3, over 5.
    truth = truth_of(se2([0.2], 0, 0), [[1.1, 0.0]])
    joint = np.diag([0.04, 0.01, 0.01, 7.0, 7.0, 0.01, 0.01])
    joint[0, 5] = joint[5, 0] = 0.01
    joint[0, 3] = joint[3, 0] = 0.1  # with the landmark that the truth does not know
    run = run_of(
        se2([0.0], 0, 0), P_HAND[None], [[50.0, 50.0], [1.0, 0.0]], ids=[99, 10], joint_covariance=joint
    )
    assert consistency.joint_nees_per_dof(run, truth) == pytest.approx(4 / 15, abs=1e-12)


def test_joint_nees_is_of_the_pose_that_the_map_stands_with(truth_of, run_of):
    """A filter's last pose, and the last of a smoother's final trajectory; not of a frame before the last."""
    truth = truth_of(se2([0.0, 1.3], 0, 0), [[1.0, 0.0]])
    final = Trajectory(truth.t, truth.T_world_body, np.broadcast_to(P_HAND, (2, 3, 3)))
    joint = np.diag([0.01, 0.01, 0.01, 0.01, 0.01])
    fields = {"positions": [[1.0, 0.0]], "joint_covariance": joint, "final": final}
    run = run_of(se2([0.9, 1.0], 0, 0), np.broadcast_to(P_HAND, (2, 3, 3)), **fields)
    # The final trajectory is the truth; the online pose is 0.3 m off with sigma 0.1 m: 9, over 3 + 2.
    assert consistency.joint_nees_per_dof(run, truth) == pytest.approx(0.0, abs=1e-12)
    filtered = run_of(se2([0.9, 1.0], 0, 0), np.broadcast_to(P_HAND, (2, 3, 3)), **(fields | {"final": None}))
    assert consistency.joint_nees_per_dof(filtered, truth) == pytest.approx(9 / 5, abs=1e-12)
    # Of a run that ended early the joint belief is of another frame than the log's last.
    early = run_of(se2([0.9], 0, 0), P_HAND[None], **(fields | {"final": None}), frames=2)
    assert math.isnan(consistency.joint_nees_per_dof(early, truth))


def test_each_landmark_has_its_own_covariance(truth_of, run_of):
    """Landmark 99 is not in the truth; the others' sigmas are 0.1 and 0.5 m."""
    poses = se2([0.0], 0, 0)
    sigmas = np.array([9.0, 0.1, 0.5])
    run = run_of(
        poses,
        P_HAND[None],
        [[7.0, 7.0], [0.2, 0.0], [5.0, 0.5]],
        ids=[99, 10, 11],
        covariances=sigmas[:, None, None] ** 2 * np.eye(2),
    )
    truth = truth_of(poses, [[0.0, 0.0], [5.0, 0.0]])
    assert consistency.landmark_nees(run, truth) == pytest.approx((4.0 + 1.0) / 2, abs=1e-12)


def test_nis_and_chi2_per_degree_of_freedom(run_of):
    run = run_of(
        se2([0, 1, 2, 3], 0, 0),
        diagnostics={
            "nis": np.array([math.nan, 2.0, 4.0, 0.0]),
            "nis_dof": np.array([0.0, 2.0, 6.0, 0.0]),
        },
        final_diagnostics={"chi2": 30.0, "dof": 20.0},
    )
    # (2 + 4) / (2 + 6); frames without observations do not count.
    assert consistency.nis_per_dof(run) == pytest.approx(0.75, abs=1e-15)
    assert consistency.chi2_per_dof(run) == pytest.approx(1.5, abs=1e-15)
    # What stands where there were no degrees of freedom is not an innovation.
    series = {"nis": np.array([7.0, 2.0]), "nis_dof": np.array([0.0, 2.0])}
    assert consistency.nis_per_dof(run_of(se2([0, 1], 0, 0), diagnostics=series)) == 1.0
    silent = run_of(se2([0, 1], 0, 0))
    assert math.isnan(consistency.nis_per_dof(silent))
    assert math.isnan(consistency.chi2_per_dof(silent))


@pytest.mark.parametrize(
    ("dim", "runs", "low", "high"),
    [(3, 20, 2.02, 4.17), (3, 50, 2.36, 3.72), (3, 100, 2.54, 3.50), (2, 100, 1.63, 2.41)],
)
def test_average_band_has_the_published_bounds(dim, runs, low, high):
    assert consistency.average_band(dim, runs) == pytest.approx((low, high), abs=0.006)
    assert consistency.chi2_band(dim) == pytest.approx(chi2.interval(0.95, dim), rel=1e-12)
