"""Every sensor's Jacobians against central differences and against gtsam's own factors."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.errors import DataError, UsageError
from slamcmp.models.sensors import (
    BearingOnly,
    RangeBearing,
    RangeOnly,
    RelativePosition,
    cartesian_to_polar,
    make_sensor,
)

PLACING = [RangeBearing(), RelativePosition(), RelativePosition(space_dim=3)]
PLACING_IDS = ["range_bearing", "relative_position_2d", "relative_position_3d"]
SENSORS = [*PLACING, RangeOnly(), BearingOnly()]
IDS = [*PLACING_IDS, "range_only", "bearing_only"]


def scenes(sensor, count=20, seed=11):
    """Random poses and landmarks, some of them behind the robot (the cut of atan2)."""
    generator = np.random.default_rng(seed)
    n = sensor.space_dim
    for _ in range(count):
        xi = generator.uniform(-3, 3, 3 if n == 2 else 6)
        yield g.exp(xi), generator.uniform(-20, 20, n)
    T = g.exp(np.zeros(3 if n == 2 else 6))
    yield T, np.array([-5.0, 1e-9, 0.0])[:n]


def differences(function, size, step=1e-5):
    def slopes(h):
        return np.stack([(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(size)], axis=-1)

    return (4 * slopes(step) - slopes(2 * step)) / 3


@pytest.mark.parametrize("sensor", SENSORS, ids=IDS)
def test_jacobians_equal_central_differences(sensor):
    for T, landmark in scenes(sensor):
        H_pose, H_landmark = sensor.jacobians(T, landmark)
        z = sensor.predict(T, landmark)
        by_pose = differences(
            lambda xi, T=T, landmark=landmark, z=z: sensor.residual(
                sensor.predict(g.retract(T, xi), landmark), z
            ),
            3 if sensor.space_dim == 2 else 6,
        )
        by_landmark = differences(
            lambda d, T=T, landmark=landmark, z=z: sensor.residual(sensor.predict(T, landmark + d), z),
            sensor.space_dim,
        )
        np.testing.assert_allclose(H_pose, by_pose, rtol=0, atol=2e-8)
        np.testing.assert_allclose(H_landmark, by_landmark, rtol=0, atol=2e-8)


@pytest.mark.parametrize("sensor", PLACING, ids=PLACING_IDS)
def test_invert_undoes_predict(sensor):
    for T, landmark in scenes(sensor):
        np.testing.assert_allclose(
            sensor.invert(T, sensor.predict(T, landmark)), landmark, rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("sensor", SENSORS, ids=IDS)
def test_batches_give_what_single_landmarks_give(sensor):
    T, _ = next(scenes(sensor))
    landmarks = np.random.default_rng(2).uniform(-9, 9, (7, sensor.space_dim))
    z = sensor.predict(T, landmarks)
    H_pose, H_landmark = sensor.jacobians(T, landmarks)
    places = sensor.invert(T, z) if sensor in PLACING else landmarks
    for i, landmark in enumerate(landmarks):
        np.testing.assert_allclose(z[i], sensor.predict(T, landmark), rtol=0, atol=1e-14)
        one = sensor.jacobians(T, landmark)
        np.testing.assert_allclose(H_pose[i], one[0], rtol=0, atol=1e-14)
        np.testing.assert_allclose(H_landmark[i], one[1], rtol=0, atol=1e-14)
        np.testing.assert_allclose(places[i], landmark, rtol=0, atol=1e-12)
    # Poses may be batched too: one pose for each landmark.
    poses = np.stack([T @ g.exp(0.1 * i * np.ones(3 if sensor.space_dim == 2 else 6)) for i in range(7)])
    together = sensor.jacobians(poses, landmarks)
    for i in range(7):
        apart = sensor.jacobians(poses[i], landmarks[i])
        np.testing.assert_allclose(together[0][i], apart[0], rtol=0, atol=1e-14)
        np.testing.assert_allclose(together[1][i], apart[1], rtol=0, atol=1e-14)


def test_range_bearing_equals_the_linearised_gtsam_factor():
    sensor = RangeBearing()
    sigmas = np.array([0.02, 0.3])  # gtsam's order: bearing, range
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    for T, landmark in scenes(sensor):
        x, y, theta = g.se2_coordinates(T)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose2(x, y, theta))
        values.insert(1, landmark)
        z = sensor.predict(T, landmark) + np.array([0.1, -0.05])
        factor = gtsam.BearingRangeFactor2D(0, 1, gtsam.Rot2(z[1]), z[0], noise)
        linear = factor.linearize(values)
        A, b = linear.jacobian()
        order = linear.keys()
        H_pose, H_landmark = sensor.jacobians(T, landmark)
        residual = sensor.residual(z, sensor.predict(T, landmark))
        ours = np.hstack([H_pose, H_landmark])[::-1] / sigmas[:, None]
        theirs = A if order[0] == 0 else np.hstack([A[:, 2:], A[:, :2]])
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
        np.testing.assert_allclose(residual[::-1] / sigmas, b, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sensor", [RangeOnly(), BearingOnly()], ids=lambda sensor: sensor.name)
def test_a_part_of_range_and_bearing_is_that_row_of_it_and_the_linearised_gtsam_factor(sensor):
    whole, noise = RangeBearing(), gtsam.noiseModel.Isotropic.Sigma(1, 0.3)
    row = slice(sensor.component, sensor.component + 1)
    for T, landmark in scenes(sensor):
        np.testing.assert_array_equal(sensor.predict(T, landmark), whole.predict(T, landmark)[row])
        z = sensor.predict(T, landmark) + 0.07
        values = gtsam.Values()
        values.insert(0, gtsam.Pose2(*g.se2_coordinates(T)))
        values.insert(1, landmark)
        factor = (
            gtsam.RangeFactor2D(0, 1, z[0], noise)
            if sensor.name == "range_only"
            else gtsam.BearingFactor2D(0, 1, gtsam.Rot2(z[0]), noise)
        )
        linear = factor.linearize(values)
        A, b = linear.jacobian()
        theirs = A if linear.keys()[0] == 0 else np.hstack([A[:, 2:], A[:, :2]])
        np.testing.assert_allclose(np.hstack(sensor.jacobians(T, landmark)) / 0.3, theirs, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            sensor.residual(z, sensor.predict(T, landmark)) / 0.3, b, rtol=0, atol=1e-9
        )


@pytest.mark.parametrize("sensor", [RangeOnly(), BearingOnly()], ids=lambda sensor: sensor.name)
def test_a_part_places_no_landmark_and_says_who_waits_for_more(sensor):
    with pytest.raises(UsageError, match=rf"{sensor.name}: one measurement does not .*'delayed_start'"):
        sensor.invert(np.eye(3), np.array([1.0]))
    assert make_sensor(sensor.name, sensor.parameters()).components == sensor.components


def test_bearings_wrap():
    z = BearingOnly().residual(np.array([math.pi - 0.1]), np.array([-math.pi + 0.1]))
    np.testing.assert_allclose(z, [-0.2], rtol=0, atol=1e-15)


@pytest.mark.parametrize("n", [2, 3])
def test_relative_position_equals_gtsam_transform_to(n):
    sensor = RelativePosition(space_dim=n)
    for T, landmark in scenes(sensor):
        if n == 2:
            x, y, theta = g.se2_coordinates(T)
            pose, H_pose, H_point = gtsam.Pose2(x, y, theta), np.zeros((2, 3)), np.zeros((2, 2))
        else:
            pose, H_pose, H_point = gtsam.Pose3(T), np.zeros((3, 6)), np.zeros((3, 3))
        H_pose, H_point = np.asfortranarray(H_pose), np.asfortranarray(H_point)
        predicted = pose.transformTo(landmark, H_pose, H_point)
        np.testing.assert_allclose(sensor.predict(T, landmark), predicted, rtol=0, atol=1e-12)
        ours = sensor.jacobians(T, landmark)
        np.testing.assert_allclose(ours[0], H_pose, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours[1], H_point, rtol=0, atol=1e-12)


def test_range_bearing_by_hand():
    sensor = RangeBearing()
    T = g.se2(1.0, 2.0, math.pi / 2)
    np.testing.assert_allclose(sensor.predict(T, np.array([-2.0, 6.0])), [5.0, math.atan2(3, 4)])
    z = np.array([1.0, math.pi - 0.1])
    np.testing.assert_allclose(
        sensor.residual(z, np.array([0.5, -math.pi + 0.1])), [0.5, -0.2], rtol=0, atol=1e-15
    )


def test_relative_positions_become_polar_with_first_order_covariances():
    generator = np.random.default_rng(7)
    z = np.stack([generator.uniform(1, 9, 12), generator.uniform(-3, 3, 12)], axis=-1)
    A = generator.standard_normal((12, 2, 2))
    R = A @ np.swapaxes(A, -1, -2) + np.eye(2)
    polar_z, polar_R = cartesian_to_polar(z, R)
    np.testing.assert_allclose(RangeBearing().invert(np.eye(3), polar_z), z, rtol=0, atol=1e-13)
    # The sensor's own derivative by the landmark is the change of coordinates, seen from the origin.
    _, D = RangeBearing().jacobians(np.eye(3), z)
    np.testing.assert_allclose(polar_R, D @ R @ np.swapaxes(D, -1, -2), rtol=1e-11)
    # An isotropic position error is sigma in range and sigma/r in bearing.
    _, polar = cartesian_to_polar(np.array([[3.0, 4.0]]), 0.4 * np.eye(2)[None])
    np.testing.assert_allclose(polar[0], np.diag([0.4, 0.4 / 25]), rtol=0, atol=1e-15)


def test_sensors_are_rebuilt_from_name_and_parameters():
    for sensor in SENSORS:
        again = make_sensor(sensor.name, sensor.parameters())
        assert (again.dim, again.space_dim) == (sensor.dim, sensor.space_dim)
        assert again.components == sensor.components
        assert len(again.components) == again.dim
    with pytest.raises(UsageError, match=r"did you mean 'range_bearing'"):
        make_sensor("range_bearings", {})
    with pytest.raises(DataError, match="2 or 3"):
        RelativePosition(space_dim=4)
