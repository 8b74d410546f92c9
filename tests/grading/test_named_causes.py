"""The first test that a well-known single mistake fails names it, in every assignment."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.grading.assignment.description import find_assignment, load_assignment, load_source
from slamcmp.grading.run.grader import Grading
from slamcmp.grading.run.publish import InProcess

OLD_POSE = (
    (
        "def update(T_world_body, landmarks, P, numbers, z, R):\n",
        "{0}    T_world_body, old = into(T_world_body)\n",
    ),
    (
        "H = stacked_jacobian(T_world_body, landmarks, numbers)",
        "H = stacked_jacobian(old, landmarks, numbers)",
    ),
    ("            self.T, self.P = predict(", "            self.old = self.T\n{0}"),
    (
        "self.T, self.positions, self.P, numbers, frame.z",
        "(self.T, self.old), self.positions, self.P, numbers, frame.z",
    ),
    ("def stacked_jacobian(", "def into(T):\n    return T if isinstance(T, tuple) else (T, T)\n\n\n{0}"),
)
ROWS: dict[str, tuple[str, tuple[tuple[str, str], ...], str]] = {
    "ekf, arctan": ("ekf", (("np.arctan2(dy, dx)", "np.arctan(dy / dx)"),), "arctangent of one argument"),
    "ekf, degrees": (
        "ekf",
        (("wrap(np.arctan2(dy, dx) - state[2])", "np.rad2deg(wrap(np.arctan2(dy, dx) - state[2]))"),),
        "bearing in degrees",
    ),
    "ekf, no Q": (
        "ekf",
        (("G @ covariance @ G.T + process_noise", "G @ covariance @ G.T"),),
        "no process noise",
    ),
    "ekf, heading's derivative": (
        "ekf",
        (("-dx / square, -1.0]", "-dx / square, 1.0]"),),
        "heading derivative plus one",
    ),
    "ekf_slam, GᵀPG": (
        "ekf_slam",
        (
            ("A @ P[:3, :3] @ A.T + Q", "A.T @ P[:3, :3] @ A + Q"),
            ("P_new[:3, 3:] = A @ P[:3, 3:]", "P_new[:3, 3:] = A.T @ P[:3, 3:]"),
        ),
        "transposed everywhere",
    ),
    "ekf_slam, H at the old pose": ("ekf_slam", OLD_POSE, "H at the pose before the motion"),
    "ekf_slam, gain": (
        "ekf_slam",
        (("np.linalg.solve(S, H @ P).T", "P @ H.T @ S"),),
        "gain without the inverse",
    ),
    "ekf_slam, innovation": (
        "ekf_slam",
        (
            (
                "y = SENSOR.residual(z, SENSOR.predict(T_world_body, seen))",
                "y = -SENSOR.residual(z, SENSOR.predict(T_world_body, seen))",
            ),
        ),
        "innovation turned round",
    ),
    "kalman_filter, gain": (
        "kalman_filter",
        (
            (
                "np.linalg.solve(innovation_covariance, C @ covariance).T",
                "covariance @ C.T @ innovation_covariance",
            ),
        ),
        "gain without the inverse",
    ),
    "kalman_filter, Q and R": (
        "kalman_filter",
        (
            (
                "= predict(mean, covariance, A, process_noise)",
                "= predict(mean, covariance, A, np.eye(4) * measurement_noise[0, 0])",
            ),
            (
                "= correct(mean, covariance, y, C, measurement_noise)",
                "= correct(mean, covariance, y, C, process_noise[:2, :2])",
            ),
        ),
        "the noises exchanged",
    ),
    "factor_graph, Schur complement": (
        "factor_graph",
        (
            (
                "C = np.linalg.solve(Lam[np.ix_(drop, drop)], Lam[np.ix_(drop, keep)]).T",
                "C = Lam[np.ix_(keep, drop)] @ Lam[np.ix_(drop, drop)]",
            ),
        ),
        "inverse forgotten in the Schur complement",
    ),
    "factor_graph, keep and drop": (
        "factor_graph",
        (
            (
                "drop = np.setdiff1d(np.arange(len(eta)), keep)",
                "drop = keep\n    keep = np.setdiff1d(np.arange(len(eta)), drop)",
            ),
        ),
        "keep and drop exchanged",
    ),
}


@pytest.mark.parametrize("row", list(ROWS))
def test_the_first_lost_points_are_explained(row: str) -> None:
    name, changes, cause = ROWS[row]
    assignment = load_assignment(find_assignment(name))
    source = assignment.solution_source
    for old, new in changes:
        assert source.count(old) == 1, old
        source = source.replace(old, new.replace("{0}", old))
    module = load_source("slamcmp_student", source, Path("student.py"))
    lost = next(
        test
        for outcome in Grading(assignment, "ada", b"a secret of the tests").outcomes(InProcess(module))
        for test in outcome.tests[-1:]
        if test.score < test.max_score
    )
    # The template's own words, up to the first number that is filled in.
    told = {mutant.name for mutant in assignment.mutants if mutant.message.split("{", 1)[0] in lost.message}
    assert told == {cause}, lost.message
