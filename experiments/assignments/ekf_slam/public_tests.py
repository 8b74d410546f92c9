"""Run next to your ekf_slam.py: python public_tests.py. The expected numbers are worked out by hand."""

import numpy as np
from ekf_slam import EkfSlam, augment, predict, update

from slamcmp.geometry import se2
from slamcmp.models.sensors import RangeBearing
from slamcmp.types import Frame, Problem


def test_predict():
    # One metre ahead: a heading error of the old pose is a sideways error of the new one.
    T, P = predict(np.eye(3), np.diag([0.0, 0.0, 0.04]), se2(1.0, 0.0, 0.0), np.zeros((3, 3)))
    np.testing.assert_allclose(T, se2(1.0, 0.0, 0.0))
    np.testing.assert_allclose(P, [[0, 0, 0], [0, 0.04, 0.04], [0, 0.04, 0.04]], atol=1e-12)


def test_augment():
    # A landmark 2 m ahead: along the line of sight the range's noise, across it 2 m times the angles'.
    z, R = np.array([2.0, 0.0]), np.diag([0.01, 0.0004])
    landmarks, P = augment(np.eye(3), np.empty((0, 2)), np.diag([0.09, 0.09, 0.0016]), z, R)
    np.testing.assert_allclose(landmarks, [[2.0, 0.0]])
    np.testing.assert_allclose(P[3:, 3:], np.diag([0.09 + 0.01, 0.09 + 4 * 0.0016 + 4 * 0.0004]), atol=1e-12)
    np.testing.assert_allclose(P[3:, :3], [[0.09, 0, 0], [0, 0.09, 2 * 0.0016]], atol=1e-12)


def test_update():
    # The landmark is known exactly, and as sure of the range as of the position: half-way.
    P = np.diag([0.04, 1e-9, 1e-9, 1e-12, 1e-12])
    arguments = (np.array([0]), np.array([[2.2, 0.0]]), np.diag([0.04, 1.0])[None])
    T, landmarks, P = update(np.eye(3), np.array([[2.0, 0.0]]), P, *arguments)
    np.testing.assert_allclose(T, se2(-0.1, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(landmarks, [[2.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(P[0, 0], 0.02, atol=1e-6)


def test_back_end():
    back_end = EkfSlam(Problem(np.eye(3), 0.01 * np.eye(3), RangeBearing()))
    still = (np.eye(3), np.zeros((3, 3)))
    back_end.update(Frame(0, 0.0, *still, np.array([7]), np.array([[2.0, 0.0]]), 0.01 * np.eye(2)[None]))
    assert back_end.landmarks().ids.tolist() == [7]
    np.testing.assert_allclose(back_end.landmarks().positions, [[2.0, 0.0]])
    np.testing.assert_allclose(back_end.estimate().P, 0.01 * np.eye(3), atol=1e-12)


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
