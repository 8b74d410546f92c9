"""Run next to your from_filter_to_smoother.py: python public_tests.py. All numbers are worked out by hand."""

import numpy as np
from from_filter_to_smoother import (
    SlidingWindow,
    construct,
    marginalise,
    points,
    schur,
    solve,
    world_motions,
)

from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem


def line(prior_mean=0.0):
    """Two poses on the x axis, at 0 and 1 m; odometry says 2 m; all variances 1. Nothing is seen."""
    origin = np.array([prior_mean, 0.0, 0.0])
    return {
        "poses": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        "landmarks": np.empty((0, 2)),
        "motions": np.array([[2.0, 0.0, 0.0]]),
        "Q": np.eye(3)[None],
        "pose_of": np.empty(0, dtype=int),
        "landmark_of": np.empty(0, dtype=int),
        "z": np.empty((0, 2)),
        "R": np.empty((0, 2, 2)),
        "prior": {"Lam": np.eye(3), "eta": np.zeros(3), "centre": origin, "first": origin},
    }


def test_construct():
    window = line()
    Lam, eta = construct(window, window["poses"], window["landmarks"])
    # Along x: the prior's 1 and the motion's 1 on pose 0, the motion's 1 on pose 1, -1 between them.
    np.testing.assert_allclose(Lam[np.ix_([0, 3], [0, 3])], [[2, -1], [-1, 1]])
    # Pose 1 should be a metre further on, or pose 0 a metre back.
    np.testing.assert_allclose(eta[[0, 3]], [-1, 1])
    # A turn of pose 0 moves what lies a metre ahead sideways.
    np.testing.assert_allclose(Lam[2, 4], -1)


def test_construct_with_a_sight():
    window = line()
    more = {"pose_of": [0], "landmark_of": [0], "z": [[1.5, 0.0]], "R": [np.eye(2)]}
    window |= {name: np.array(values) for name, values in more.items()}
    window["landmarks"] = np.array([[2.0, 0.0]])
    Lam, eta = construct(window, window["poses"], window["landmarks"])
    # Predicted at 2 m, seen at 1.5 m: pose 0 should be ahead by half a metre, the landmark nearer.
    np.testing.assert_allclose(eta[[0, 3, 6]], [-0.5, 1, -0.5])
    # Across the line of sight a metre at 2 m is half a radian.
    np.testing.assert_allclose(Lam[7, 7], 0.25)
    np.testing.assert_allclose(Lam[2, 7], -0.5)


def test_construct_moved_from_its_prior():
    # The prior believes in x = 3, pose 0 stands at 0 now: it pulls with 3.
    _, eta = construct(line(3.0), line()["poses"], np.empty((0, 2)))
    np.testing.assert_allclose(eta[[0, 3]], [3 - 1, 1])


def test_solve():
    window = line()
    eta = np.array([0.0, 0.0, np.pi + 0.5, 1.0, 0.0, 0.0])
    poses, landmarks = solve(window, np.eye(6), eta)
    np.testing.assert_allclose(poses, [[0, 0, 0.5 - np.pi], [2, 0, 0]], atol=1e-12)
    assert landmarks.shape == (0, 2)


def test_schur():
    # a is 1, b is a + 2, all with variance 1: b is 3 with variance 2.
    Lam, eta = schur(np.array([[2.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, 2.0]), np.array([1]))
    np.testing.assert_allclose(Lam, [[0.5]])
    np.testing.assert_allclose(eta, [1.5])


def test_marginalise():
    window = line()
    Lam, eta, centre, first = marginalise(window, 1, window["poses"], window["landmarks"])
    # Pose 1 is where odometry takes the prior, at 2 m, 1 m from its value; both variances add up along x.
    np.testing.assert_allclose(Lam[0, 0], 0.5)
    np.testing.assert_allclose(eta[0], 0.5)
    np.testing.assert_allclose(centre, [1, 0, 0])
    np.testing.assert_allclose(first, [1, 0, 0])


def test_points():
    window = line()
    window["prior"] = {**window["prior"], "first": np.array([0.1, 0.2, 0.3])}
    np.testing.assert_allclose(points(window, "latest")[0], window["poses"])
    np.testing.assert_allclose(points(window, "fej")[0], [[0.1, 0.2, 0.3], [1, 0, 0]])
    np.testing.assert_allclose(window["poses"][0], [0, 0, 0], err_msg="the window itself was changed")


def test_world_motions():
    N = world_motions(np.array([[2.0, 1.0, 0.7]]), np.array([[3.0, 0.0]]))
    np.testing.assert_allclose(N, [[1, 0, -1], [0, 1, 2], [0, 0, 1], [1, 0, 0], [0, 1, 3]])


def test_sliding_window():
    back_end = SlidingWindow(Problem(np.eye(3), 0.01 * np.eye(3), RangeBearing()), window=1, iterations=1)
    ahead = np.eye(3)
    ahead[0, 2] = 1.0
    nothing = (np.empty(0, dtype=int), np.empty((0, 2)), np.empty((0, 2, 2)))
    back_end.update(Frame(0, 0.0, np.eye(3), np.zeros((3, 3)), *nothing))
    back_end.update(Frame(1, 0.1, ahead, 0.01 * np.eye(3), *nothing))
    np.testing.assert_allclose(back_end.estimate().T_world_body, ahead, atol=1e-12)
    # Sideways: the prior's 0.01, the motion's 0.01, and the first heading's 0.01 over a metre.
    P = [[0.02, 0, 0], [0, 0.03, 0.01], [0, 0.01, 0.02]]
    np.testing.assert_allclose(back_end.estimate().P, P, atol=1e-12)
    assert len(back_end.landmarks().ids) == 0


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
