"""The wheel's stereo measurements of KITTI 00: against the files themselves and against KITTI's poses."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest

from slamcmp.datasets.kitti00_stereo import kitti00_stereo
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.geometry import dead_reckoning, inverse
from slamcmp.metrics.alignment import align_points
from slamcmp.models.camera import FORWARD_CAMERA
from slamcmp.registry import sources
from slamcmp.types import Log
from tests.recorded_data import recorded


@pytest.fixture(scope="module")
def log() -> Log:
    return kitti00_stereo()


def test_published_size(log: Log) -> None:
    ids = np.concatenate([seen.ids for seen in log.detections])
    assert (log.t.size, np.unique(ids).size, ids.size) == (135, 26_136, 88_781)
    assert log.truth is None
    assert log.images is None
    assert sources.get("kitti00_stereo").traits["seeded"] is False
    sensor = log.problem.sensor
    numbers = np.array(
        Path(gtsam.findExampleDataFile("VO_calibration00.txt")).read_text().split(), dtype=float
    )
    assert [sensor.fx_px, sensor.fy_px, sensor.cx_px, sensor.cy_px, sensor.baseline_m] == [
        *numbers[:2],
        *numbers[3:],
    ]
    # Every second image is left out from 94 to 130.
    np.testing.assert_allclose(np.diff(log.t)[[0, 92, 93, 111, 112, 133]], [0.1, 0.1, 0.2, 0.2, 0.1, 0.1])


def test_measurements_and_the_points_beside_them(log: Log) -> None:
    """Columns 6 to 8 are the point in the camera's frame, found by other code from columns 3 to 5."""
    rows = np.loadtxt(gtsam.findExampleDataFile("VO_stereo_factors00.txt"))
    frame_of = {pose: k for k, pose in enumerate(sorted(set(rows[:, 0].tolist())))}
    sensor = log.problem.sensor
    for row in rows[::977]:
        seen = log.detections[frame_of[row[0]]]
        (at,) = np.flatnonzero(seen.ids == int(row[1]))
        np.testing.assert_array_equal(seen.z[at], row[2:5])
        point = sensor.invert(inverse(FORWARD_CAMERA), seen.z[at])
        # The file's six digits leave a disparity of d px uncertain by 0.002/d.
        np.testing.assert_allclose(point, row[5:], rtol=0.01 + 0.002 / (row[2] - row[3]), atol=0.01)
        np.testing.assert_allclose(seen.R[at], 0.16 * np.eye(3))


def test_odometry_leads_along_the_files_poses(log: Log) -> None:
    rows = np.loadtxt(gtsam.findExampleDataFile("VO_camera_poses00.txt"))
    there = dead_reckoning(log.problem.T_world_body, log.T_prev_body)
    camera = inverse(FORWARD_CAMERA) @ there @ FORWARD_CAMERA
    np.testing.assert_allclose(camera, rows[:, 1:].reshape(-1, 4, 4), atol=2e-4)
    sigmas = np.sqrt(np.diagonal(log.Q, axis1=1, axis2=2))
    assert not log.Q[0].any()
    step = np.linalg.norm(rows[1, [4, 8, 12]])
    np.testing.assert_allclose(sigmas[1, :3], np.radians(0.06))
    np.testing.assert_allclose(sigmas[1, 3:], np.hypot(0.01, 0.03 * step), rtol=1e-4)
    # Over a left-out image it is less sure.
    assert sigmas[94, 0] == pytest.approx(np.sqrt(2) * sigmas[1, 0])


def test_measurements_fit_the_poses_to_a_pixel(log: Log) -> None:
    """Each landmark where its first frame saw it, in the next one: half the coordinates within 0.5 px."""
    poses = dead_reckoning(log.problem.T_world_body, log.T_prev_body)
    sensor = log.problem.sensor
    errors = []
    for k in range(0, 134, 10):
        first, second = log.detections[k], log.detections[k + 1]
        _, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
        points = sensor.invert(poses[k], first.z[a])
        errors.append(sensor.predict(poses[k + 1], points) - second.z[b])
    assert np.median(np.abs(np.concatenate(errors))) < 0.3


