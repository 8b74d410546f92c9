"""The recorded image sets: what is read against a second reading, and geometry proved on the images."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from slamcmp.datasets.images.euroc import euroc
from slamcmp.datasets.images.kitti_odometry import kitti_odometry
from slamcmp.datasets.images.seven_scenes import seven_scenes
from slamcmp.datasets.images.tum_rgbd import tum_rgbd
from slamcmp.geometry import dead_reckoning, hat, inverse, local, so3_log
from slamcmp.models.camera import FORWARD_CAMERA
from slamcmp.registry import sources
from slamcmp.types import Log
from tests.recorded_data import recorded


def tracked(first: np.ndarray, second: np.ndarray, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Corners that optical flow finds again there and back, two arrays of pixels (m, 2)."""
    window = {"winSize": (21, 21), "maxLevel": 4}
    start = cv2.goodFeaturesToTrack(first, count, 0.01, 8)
    there, found, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **window)
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, **window)
    start, there, back = (points.reshape(-1, 2).astype(float) for points in (start, there, back))
    good = (found.ravel() > 0) & (again.ravel() > 0) & (np.linalg.norm(start - back, axis=1) < 0.3)
    return start[good], there[good]


def path_length(log: Log) -> float:
    return float(np.linalg.norm(np.diff(log.truth.T_world_body[:, :3, 3], axis=0), axis=1).sum())


def depth_errors(log: Log, first: int, second: int) -> tuple[np.ndarray, float, float]:
    """Depth of the one image carried into the other by the true motion: relative errors (m,), and the mean
    difference of grey values with that motion and without any, but for a change of exposure."""
    camera, T = log.problem.sensor, log.truth.T_world_body
    a, b = log.images[first], log.images[second]
    v, u = (grid.ravel() for grid in np.mgrid[20:460:4, 20:620:4])
    depth = a.depth_m[v, u]
    near = (depth > 0) & (depth < 4)
    u, v, depth = u[near], v[near], depth[near]
    points = camera.point_at_depth(T[first], np.stack([u, v], axis=-1).astype(float), depth)
    there = camera.predict(T[second], points)
    column, row = np.rint(there[:, :2]).astype(int).T
    inside = (column >= 0) & (column < 640) & (row >= 0) & (row < 480)
    column, row, u, v = column[inside], row[inside], u[inside], v[inside]
    measured = b.depth_m[row, column]
    known = measured > 0
    grey = a.image[v, u].astype(float)
    return (
        (measured / there[inside, 2] - 1.0)[known],
        _unlike(grey, b.image[row, column]),
        _unlike(grey, b.image[v, u]),
    )


def _unlike(first: np.ndarray, second: np.ndarray) -> float:
    difference = first - second
    return float(np.abs(difference - np.median(difference)).mean())


def test_kitti_is_what_its_files_say() -> None:
    folder = recorded("kitti06_first51")
    log = kitti_odometry(0, folder=str(folder))
    assert len(log.t) == len(log.images) == 51
    np.testing.assert_allclose(log.t, np.arange(51) / 10.0)
    sensor = log.problem.sensor
    P0 = np.array((folder / "calib.txt").read_text().split()[:12], dtype=float).reshape(3, 4)
    np.testing.assert_array_equal(sensor.K, P0[:, :3])
    np.testing.assert_array_equal(log.images[50].image, cv2.imread(str(folder / "image_l" / "000050.png"), 0))
    rows = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    assert path_length(log) == pytest.approx(
        np.linalg.norm(np.diff(rows[:, :, 3], axis=0), axis=1).sum(), rel=1e-9
    )
    # KITTI: x right, y down, z forward. Here: x forward, y left, z up.
    x, y, z = rows[-1, :, 3]
    np.testing.assert_allclose(log.truth.T_world_body[-1, :3, 3], [z, -x, -y], atol=1e-9)
    np.testing.assert_allclose(log.problem.T_world_body, np.eye(4), atol=1e-9)
    assert log.truth.T_world_body[-1, 0, 3] > 59
    assert "no times.txt" in log.warnings[0]


def test_kitti_images_obey_the_recorded_motion() -> None:
    """Distance of tracked corners from the true motion's epipolar lines; 0.08° of attitude is a pixel."""
    log = kitti_odometry(0, folder=str(recorded("kitti06_first51")))
    camera = log.problem.sensor
    K_inverse = np.linalg.inv(camera.K)
    T = log.truth.T_world_body @ camera.T_body_camera
    for k in (0, 20, 45):
        first, second = tracked(log.images[k].image, log.images[k + 1].image)
        assert len(first) > 150
        motion = inverse(T[k + 1]) @ T[k]
        F = K_inverse.T @ hat(motion[:3, 3]) @ motion[:3, :3] @ K_inverse
        lines = np.column_stack([first, np.ones(len(first))]) @ F.T
        off = np.sum(lines[:, :2] * second, axis=1) + lines[:, 2]
        distance = np.abs(off) / np.linalg.norm(lines[:, :2], axis=1)
        assert np.median(distance) < 0.5


