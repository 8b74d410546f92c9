"""Victoria Park against the file itself and against a graph that gtsam builds and sums up on its own."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.datasets.wheel import find_file, wheel_file
from slamcmp.errors import MissingDataError
from slamcmp.registry import sources
from slamcmp.types import Log
from tests.recorded_data import recorded


@pytest.fixture(scope="module")
def polar() -> Log:
    return victoria_park()


@pytest.fixture(scope="module")
def cartesian() -> Log:
    return victoria_park(sensor="relative_position")


@pytest.fixture(scope="module")
def lines() -> list[list[str]]:
    with open(gtsam.findExampleDataFile("victoria_park.txt")) as file:
        return [line.split() for line in file]


def test_published_size(polar, cartesian):
    for log in (polar, cartesian):
        ids = np.concatenate([seen.ids for seen in log.detections])
        assert (len(log.t), len(np.unique(ids)), len(ids)) == (6969, 151, 3640)
        assert log.truth is None
        np.testing.assert_array_equal(log.problem.T_world_body, np.eye(3))
        np.testing.assert_allclose(log.problem.P, 1e-12 * np.eye(3))


def test_odometry_is_the_files(polar, lines):
    rows = np.array([[float(x) for x in line[3:]] for line in lines if line[0] == "ODOMETRY"])
    np.testing.assert_allclose(g.se2_coordinates(polar.T_prev_body[1:]), rows[:, :3], rtol=0, atol=1e-14)
    expected = np.array([np.diag([1e-4, 4e-6, 4e-6])] * 6968)
    np.testing.assert_allclose(polar.Q[1:], expected, rtol=1e-12)


def test_observations_are_the_files(polar, cartesian, lines):
    """Pose and landmark ids share one numbering: the k-th distinct pose id is frame k."""
    pose_ids = sorted({int(i) for line in lines if line[0] == "ODOMETRY" for i in line[1:3]})
    frame_of = {pose: k for k, pose in enumerate(pose_ids)}
    checked = 0
    for line in lines:
        if line[0] != "LANDMARK":
            continue
        k, landmark = frame_of[int(line[1])], int(line[2])
        x, y = float(line[3]), float(line[4])
        row = cartesian.detections[k].ids.tolist().index(landmark)
        np.testing.assert_array_equal(cartesian.detections[k].z[row], [x, y])
        np.testing.assert_allclose(cartesian.detections[k].R[row], 0.4 * np.eye(2), rtol=1e-15)
        r = math.hypot(x, y)
        np.testing.assert_allclose(polar.detections[k].z[row], [r, math.atan2(y, x)], rtol=1e-15)
        # Diagonal but for the rounding of D R D^T.
        np.testing.assert_allclose(
            polar.detections[k].R[row], np.diag([0.4, 0.4 / r**2]), rtol=1e-14, atol=1e-16
        )
        checked += 1
    assert checked == 3640
    assert not set(pose_ids) & set(np.concatenate([seen.ids for seen in polar.detections]).tolist())


def test_cost_at_dead_reckoning_equals_gtsams_own(polar, lines):
    """The whole graph straight from the file's text with native factors: same poses, same total error."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    odometry = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01, 0.002, 0.002]))
    values.insert(0, gtsam.Pose2())
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    poses = {0: gtsam.Pose2()}
    for line in lines:
        i, j = int(line[1]), int(line[2])
        if line[0] == "ODOMETRY":
            step = gtsam.Pose2(*map(float, line[3:6]))
            poses[j] = poses[i].compose(step)
            values.insert(j, poses[j])
            graph.add(gtsam.BetweenFactorPose2(i, j, step, odometry))
    places = {}
    for line in lines:
        i, j = int(line[1]), int(line[2])
        if line[0] == "LANDMARK":
            point = np.array([float(line[3]), float(line[4])])
            r = np.linalg.norm(point)
            if j not in places:
                places[j] = poses[i].transformFrom(point)
                values.insert(j, places[j])
            noise = gtsam.noiseModel.Diagonal.Sigmas(math.sqrt(0.4) * np.array([1 / r, 1.0]))
            bearing = gtsam.Rot2(math.atan2(point[1], point[0]))
            graph.add(gtsam.BearingRangeFactor2D(i, j, bearing, r, noise))
    theirs = graph.error(values)

    path = g.dead_reckoning(polar.problem.T_world_body, polar.T_prev_body)
    last = poses[max(poses)]
    np.testing.assert_allclose(g.se2_coordinates(path[-1])[:2], [last.x(), last.y()], rtol=0, atol=1e-9)
    sensor, known, cost = polar.problem.sensor, {}, 0.0
    for T, seen in zip(path, polar.detections, strict=True):
        for landmark, z, R in zip(seen.ids.tolist(), seen.z, seen.R, strict=True):
            place = known.setdefault(landmark, sensor.invert(T, z))
            error = sensor.residual(z, sensor.predict(T, place))
            cost += 0.5 * error @ np.linalg.solve(R, error)
    assert cost == pytest.approx(theirs, rel=1e-9)
    assert cost > 1e5


def test_steps_keeps_the_first_poses(polar):
    short = victoria_park(steps=500)
    assert len(short.t) == 500
    np.testing.assert_array_equal(short.T_prev_body, polar.T_prev_body[:500])
    for a, b in zip(short.detections, polar.detections[:500], strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_array_equal(a.z, b.z)


def test_registered_as_recorded_data_with_its_file():
    plugin = sources.get("victoria_park")
    assert plugin.traits["seeded"] is False
    assert plugin.traits["files"](sensor="range_bearing") == [wheel_file("victoria_park.txt")]
    assert set(plugin.parameters()) == {"sensor", "steps"}


def test_wheel_files_are_where_gtsam_says(tmp_path):
    for name in ("victoria_park.txt", "w100.graph"):
        assert str(wheel_file(name)) == gtsam.findExampleDataFile(name)
    with pytest.raises(MissingDataError, match=r"near names: .*w100\.graph"):
        wheel_file("w1000.graph")
    own = tmp_path / "w100.graph"
    own.write_text("")
    assert find_file(str(own)) == own
    assert find_file("w100.graph") == wheel_file("w100.graph")


def test_stamps_are_the_logs_laser_scans(cartesian):
    """Each at a scan of the original log; the wheels moved in between what the file's odometry says."""
    folder = recorded("victoria_park")
    events = np.loadtxt(folder / "Sensors_manager.txt")
    scans = events[events[:, 1] == 3, 0]
    nearest = np.abs(scans[None, :] - cartesian.t[:, None])
    assert nearest.min(axis=1).max() < 0.002
    assert np.unique(nearest.argmin(axis=1)).size == 6969
    # The encoder is at the left rear wheel, 0.76 m from the axle's middle; the wheel base is 2.83 m.
    t, wheel, steering = np.loadtxt(folder / "DRS.txt").T
    speed = wheel / (1 - 0.76 / 2.83 * np.tan(steering))
    path = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))])
    driven = np.diff(np.interp(cartesian.t, t, path))
    measured = cartesian.T_prev_body[1:, 0, 2]
    # The file's increments are speeds of one instant times the time step.
    assert np.abs(driven - measured).max() < 0.1
    assert driven.sum() == pytest.approx(measured.sum(), rel=1e-3)
    # By frame number the two would be 33 m apart somewhere; so they are 4 m at most.
    by_number = np.interp(np.linspace(cartesian.t[0], cartesian.t[-1], 6969), t, path)
    apart = np.abs(np.interp(cartesian.t, t, path) - by_number).max()
    assert apart > 30 > 4 > np.abs(np.cumsum(driven - measured)).max()
