"""Small recordings in the layouts of the published sets, written here, with what may be wrong in them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp.datasets.images.euroc import euroc
from slamcmp.datasets.images.kitti_odometry import kitti_odometry
from slamcmp.datasets.images.seven_scenes import seven_scenes
from slamcmp.datasets.images.tum_rgbd import tum_rgbd
from slamcmp.errors import DataError, MissingDataError, UsageError


def _grey(path: Path, width: int = 640, height: int = 480, seed: int = 0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    assert cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 0])


def _depth(path: Path, value: int = 2000) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((480, 640), value, np.uint16))


def _rows(poses: np.ndarray) -> str:
    return "".join(" ".join(map(str, row)) + "\n" for row in poses.tolist())


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    """Sequence 07 in the published layout: five images 0.1 s apart, 1 m forward each."""
    folder = tmp_path / "sequences" / "07"
    for k in range(5):
        for side in ("image_0", "image_1"):
            _grey(folder / side / f"{k:06d}.png", 620, 188)
    P = "350 0 310 {} 0 350 94 0 0 0 1 0"
    (folder / "calib.txt").write_text(
        f"P0: {P.format(0)}\nP1: {P.format(-175)}\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n"
    )
    (folder / "times.txt").write_text("0.0e+00\n1.04e-01\n2.07e-01\n3.11e-01\n4.15e-01\n")
    (tmp_path / "poses").mkdir()
    poses = np.array([[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, k] for k in range(5)])
    (tmp_path / "poses" / "07.txt").write_text(_rows(poses))
    return folder


def test_kitti_in_its_published_layout(kitti: Path) -> None:
    log = kitti_odometry(0, folder=str(kitti), camera="stereo")
    np.testing.assert_allclose(log.t, [0, 0.104, 0.207, 0.311, 0.415])
    assert log.problem.sensor.baseline_m == pytest.approx(0.5)
    assert log.images[4].right.shape == (188, 620)
    np.testing.assert_allclose(log.truth.T_world_body[:, 0, 3], np.arange(5.0))
    assert log.warnings == ()
    (kitti / "image_0" / "000002.png").unlink()
    (kitti / "image_1" / "000003.png").write_bytes(b"\x89PNG cut off")
    frames = kitti_odometry(0, folder=str(kitti), camera="stereo").images
    assert [frame.problem for frame in frames] == [
        "",
        "",
        "the file is missing",
        "right image: the image file is truncated",
        "",
    ]


def test_what_is_wrong_with_a_kitti_sequence(kitti: Path) -> None:
    def message(error: type[Exception], **parameters: str) -> str:
        with pytest.raises(error) as caught:
            kitti_odometry(0, folder=str(kitti), **parameters)
        return str(caught.value)

    poses = kitti.parent.parent / "poses" / "07.txt"
    whole = poses.read_text()
    poses.write_text(whole[:60])
    assert "07.txt:" in message(DataError)
    poses.write_text("".join(whole.splitlines(keepends=True)[:3]))
    assert "3 rows, but there is an image 000004; row n belongs to image n" in message(DataError)
    poses.unlink()
    assert "corrupted_truth needs ground truth" in message(UsageError)
    assert kitti_odometry(0, folder=str(kitti), odometry="constant_position").truth is None
    assert "nothing.txt: there is no such file" in message(MissingDataError, poses="nothing.txt")
    (kitti / "times.txt").write_text("0.0\n0.1\nzero\n")
    assert "times.txt:3: 'zero' is not a finite number" in message(DataError)
    (kitti / "calib.txt").write_text("P0: 350 0 310 0 0 350 94 0 0 0 1\n")
    assert "calib.txt: has no projection matrix P0 of 12 numbers" in message(DataError)
    (kitti / "calib.txt").write_text("P0: 707 0 602 0 0 707 183 0 0 0 1 0\n")
    assert "do not fit images of 620×188 pixels" in message(DataError)
    assert "has no projection matrix P1" in message(DataError, camera="stereo")
    (kitti / "calib.txt").unlink()
    assert "calib.txt: there is no such file; it holds the projection matrices" in message(MissingDataError)
    with pytest.raises(MissingDataError, match=r"https://www\.cvlibs\.net/datasets/kitti"):
        kitti_odometry(0, folder=str(kitti.parent / "08"))


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    """Twelve colour images 0.1 s apart at height t; depth 4 ms later; no truth from 0.5 to 0.85 s."""
    folder = tmp_path / "rgbd_dataset_freiburg3_small"
    colour, depth = [], []
    for k in range(12):
        t = 10 + 0.1 * k
        _grey(folder / "rgb" / f"{t:.1f}.png")
        colour.append(f"{t:.6f} rgb/{t:.1f}.png\n")
        _depth(folder / "depth" / f"{t:.1f}.png", 10000)
        depth.append(f"{t + 0.004:.6f} depth/{t:.1f}.png\n")
    (folder / "rgb.txt").write_text("# color images\n" + "".join(colour))
    (folder / "depth.txt").write_text("".join(depth))
    stamps = [10 + 0.01 * n for n in range(-5, 120) if not 50 < n < 85]
    (folder / "groundtruth.txt").write_text("".join(f"{t} 0 0 {t} 0 0 0 1\n" for t in stamps))
    return folder


def test_tum_leaves_out_what_has_no_truth_or_no_depth(tum: Path) -> None:
    lines = (tum / "depth.txt").read_text().splitlines(keepends=True)
    (tum / "depth.txt").write_text("".join(lines[:2] + lines[3:]))
    log = tum_rgbd(0, folder=str(tum))
    np.testing.assert_allclose(log.t, [0, 0.1, 0.3, 0.4, 0.5, 0.9, 1.0, 1.1], atol=1e-6)
    np.testing.assert_allclose(log.truth.T_world_body[:, 2, 3], 10 + log.t, atol=1e-6)
    np.testing.assert_allclose(log.images[0].depth_m, 2.0)
    assert log.problem.sensor.fx_px == 535.4
    assert log.warnings == (
        "left out 1 colour image(s) without a depth image within 0.02 s (pair_within_s)",
        "left out 3 frame(s) without ground truth: 10.6.png, 10.7.png, 10.8.png",
        "1 gap(s) in time: 0.4 s before frame 5 (10.9.png); usual is 0.1 s",
    )


def test_what_is_wrong_with_a_tum_sequence(tum: Path) -> None:
    (tum / "depth" / "10.1.png").unlink()
    _grey(tum / "rgb" / "10.3.png", 320, 240)
    problems = [frame.problem for frame in tum_rgbd(0, folder=str(tum)).images][:4]
    assert problems == ["", "depth image: the file is missing", "", "320×240 pixels where 640×480 are needed"]
    (tum / "groundtruth.txt").write_text("9 0 0 0 0 0 0 1\n9.1 0 0 0 0 0 0 1\n")
    with pytest.raises(DataError, match=r"0 of 12 frames are usable .*12 frame.* without ground truth"):
        tum_rgbd(0, folder=str(tum))
    for path in (tum / "rgb").iterdir():
        _grey(path, 320, 240)
    with pytest.raises(DataError, match=r"calibration freiburg3: is for images of 640×480 pixels.*320×240"):
        tum_rgbd(0, folder=str(tum))
    (tum / "rgb.txt").write_text("10.0\n")
    with pytest.raises(DataError, match=r"rgb\.txt:1: 1 fields where at least 2 are needed"):
        tum_rgbd(0, folder=str(tum))
    (tum / "depth.txt").unlink()
    with pytest.raises(
        MissingDataError, match=r"depth\.txt: there is no such file; it holds the time stamps"
    ):
        tum_rgbd(0, folder=str(tum))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    for k in range(6):
        _grey(tmp_path / f"frame-{k:06d}.color.png")
        _depth(tmp_path / f"frame-{k:06d}.depth.png", 1500)
        pose = np.eye(4)
        pose[2, 3] = 0.1 * k
        # Skew as the set's own matrices are.
        pose[0, 1] = 4e-4
        np.savetxt(tmp_path / f"frame-{k:06d}.pose.txt", pose)
    return tmp_path


def test_two_formats_of_a_scene_s_images_are_refused(scene: Path) -> None:
    cv2.imwrite(str(scene / "frame-000003.color.jpg"), np.zeros((480, 640), np.uint8))
    with pytest.raises(
        DataError, match="holds colour images as jpg and as png; which ones count is not told"
    ):
        seven_scenes(0, folder=str(scene))


def test_seven_scenes_with_lost_frames(scene: Path) -> None:
    image = np.full((480, 640), 1500, np.uint16)
    image[:240] = 65535
    cv2.imwrite(str(scene / "frame-000001.depth.png"), image)
    (scene / "frame-000002.color.png").unlink()
    (scene / "frame-000003.pose.txt").write_text("-1.#IND -1.#IND -1.#IND -1.#IND\n" * 4)
    (scene / "frame-000004.pose.txt").unlink()
    log = seven_scenes(0, folder=str(scene))
    np.testing.assert_allclose(log.t, np.array([0, 1, 2, 5]) / 30)
    assert log.images[2].problem == "the file is missing"
    np.testing.assert_allclose(log.truth.T_world_body[:, 0, 3], [0, 0.1, 0.2, 0.5])
    R = log.truth.T_world_body[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)
    depth = log.images[1].depth_m
    assert not depth[:230].any()
    np.testing.assert_allclose(depth[250:400, 100:500], 1.5)
    assert "left out 2 frame(s) without ground truth: frame-000003.color.png, frame-000004" in log.warnings[1]
    (scene / "camera-intrinsics.txt").write_text("585 0 320\n0 585 240\n")
    with pytest.raises(DataError, match=r"camera-intrinsics\.txt: 2 rows where a 3×3 matrix is needed"):
        seven_scenes(0, folder=str(scene))
    (scene / "nothing").mkdir()
    with pytest.raises(MissingDataError, match=r"holds no images such as frame-000000\.color\.png"):
        seven_scenes(0, folder=str(scene / "nothing"))


SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
resolution: [640, 480]
camera_model: pinhole
intrinsics: [450.0, 450.0, 320.0, 240.0]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]
"""
NS = 1403715273262142976
STAMPS = [NS + 50_000_000 * k + 128 * (k % 2) for k in range(4)]


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    mav = tmp_path / "V9_99" / "mav0"
    for name, x in (("cam0", 0.0), ("cam1", 0.11)):
        for stamp in STAMPS:
            _grey(mav / name / "data" / f"{stamp}.png")
        (mav / name / "sensor.yaml").write_text(SENSOR.format(x=x))
        lines = "".join(f"{stamp},{stamp}.png\r\n" for stamp in STAMPS)
        (mav / name / "data.csv").write_text("#timestamp [ns],filename\r\n" + lines)
    truth = mav / "state_groundtruth_estimate0"
    truth.mkdir()
    # Half a turn about z: w, x, y, z.
    rows = [f"{NS + 10_000_000 * k},{k},0,0,0,0,0,1,0,0,0\n" for k in range(-2, 20)]
    (truth / "data.csv").write_text("#timestamp, p, q\n" + "".join(rows))
    return tmp_path / "V9_99"