def test_kittis_first_attitudes_settle() -> None:
    """What ``start`` is for: rotations from essential matrices against the true ones."""
    log = kitti_odometry(0, folder=str(recorded("kitti06_first51")), steps=21)
    camera = log.problem.sensor
    T = log.truth.T_world_body @ camera.T_body_camera
    off = []
    for k in range(20):
        first, second = tracked(log.images[k].image, log.images[k + 1].image, 1500)
        E, inliers = cv2.findEssentialMat(first, second, camera.K, cv2.RANSAC, 0.999, 0.5)
        _, R, _, _ = cv2.recoverPose(E, first, second, camera.K, mask=inliers)
        off.append(np.degrees(so3_log(R @ (inverse(T[k + 1]) @ T[k])[:3, :3].T)))
    settling, settled = np.sum(off[:10], axis=0), np.sum(off[10:], axis=0)
    # About the camera's y (heading) and z (roll) axes.
    np.testing.assert_allclose(settling[1:], [-0.6, -0.65], atol=0.25)
    assert np.abs(settled).max() < 0.3


def test_kitti_odometry_drifts_as_stated() -> None:
    folder = str(recorded("kitti06_first51"))
    first, same, other = (kitti_odometry(seed, folder=folder) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.T_prev_body, same.T_prev_body)
    assert not np.array_equal(first.T_prev_body, other.T_prev_body)
    assert sources.get("kitti_odometry").traits["seeded"] is True
    end = dead_reckoning(first.problem.T_world_body, first.T_prev_body)[-1]
    # 50 steps of 1.2 m at 3 % are 0.25 m along the path; the heading's 0.1° a step adds as much across it.
    assert 0.02 < np.linalg.norm(end[:3, 3] - first.truth.T_world_body[-1, :3, 3]) < 2.0


def test_tum_is_what_its_files_say() -> None:
    folder = recorded("tum_fr1_rpy_a")
    log = tum_rgbd(0, folder=str(folder))
    rows = [line.split() for line in (folder / "associations.txt").read_text().splitlines()]
    stamps = np.array([float(row[0]) for row in rows])
    assert len(log.t) == len(rows) == 75
    np.testing.assert_allclose(log.t, stamps - stamps[0], atol=1e-6)
    frame = log.images[10]
    raw = cv2.imread(str(folder / rows[10][3]), cv2.IMREAD_UNCHANGED)
    assert frame.image.shape == frame.depth_m.shape == (480, 640)
    # In the middle the lens moves pixels by less than one: the same metres, 5000 units each.
    middle = (slice(250, 260), slice(315, 325))
    np.testing.assert_allclose(np.median(frame.depth_m[middle]), np.median(raw[middle]) / 5000.0, rtol=0.01)
    # The pose of the nearest true sample: it is at most 5 ms away, in which the hand moves millimetres.
    truth = np.loadtxt(folder / "groundtruth.txt")
    for k in (0, 40, 74):
        nearest = truth[np.argmin(np.abs(truth[:, 0] - stamps[k]))]
        np.testing.assert_allclose(log.truth.T_world_body[k, :3, 3], nearest[1:4], atol=5e-3)
        optical_axis = log.truth.T_world_body[k] @ log.problem.sensor.T_body_camera @ [0, 0, 1, 0]
        x, y, z, w = nearest[4:]
        by_hand = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(optical_axis[:3], by_hand, atol=0.02)
    # Chords are shorter than the way in between them, by little.
    within = truth[(truth[:, 0] >= stamps[0]) & (truth[:, 0] <= stamps[-1]), 1:4]
    whole = np.linalg.norm(np.diff(within[::7], axis=0), axis=1).sum()
    assert path_length(log) == pytest.approx(whole, rel=0.05)


def test_tum_depth_obeys_the_recorded_motion() -> None:
    """Three frames on, as the hand turns by several degrees; without the motion depths differ by 0.1."""
    log = tum_rgbd(0, folder=str(recorded("tum_fr1_rpy_a")))
    for k in (0, 10, 30, 50, 70):
        errors, grey, grey_without = depth_errors(log, k, k + 3)
        assert len(errors) > 5000
        assert np.median(np.abs(errors)) < 0.02
        assert abs(np.median(errors)) < 0.012
        assert grey < 0.5 * grey_without


def test_tum_calibration_by_name_and_pairs_without_associations(tmp_path) -> None:
    folder = recorded("tum_fr1_rpy_a")
    for name in ("rgb", "depth", "groundtruth.txt", "rgb.txt", "depth.txt"):
        (tmp_path / name).symlink_to(folder / name)
    paired = tum_rgbd(0, folder=str(tmp_path))
    listed = tum_rgbd(0, folder=str(folder))
    ours = {each.left.name: each.depth.name for each in paired.images.files}
    theirs = {each.left.name: each.depth.name for each in listed.images.files}
    assert theirs.items() <= ours.items()
    assert paired.problem.sensor.parameters() == listed.problem.sensor.parameters()
    plain = tum_rgbd(0, folder=str(folder), calibration="ros_default", camera="mono")
    assert (plain.problem.sensor.fx_px, plain.problem.sensor.cy_px) == (525.0, 239.5)
    assert plain.images[0].depth_m is None