def test_the_files_poses_lie_at_their_published_distance_from_kittis() -> None:
    """0.318 m over 111 m, which shows that pose ids are KITTI's image numbers."""
    truth_file = recorded("kitti00_stereo_factors") / "kitti00_gt_frames0-153.txt"
    log = kitti00_stereo(truth_file=str(truth_file))
    truth = log.truth.T_world_body
    found = dead_reckoning(log.problem.T_world_body, log.T_prev_body)
    aligned = align_points(found[:, :3, 3], truth[:, :3, 3]).points(found[:, :3, 3])
    ate = np.sqrt(np.mean(np.sum((aligned - truth[:, :3, 3]) ** 2, axis=1)))
    assert ate == pytest.approx(0.318, abs=0.001)
    assert np.linalg.norm(np.diff(found[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(110.7, abs=0.1)
    rows = np.loadtxt(truth_file).reshape(-1, 3, 4)
    x, y, z = rows[153, :, 3]
    np.testing.assert_allclose(truth[-1, :3, 3], [z, -x, -y], atol=1e-6)


def test_the_truth_is_doubtful_at_its_beginning() -> None:
    """Its steps against the measured ones: what the text of the source says and ``start`` is for."""
    truth_file = str(recorded("kitti00_stereo_factors") / "kitti00_gt_frames0-153.txt")
    log = kitti00_stereo(truth_file=truth_file)
    measured = np.linalg.norm(log.T_prev_body[1:, :3, 3], axis=1)
    ratio = np.linalg.norm(np.diff(log.truth.T_world_body[:, :3, 3], axis=0), axis=1) / measured
    assert ratio[0] == pytest.approx(1.27, abs=0.01)
    assert (np.diff(ratio[:12]) < 0).all()
    assert np.abs(ratio[14:30] - 1).max() < 0.015
    later = kitti00_stereo(truth_file=truth_file, start=50)
    found = dead_reckoning(later.problem.T_world_body, later.T_prev_body)[:, :3, 3]
    true = later.truth.T_world_body[:, :3, 3]
    aligned = align_points(found, true).points(found)
    assert np.sqrt(np.mean(np.sum((aligned - true) ** 2, axis=1))) == pytest.approx(0.068, abs=0.001)


def test_truth_that_is_too_short_or_not_there(tmp_path: Path) -> None:
    short = tmp_path / "00.txt"
    short.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 100)
    with pytest.raises(DataError, match=r"00\.txt: 100 poses, but image 153 is measured"):
        kitti00_stereo(truth_file=str(short))
    assert kitti00_stereo(truth_file=str(short), steps=50).truth.t.size == 50
    with pytest.raises(MissingDataError, match=r"none\.txt: there is no such file"):
        kitti00_stereo(truth_file=str(tmp_path / "none.txt"))


def test_steps_keeps_the_first_frames(log: Log) -> None:
    first = kitti00_stereo(steps=7)
    assert len(first.detections) == 7
    np.testing.assert_array_equal(first.T_prev_body, log.T_prev_body[:7])
    np.testing.assert_array_equal(first.detections[6].z, log.detections[6].z)
    middle = kitti00_stereo(start=90, steps=10)
    np.testing.assert_array_equal(middle.T_prev_body[1:], log.T_prev_body[91:100])
    np.testing.assert_allclose(middle.t, log.t[90:100] - log.t[90])
    for a, b in zip(middle.detections, log.detections[90:100], strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
    with pytest.raises(UsageError, match="start 134 leaves 1 of 135 frames"):
        kitti00_stereo(start=134)


def test_truth_may_be_missing_where_the_experiment_says_so(tmp_path: Path) -> None:
    log = kitti00_stereo(truth_file=str(tmp_path / "none.txt"), truth_optional=True, steps=3)
    assert log.truth is None
    assert log.warnings == (f"no truth: {tmp_path / 'none.txt'} was not found, nor under SLAMCMP_DATA",)