def test_euroc_in_nanoseconds(flight: Path) -> None:
    log = euroc(0, folder=str(flight))
    np.testing.assert_allclose(log.t, [0, 0.050000128, 0.1, 0.150000128], rtol=0, atol=1e-12)
    np.testing.assert_allclose(log.truth.T_world_body[:, 0, 3], log.t / 0.01, atol=1e-6)
    np.testing.assert_allclose(log.truth.T_world_body[2, :3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    assert log.problem.sensor.baseline_m == pytest.approx(0.11)
    np.testing.assert_allclose(log.problem.sensor.T_body_camera, np.eye(4), atol=1e-9)


def test_what_is_wrong_with_a_flight(flight: Path) -> None:
    mav = flight / "mav0"
    lines = (mav / "cam1" / "data.csv").read_text().splitlines(keepends=True)
    (mav / "cam1" / "data.csv").write_text("".join(lines[:2] + lines[3:]))
    log = euroc(0, folder=str(flight))
    assert log.t.size == 3
    assert log.warnings == ("left out 1 left image(s) without a right one within 0.002 s (pair_within_s)",)
    sheet = mav / "cam1" / "sensor.yaml"
    for old, new, message in (
        (
            "radial-tangential",
            "fov",
            "distortion_model is 'fov'; radial-tangential or equidistant is needed",
        ),
        ("radial-tangential", "equidistant", "one lens is equidistant and the other is not"),
        (
            "camera_model: pinhole",
            "camera_model: omni",
            "camera_model is 'omni'; pinhole is needed",
        ),
        ("[640, 480]", "[752, 480]", r"cam0 has \(640, 480\) pixels and cam1 \(752, 480\)"),
        ("intrinsics", "intrinsic", "has no intrinsics"),
        ("0.07, ", "", "distortion_coefficients has 3 values; 4 or 5 finite numbers are needed"),
        ("T_BS:", "T_BS: [", "not valid YAML"),
        (
            "0.11, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]",
            "0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.11, 0.0, 0.0, 1.0]",
            r"the last row of T_BS.data is \[0.11, 0.0, 0.0, 1.0\] .* is the matrix transposed",
        ),
    ):
        sheet.write_text(SENSOR.format(x=0.11).replace(old, new))
        with pytest.raises(DataError, match=message):
            euroc(0, folder=str(flight))
    for name in ("cam0", "cam1"):
        (mav / name / "sensor.yaml").write_text(SENSOR.format(x=0.1).replace("[640, 480]", "[752, 480]"))
    with pytest.raises(DataError, match=r"sensor\.yaml: is for images of 752×480 pixels.*has 640×480"):
        euroc(0, folder=str(flight))
    sheet.unlink()
    with pytest.raises(
        MissingDataError, match=r"cam1/sensor\.yaml: there is no such file; it holds the camera's"
    ):
        euroc(0, folder=str(flight))
    with pytest.raises(MissingDataError, match=r"has no folder mav0; get the flight from http://robotics"):
        euroc(0, folder=str(flight.parent))