def test_seven_scenes_is_what_its_files_say() -> None:
    folder = recorded("7scenes_redkitchen")
    log = seven_scenes(0, folder=str(folder))
    assert len(log.t) == 200
    np.testing.assert_allclose(np.diff(log.t), 2 / 30.0)
    poses = np.stack([np.loadtxt(folder / f"frame-{2 * k:06d}.pose.txt") for k in range(200)])
    assert path_length(log) == pytest.approx(
        np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum(), rel=1e-9
    )
    R = log.truth.T_world_body[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    # The world's axes are turned as the camera's are: camera to world stays what the files say.
    camera_pose = inverse(FORWARD_CAMERA) @ log.truth.T_world_body @ log.problem.sensor.T_body_camera
    np.testing.assert_allclose(camera_pose, poses, atol=1e-3)
    raw = cv2.imread(str(folder / "frame-000020.depth.png"), cv2.IMREAD_UNCHANGED)
    depth = log.images[10].depth_m
    assert depth.max() < 10
    assert depth[240, 320] == pytest.approx(raw[240, 320] / 1000.0)
    # 525 px of focal length show more than 585 do: there is no depth at the sides.
    assert not depth[:, :30].any()
    assert depth[100, 100] == pytest.approx(
        raw[round(240 - 140 * 585 / 525), round(320 - 220 * 585 / 525)] / 1e3
    )
    assert any("registered to colour by focal length only" in warning for warning in log.warnings)


def test_seven_scenes_depth_and_colour_obey_the_recorded_motion() -> None:
    log = seven_scenes(0, folder=str(recorded("7scenes_redkitchen")))
    for k in (0, 50, 100, 150):
        errors, grey, grey_without = depth_errors(log, k, k + 5)
        assert len(errors) > 5000
        assert np.median(np.abs(errors)) < 0.007
        assert abs(np.median(errors)) < 0.003
        assert grey < 0.5 * grey_without


def test_euroc_is_what_its_files_say() -> None:
    folder = recorded("euroc_v101_static")
    log = euroc(0, folder=str(folder))
    rows = (folder / "mav0/cam0/data.csv").read_text().split()[2:]
    stamps = np.array([int(row.split(",")[0]) for row in rows if row[0].isdigit()])
    np.testing.assert_allclose(log.t, (stamps - stamps[0]) / 1e9, rtol=1e-15)
    truth = np.loadtxt(folder / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",")
    np.testing.assert_allclose(log.truth.T_world_body[:, :3, 3], truth[:6, 1:4], atol=1e-12)
    w, x, y, z = truth[0, 4:8]
    first_column = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    np.testing.assert_allclose(log.truth.T_world_body[0, :3, 0], first_column, atol=1e-5)
    # It stands: half a millimetre in a quarter of a second.
    assert path_length(log) < 5e-4
    # The body's x axis is up, as the IMU is mounted.
    assert log.truth.T_world_body[0, 2, 0] > 0.9
    sensor = log.problem.sensor
    # Published by others for this pair: 47.906 px·m after rectification (to the crop, which is a choice).
    assert sensor.baseline_m == pytest.approx(0.11007, abs=1e-4)
    assert sensor.fx_px * sensor.baseline_m == pytest.approx(47.906, rel=0.01)
    mono = euroc(0, folder=str(folder / "mav0"), camera="mono")
    assert mono.images[0].right is None
    np.testing.assert_allclose(
        mono.problem.sensor.T_body_camera[0, :3], [0.0148655, -0.9998809, 0.0041403], atol=1e-6
    )


def test_euroc_pairs_lie_on_rows() -> None:
    log = euroc(0, folder=str(recorded("euroc_v101_static")))
    for k in (0, 5):
        left, right = tracked(log.images[k].image, log.images[k].right)
        assert len(left) > 100
        off = np.abs(right[:, 1] - left[:, 1])
        assert (off < 1.0).mean() > 0.97
        assert np.median(off) < 0.2
        # Everything is in front of the pair: within 0.8 and 5 m, as the Vicon room is.
        depth = log.problem.sensor.invert(np.eye(4), np.column_stack([left[:, 0], right[:, 0], left[:, 1]]))
        assert (left[:, 0] - right[:, 0] > 0).all()
        assert 0.5 < np.median(np.linalg.norm(depth, axis=1)) < 5.0


def test_on_kittis_straight_piece_a_clock_s_offset_cannot_be_told() -> None:
    """About and along each axis its motion changes by less than the noise of the odometry hides."""
    log = kitti_odometry(0, folder=str(recorded("kitti06_first51")))
    T = log.truth.T_world_body
    motion = np.array([local(first, second) for first, second in pairwise(T)])
    k = np.arange(len(motion))
    changes = motion - np.stack([np.polyval(np.polyfit(k, each, 1), k) for each in motion.T], axis=1)
    sigmas = np.sqrt(np.diagonal(log.Q[1:], axis1=1, axis2=2).mean(axis=0))
    assert (changes.std(axis=0) < 0.7 * sigmas).all()
