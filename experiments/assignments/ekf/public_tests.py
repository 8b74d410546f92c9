"""Run next to your ekf.py: python public_tests.py. The expected numbers are worked out by hand."""

import numpy as np
from ekf import (
    ekf_step,
    innovation,
    measurement,
    measurement_jacobian,
    motion,
    motion_jacobian,
    propagate,
    update,
)

NORTH = np.array([1.0, 2.0, np.pi / 2])


def test_motion():
    # 2 m/s for 0.5 s to the north; steering 45 degrees with a wheelbase of 4 m turns by 1/4 rad.
    moved = motion(NORTH, np.array([2.0, np.pi / 4]), 0.5, 4.0)
    np.testing.assert_allclose(moved, [1.0, 3.0, np.pi / 2 + 0.25], atol=1e-12)


def test_motion_jacobian():
    G = motion_jacobian(NORTH, np.array([2.0, 0.3]), 0.5, 4.0)
    np.testing.assert_allclose(G, [[1, 0, -1], [0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_measurement():
    # The landmark is 3 m to the east of a car that looks north: on its right.
    np.testing.assert_allclose(measurement(NORTH, np.array([4.0, 2.0])), [3.0, -np.pi / 2])


def test_measurement_jacobian():
    H = measurement_jacobian(NORTH, np.array([4.0, 2.0]))
    np.testing.assert_allclose(H, [[-1, 0, 0], [0, -1 / 3, -1]], atol=1e-12)


def test_innovation():
    np.testing.assert_allclose(
        innovation(np.array([2.0, 3.1]), np.array([1.5, -3.1])), [0.5, 6.2 - 2 * np.pi]
    )


def test_propagate_and_update():
    G = np.array([[1.0, 0, -1], [0, 1, 0], [0, 0, 1]])
    expected = [[2, 0, -1], [0, 1, 0], [-1, 0, 1]]
    np.testing.assert_allclose(propagate(np.eye(3), G, np.zeros((3, 3))), expected)
    H, one = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0]])
    mean, covariance = update(np.zeros(3), np.eye(3), np.array([1.0]), H, one)
    np.testing.assert_allclose(mean, [0, 0, 0.5])
    np.testing.assert_allclose(covariance, np.diag([1, 1, 0.5]))


def test_ekf_step_without_observations():
    args = (np.array([2.0, 0.0]), 0.5, 4.0, 0.1 * np.eye(3))
    mean, covariance = ekf_step(NORTH, np.eye(3), *args, np.empty((0, 2)), np.empty((0, 2)), np.eye(2))
    np.testing.assert_allclose(mean, [1.0, 3.0, np.pi / 2])
    np.testing.assert_allclose(covariance, [[2.1, 0, -1], [0, 1.1, 0], [-1, 0, 1.1]], atol=1e-12)


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
