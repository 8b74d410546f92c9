"""Folders of images written here: what is read, and what is said about bad input."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from slamcmp.datasets.images.calibration_file import read_calibration
from slamcmp.datasets.images.image_folder import image_folder
from slamcmp.errors import DataError, MissingDataError, UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.geometry import exp, inverse, quaternion
from slamcmp.models.camera import FORWARD_CAMERA, StereoCamera
from slamcmp.registry import sources
from slamcmp.types import Log
from tests.datasets.test_rectification import LEFT, RIGHT, T_LEFT_RIGHT

WIDTH, HEIGHT = 80, 60
MONO = {"camera": "mono", "image_size": [WIDTH, HEIGHT], "intrinsics": [70.0, 71.0, 40.5, 29.0]}


def picture(k: int) -> np.ndarray:
    """Noise that tells frame k from the others."""
    return np.random.default_rng(k).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def write_calibration(folder: Path, content: Mapping[str, Any]) -> None:
    YAML(typ="safe").dump(dict(content), folder / "calibration.yaml")


def write_folder(folder: Path, count: int = 6, **changes: Any) -> Path:
    """Images 000.png … in ``left`` and their calibration."""
    (folder / "left").mkdir(parents=True)
    for k in range(count):
        assert cv2.imwrite(str(folder / "left" / f"{k:03d}.png"), picture(k))
    write_calibration(folder, {**MONO, **changes})
    return folder


def log_of(folder: Path, **parameters: Any) -> Log:
    given = {"images": "left", "rate_hz": 10.0, **parameters}
    return image_folder(0, folder=str(folder), **given)


def test_images_times_and_camera_come_through(tmp_path: Path) -> None:
    log = log_of(write_folder(tmp_path))
    np.testing.assert_allclose(log.t, np.arange(6) / 10.0)
    for k, frame in enumerate(log.images):
        np.testing.assert_array_equal(frame.image, picture(k))
        assert frame.problem == ""
    sensor = log.problem.sensor
    assert (sensor.fx_px, sensor.fy_px, sensor.cx_px, sensor.cy_px) == (70.0, 71.0, 40.5, 29.0)
    np.testing.assert_array_equal(sensor.T_body_camera, FORWARD_CAMERA)
    assert log.truth is None
    assert log.warnings == ()
    # Nobody said how it moved: the log claims nothing but that it stands, loosely.
    np.testing.assert_array_equal(log.T_prev_body, np.tile(np.eye(4), (6, 1, 1)))
    np.testing.assert_allclose(np.sqrt(np.diag(log.Q[1]))[3:], 0.1)


def test_bad_files_become_frames_without_image_and_a_reason(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=8)
    left = folder / "left"
    (folder / "times.txt").write_text("".join(f"{k * 0.1:.1f} {k:03d}.png\n" for k in range(9)))
    (left / "001.png").write_bytes((left / "001.png").read_bytes()[:1500])
    cv2.imwrite(str(left / "002.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    cv2.imwrite(str(left / "003.png"), np.full((HEIGHT, WIDTH), 700, np.uint16))
    cv2.imwrite(str(left / "004.png"), np.zeros((HEIGHT, WIDTH + 1), np.uint8))
    (left / "005.png").write_bytes(b"this is no image")
    cv2.imwrite(str(left / "006.png"), np.dstack([picture(6)] * 3))
    log = log_of(folder, times="times.txt", rate_hz=None)
    assert [frame.problem for frame in log.images] == [
        "",
        "the image file is truncated",
        "all black",
        "16 bits a channel where 8 are needed",
        "81×60 pixels where 80×60 are needed",
        "not an image that can be decoded, or damaged",
        "",
        "",
        "the file is missing",
    ]
    assert [frame.image is None for frame in log.images] == [bool(frame.problem) for frame in log.images]
    np.testing.assert_array_equal(log.images[6].image, picture(6))
    np.testing.assert_array_equal(log.images[-2].image, picture(7))
    assert len(log.images[2:5]) == 3
    with pytest.raises(IndexError):
        log.images[9]


def test_repeated_stamps_are_dropped_and_gaps_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=8)
    (folder / "times.csv").write_text("0\n100\n100\n200\n300\n1100\n1200\n1300\n")
    log = log_of(folder, times="times.csv", time_unit_s=1e-3, rate_hz=None)
    np.testing.assert_allclose(log.t, [0, 0.1, 0.2, 0.3, 1.1, 1.2, 1.3], atol=1e-12)
    assert log.warnings == (
        "left out 1 frame(s) with the time stamp of another: 002.png",
        "1 gap(s) in time: 0.8 s before frame 4 (005.png); usual is 0.1 s",
    )
    np.testing.assert_array_equal(log.images[2].image, picture(3))
    # The gap widens what may have happened, and invents nothing.
    np.testing.assert_allclose(log.Q[4], 64 * log.Q[1], rtol=1e-9)
    np.testing.assert_array_equal(log.T_prev_body, np.tile(np.eye(4), (7, 1, 1)))


def test_stamps_that_go_back_are_put_in_order(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=4)
    (folder / "times.txt").write_text("0.0\n0.2\n0.1\n0.3\n")
    log = log_of(folder, times="times.txt", rate_hz=None)
    np.testing.assert_allclose(log.t, [0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(log.images[1].image, picture(2))
    assert log.warnings == ("time stamps go back at 002.png; frames are taken in order of time",)


def test_start_steps_and_every(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=12)
    log = log_of(folder, start=2, steps=3, every=4)
    np.testing.assert_allclose(log.t, [0.0, 0.4, 0.8])
    for frame, k in zip(log.images, (2, 6, 10), strict=True):
        np.testing.assert_array_equal(frame.image, picture(k))
    with pytest.raises(DataError, match="1 of 12 frames are usable where at least 2 are needed"):
        log_of(folder, start=11)


def _tum_lines(t: np.ndarray, poses: np.ndarray) -> str:
    rows = np.column_stack([t, poses[:, :3, 3], quaternion(poses[:, :3, :3])])
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def test_truth_and_recorded_odometry_are_the_bodys(tmp_path: Path) -> None:
    """Constant twists, so that the pose between two recorded ones has a closed form along the axis."""
    folder = write_folder(tmp_path, count=6)
    t = np.arange(0.0, 0.45, 0.05)
    twist = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.3])
    poses = exp(t[:, None] * twist)
    drifting = exp(t[:, None] * (1.1 * twist))
    (folder / "truth.txt").write_text(_tum_lines(t, poses))
    (folder / "odometry.txt").write_text(_tum_lines(t, drifting))
    parameters = {"rate_hz": 12.5, "truth": "truth.txt", "recorded_odometry": "odometry.txt"}
    log = log_of(folder, odometry="recorded", **parameters)
    # 0, 0.08, …, 0.40 s: the last one is on the last pose.
    np.testing.assert_allclose(log.truth.T_world_body, exp(log.t[:, None] * twist), atol=1e-12)
    np.testing.assert_allclose(log.T_prev_body[1:], np.tile(exp(0.08 * 1.1 * twist), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(log.problem.T_world_body, poses[0], atol=1e-12)
    later = log_of(folder, odometry="recorded", **{**parameters, "rate_hz": 10.0})
    assert len(later.t) == 5
    assert later.warnings == ("left out 1 frame(s) without ground truth: 005.png",)


def test_the_first_pose_is_as_uncertain_as_the_truth_that_tells_it(tmp_path: Path) -> None:
    """Tracked poses err by a centimetre: fixed to the first, every good estimate would look too sure."""
    folder = write_folder(tmp_path)
    np.testing.assert_allclose(log_of(folder).problem.P, 1e-12 * np.eye(6))
    poses = np.tile(np.eye(4), (6, 1, 1))
    (folder / "truth.txt").write_text(_tum_lines(np.arange(6) / 10.0, poses), encoding="utf-8")
    known = log_of(folder, truth="truth.txt", odometry="corrupted_truth")
    np.testing.assert_allclose(known.problem.P, 1e-4 * np.eye(6))
    given = log_of(folder, truth="truth.txt", odometry="corrupted_truth", prior_sigma=0.003)
    np.testing.assert_allclose(given.problem.P, 9e-6 * np.eye(6))
    kinect, car, flight = (
        sources.get(name).target.__module__ for name in ("tum_rgbd", "kitti_odometry", "euroc")
    )
    stated = [import_module(name).TRUTH_SIGMA for name in (kinect, car, flight)]
    assert stated == [0.01, 0.002, 0.002]


def test_a_stereo_pair_with_distortion_becomes_one_rectified_camera(tmp_path: Path) -> None:
    size = [320, 240]
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for k in range(2):
            image = np.random.default_rng(k).integers(0, 256, size[::-1], dtype=np.uint8)
            cv2.imwrite(str(tmp_path / side / f"{k}.png"), image)
    mounting = exp(np.array([0.1, -0.2, 0.3, 0.4, 0.5, 0.6])) @ FORWARD_CAMERA
    write_calibration(
        tmp_path,
        {
            "camera": "stereo",
            "image_size": size,
            "intrinsics": _intrinsics(LEFT.K),
            "distortion": LEFT.distortion.tolist(),
            "T_body_camera": mounting.tolist(),
            "right": {
                "intrinsics": _intrinsics(RIGHT.K),
                "distortion": RIGHT.distortion.tolist(),
                "T_left_right": T_LEFT_RIGHT.tolist(),
            },
        },
    )
    log = log_of(tmp_path)
    sensor = log.problem.sensor
    assert sensor.baseline_m == pytest.approx(np.linalg.norm(T_LEFT_RIGHT[:3, 3]))
    # The rectified camera stays in its place, and its x axis leads to the right camera.
    np.testing.assert_allclose(sensor.T_body_camera[:3, 3], mounting[:3, 3], atol=1e-12)
    right_in_camera = inverse(sensor.T_body_camera) @ mounting @ T_LEFT_RIGHT
    np.testing.assert_allclose(right_in_camera[:3, 3], [sensor.baseline_m, 0, 0], atol=1e-9)
    assert log.images[0].image.shape == log.images[0].right.shape == (240, 320)
    (tmp_path / "right" / "1.png").unlink()
    assert log.images[1].problem == "right image: the file is missing"
    assert log.images[1].image is None


def _intrinsics(K: np.ndarray) -> list[float]:
    return [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])]


def test_the_calibration_of_the_documentation_is_read(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "recorded-images.md"
    experiment, calibration = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "calibration.yaml").write_text(calibration, encoding="utf-8")
    (tmp_path / "experiment.yaml").write_text(experiment, encoding="utf-8")
    read = read_calibration(tmp_path / "calibration.yaml")
    assert isinstance(read.camera, StereoCamera)
    assert read.camera.baseline_m == pytest.approx(0.11)
    np.testing.assert_allclose(read.camera.T_body_camera, FORWARD_CAMERA, atol=1e-9)
    assert load_experiment(tmp_path / "experiment.yaml").source.parameters["steps"] == 200


def test_depth_in_its_own_units(tmp_path: Path) -> None:
    changes = {"camera": "rgbd", "depth_units_per_m": 2000, "depth_unknown": 65535}
    folder = write_folder(tmp_path, count=4, **changes)
    (folder / "depth").mkdir()
    depth = np.full((HEIGHT, WIDTH), 3000, np.uint16)
    depth[:, :10], depth[:, 10:20] = 0, 65535
    for k, image in enumerate((depth, np.zeros_like(depth), picture(0))):
        cv2.imwrite(str(folder / "depth" / f"{k:03d}.png"), image)
    frames = log_of(folder).images
    expected = np.full((HEIGHT, WIDTH), 1.5)
    expected[:, :20] = 0.0
    np.testing.assert_allclose(frames[0].depth_m, expected)
    assert [frame.problem for frame in frames[1:]] == [
        "depth image: no pixel has a depth",
        "depth image: 1 channel(s) of 8 bits where a depth image has one of 16",
        "depth image: the file is missing",
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_size": [160, 120], "intrinsics": [140, 142, 80, 60]}, "is for images of 160×120.*has 80×60"),
        (
            {"intrinsics": [140.0, 142.0, 81.0, 58.0]},
            "do not fit images of 80×60 pixels; was the calibration",
        ),
        ({"intrinsics": [0.7, 0.7, 40.0, 30.0]}, "do not fit images of 80×60"),
        ({"intrinsics": [70.0, 71.0, 40.5]}, "intrinsics has 3 values; 4 finite numbers are needed"),
        ({"intrinsics": "wide"}, "intrinsics is 'wide'; a list of 4 numbers is needed"),
        ({"intrinsics": [-70.0, 71.0, 40.5, 29.0]}, "intrinsics is -70.0; a positive number is needed"),
        ({"camera": "fisheye"}, "camera is 'fisheye'; mono, stereo or rgbd is needed"),
        ({"camera": "stereo"}, "give baseline_m for a pair that is rectified"),
        ({"camera": "stereo", "baseline_m": -0.1}, "baseline_m is -0.1; a positive number"),
        ({"camera": "rgbd"}, "has no depth_units_per_m"),
        ({"distorsion": [0, 0, 0, 0]}, "unknown key distorsion; did you mean 'distortion'"),
        ({"T_body_camera": [[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "not a rotation"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused_at_once(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    folder = write_folder(tmp_path, **changes)
    with pytest.raises(DataError, match=rf"calibration\.yaml: .*{message}"):
        log_of(folder)


def test_one_odd_image_is_no_wrong_calibration(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    cv2.imwrite(str(folder / "left" / "000.png"), picture(0)[:, :-2])
    assert [bool(frame.problem) for frame in log_of(folder).images] == [True] + [False] * 5


def test_what_is_missing_and_what_would_be_right(tmp_path: Path) -> None:
    with pytest.raises(
        MissingDataError, match=r"nowhere: there is no such folder.*calibration file is needed"
    ):
        log_of(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MissingDataError, match=r"calibration\.yaml: there is no such file; it holds the cam"):
        log_of(tmp_path / "empty")
    folder = write_folder(tmp_path / "full")
    with pytest.raises(MissingDataError, match="photos: there is no such folder of images"):
        log_of(folder, images="photos")
    with pytest.raises(MissingDataError, match=r"holds no images \(\.bmp"):
        log_of(folder, images="../empty")
    with pytest.raises(
        MissingDataError, match=r"times\.txt: there is no such file; it holds the time stamps"
    ):
        log_of(folder, times="times.txt", rate_hz=None)
    (folder / "times.txt").write_text("0\n1\n")
    with pytest.raises(DataError, match=r"times\.txt: 2 time stamps for 6 images in"):
        log_of(folder, times="times.txt", rate_hz=None)
    with pytest.raises(UsageError, match=r"give times .* or rate_hz"):
        log_of(folder, rate_hz=None)
    with pytest.raises(UsageError, match="corrupted_truth needs ground truth"):
        log_of(folder, odometry="corrupted_truth")
    for image in (folder / "left").iterdir():
        image.write_bytes(b"")
    with pytest.raises(DataError, match=r"000\.png: none of 6 images can be read; of this one: not an image"):
        log_of(folder)
    (folder / "calibration.yaml").write_text("camera: [mono\n")
    with pytest.raises(DataError, match=r"calibration\.yaml: not valid YAML"):
        log_of(folder)


def test_names_come_in_natural_order_and_hidden_files_do_not_count(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=0)
    for k in range(12):
        assert cv2.imwrite(str(folder / "left" / f"img{k}.png"), picture(k))
    # What macOS leaves beside a file on a foreign disk.
    (folder / "left" / "._img0.png").write_bytes(b"\0\5\x16\7")
    log = log_of(folder)
    for k, frame in enumerate(log.images):
        np.testing.assert_array_equal(frame.image, picture(k))
    assert len(log.images) == 12


def test_other_scripts_digits_are_no_numbers(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=0)
    for k, name in enumerate(("a2.png", "a10.png", "a²5.png", "²3.png", "٣.png")):
        assert cv2.imwrite(str(folder / "left" / name), picture(k))
    assert len(log_of(folder).images) == 5


def test_two_formats_of_one_image_are_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    assert cv2.imwrite(str(folder / "left" / "003.jpg"), picture(3))
    with pytest.raises(DataError, match=r"003\.jpg and 003\.png are two formats of one image"):
        log_of(folder)


def test_names_with_blanks_stand_in_a_list_of_stamps(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=0)
    names = [f"my image {k}.png" for k in range(3)]
    for k, name in enumerate(names):
        assert cv2.imwrite(str(folder / "left" / name), picture(k))
    (folder / "times.txt").write_text("".join(f"{0.1 * k} {name}\n" for k, name in enumerate(names)))
    log = log_of(folder, times="times.txt", rate_hz=None)
    np.testing.assert_array_equal(log.images[2].image, picture(2))


def test_stamps_in_another_unit_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    (folder / "times.txt").write_text(
        "".join(f"{1_400_000_000_000_000_000 + k * 100_000_000}\n" for k in range(6))
    )
    (told,) = log_of(folder, times="times.txt", rate_hz=None).warnings
    assert "the usual step from image to image is 1e+08 s" in told
    assert "time_unit_s is 1e-9 for nanoseconds" in told
    assert log_of(folder, times="times.txt", rate_hz=None, time_unit_s=1e-9).warnings == ()


def test_a_transposed_mounting_and_a_baseline_in_millimetres_are_refused(tmp_path: Path) -> None:
    mounting = FORWARD_CAMERA.copy()
    mounting[:3, 3] = 0.1, 0.0, 0.4
    folder = write_folder(tmp_path, T_body_camera=mounting.T.tolist())
    with pytest.raises(DataError, match=r"last row of T_body_camera is .* is the matrix transposed\?"):
        log_of(folder)
    with pytest.raises(DataError, match="is the matrix transposed"):
        StereoCamera(fx_px=70, fy_px=70, cx_px=40, cy_px=30, baseline_m=0.1, T_body_camera=mounting.T)
    write_calibration(folder, {**MONO, "camera": "stereo", "baseline_m": 120})
    with pytest.raises(DataError, match="120 m apart; are these millimetres"):
        log_of(folder)


def test_a_picture_that_exif_turns_is_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, count=0)
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    body = b"Exif\0\0" + tiff
    for k in range(2):
        data = cv2.imencode(".jpg", picture(k))[1].tobytes()
        turned = data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2) + body + data[2:]
        (folder / "left" / f"{k}.jpg").write_bytes(turned)
    (told,) = log_of(folder).warnings
    assert "EXIF says that 0.jpg is to be turned for the eye; pixels are taken as they are stored" in told


def test_a_folder_is_also_looked_for_among_the_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(tmp_path / "data" / "own")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMCMP_DATA", str(tmp_path / "data"))
    assert log_of(Path("own")).name == "own"
    monkeypatch.delenv("SLAMCMP_DATA")
    with pytest.raises(MissingDataError, match="SLAMCMP_DATA names no folder"):
        log_of(Path("own"))


def test_the_key_of_a_result_covers_the_files_that_are_read(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    plugin = sources.get("image_folder")
    assert plugin.traits["seeded"] is True
    assert plugin.traits["paths"] == ("folder",)
    files = plugin.traits["files"](folder=str(folder), images="left", rate_hz=1.0, start=1, steps=3)
    assert [path.name for path in files] == ["calibration.yaml", "001.png", "002.png", "003.png"]
    (folder / "left" / "002.png").unlink()
    (folder / "left" / "left.txt").write_text("not an image, not read")
    files = plugin.traits["files"](folder=str(folder), images="left", rate_hz=1.0)
    assert len(files) == 6
    with pytest.raises(UsageError, match="source 'image_folder' has no parameter 'fps'"):
        log_of(folder, fps=3)
