"""Run next to your factor_graph.py: python public_tests.py. The expected numbers are worked out by hand."""

import numpy as np
from factor_graph import (
    WindowOne,
    gauss_newton_step,
    linear_system,
    marginal_covariance,
    marginalise,
    observation_factor,
    odometry_factor,
    prior_factor,
    smooth,
)

from slamcmp.geometry import se2
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem

# Two numbers a and b, both at 0 now: a is seen as 1, b - a as 2; all with variance 1.
FACTORS = [
    (np.array([-1.0]), [(0, np.array([[1.0]]))]),
    (np.array([-2.0]), [(0, np.array([[-1.0]])), (1, np.array([[1.0]]))]),
]
LAM, ETA = np.array([[2.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, 2.0])


def test_prior_factor():
    # One standard deviation (0.2 m) ahead of the prior. A turn there swings the way back sideways.
    r, J = prior_factor(se2(0.2, 0.0, 0.0), np.eye(3), np.diag([0.04, 1.0, 1.0]))
    np.testing.assert_allclose(r, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(J, [[5, 0, 0], [0, 1, -0.1], [0, 0, 1]], atol=1e-12)


def test_odometry_factor():
    # The odometry fits, one metre ahead: turning the first pose moves the second one sideways.
    r, J_i, J_j = odometry_factor(np.eye(3), se2(1.0, 0.0, 0.0), se2(1.0, 0.0, 0.0), np.eye(3))
    np.testing.assert_allclose(r, [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(J_i, [[-1, 0, 0], [0, -1, -1], [0, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(J_j, np.eye(3), atol=1e-12)


def test_observation_factor():
    # Predicted at 2 m, seen at 1.5 m with a standard deviation of 0.5 m.
    arguments = (np.array([2.0, 0.0]), np.array([1.5, 0.0]), np.diag([0.25, 0.01]))
    r, J_pose, J_landmark = observation_factor(np.eye(3), *arguments)
    np.testing.assert_allclose(r, [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(J_pose, [[-2, 0, 0], [0, -5, -10]], atol=1e-12)
    np.testing.assert_allclose(J_landmark, [[2, 0], [0, 5]], atol=1e-12)


def test_linear_system():
    Lam, eta = linear_system(FACTORS, 2)
    np.testing.assert_allclose(Lam, LAM)
    np.testing.assert_allclose(eta, ETA)


def test_gauss_newton_step():
    # The robot looks north, so a step ahead is one to the north.
    eta = np.array([1.0, 0.0, 0.0, 0.0, 0.5])
    poses, landmarks = gauss_newton_step(
        se2(0.0, 0.0, np.pi / 2)[None], np.array([[3.0, 3.0]]), np.eye(5), eta
    )
    np.testing.assert_allclose(poses, se2(0.0, 1.0, np.pi / 2)[None], atol=1e-12)
    np.testing.assert_allclose(landmarks, [[3.0, 3.5]])


def test_marginalise():
    # b is 1 + 2 = 3, with the variance of both together.
    Lam, eta = marginalise(LAM, ETA, np.array([1]))
    np.testing.assert_allclose(Lam, [[0.5]])
    np.testing.assert_allclose(eta, [1.5])
    np.testing.assert_allclose(marginal_covariance(LAM, np.array([1])), [[2.0]])


def test_smooth():
    # The second pose is found 1 m ahead, as the odometry says; both variances add up.
    link = {"i": 0, "j": 1, "T_ij": se2(1.0, 0.0, 0.0), "Q": 0.01 * np.eye(3)}
    prior = {"T": np.eye(3), "P": np.diag([0.04, 0.04, 1e-12])}
    graph = {"prior": prior, "odometry": [link], "observations": []}
    poses, landmarks, P = smooth(graph, np.stack([np.eye(3), se2(0.7, 0.1, 0.0)]), np.empty((0, 2)), 5)
    np.testing.assert_allclose(poses[1], se2(1.0, 0.0, 0.0), atol=1e-9)
    assert landmarks.shape == (0, 2)
    np.testing.assert_allclose(P, np.diag([0.05, 0.05, 0.01]), atol=1e-9)


def test_window_one():
    back_end = WindowOne(Problem(np.eye(3), 0.01 * np.eye(3), RangeBearing()))
    still = (np.eye(3), np.zeros((3, 3)))
    back_end.update(Frame(0, 0.0, *still, np.array([7]), np.array([[2.0, 0.0]]), 0.01 * np.eye(2)[None]))
    assert back_end.landmarks().ids.tolist() == [7]
    np.testing.assert_allclose(back_end.landmarks().positions, [[2.0, 0.0]])
    # Along the line of sight 0.01 + 0.01; across it the pose's 0.01 and 4 times that of both angles.
    np.testing.assert_allclose(back_end.landmarks().covariances[0], np.diag([0.02, 0.09]), atol=1e-12)
    np.testing.assert_allclose(back_end.estimate().P, 0.01 * np.eye(3), atol=1e-12)


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
