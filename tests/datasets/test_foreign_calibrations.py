"""Calibrations of other programs, fisheyes against their formula, and lenses that fold the image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slamcmp.datasets.images.calibration_file import Calibration, read_calibration
from slamcmp.datasets.images.kitti_odometry import _camera
from slamcmp.datasets.images.rectification import Lens, rectify, require_no_fold, undistort
from slamcmp.errors import DataError
from slamcmp.geometry import exp, inverse

SIZE = (752, 480)
NUMBERS = (458.654, 457.296, 367.215, 248.375)
BROWN = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
FISHEYE = [0.0034823894, 0.0007150348, -0.0020532361, 0.00020293673]
"""Of TUM-VI's cameras, near enough."""
K = np.array([[458.654, 0.0, 367.215], [0.0, 457.296, 248.375], [0.0, 0.0, 1.0]])
OWN = f"""camera: mono
image_size: [752, 480]
intrinsics: {list(NUMBERS)}
distortion: {BROWN}
"""
ROS = f"""image_width: 752
image_height: 480
camera_name: cam
camera_matrix: {{rows: 3, cols: 3, data: {K.ravel().tolist()}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {[*BROWN, 0.0]}}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""
KALIBR = f"""cam0:
  camera_model: pinhole
  distortion_coeffs: {BROWN}
  distortion_model: radtan
  intrinsics: {list(NUMBERS)}
  resolution: [752, 480]
  rostopic: /cam0/image_raw
"""


def test_four_programs_say_the_same_as_our_own_file(tmp_path: Path) -> None:
    store = cv2.FileStorage(str(tmp_path / "opencv.yaml"), cv2.FILE_STORAGE_WRITE)
    store.write("image_width", 752)
    store.write("image_height", 480)
    store.write("camera_matrix", K)
    store.write("distortion_coefficients", np.array([BROWN]))
    store.release()
    (tmp_path / "own.yaml").write_text(OWN)
    (tmp_path / "ros.yaml").write_text(ROS)
    (tmp_path / "kalibr.yaml").write_text(KALIBR)
    half = " ".join(map(repr, [*NUMBERS[:2], NUMBERS[2] + 0.5, NUMBERS[3] + 0.5, *BROWN]))
    (tmp_path / "cameras.txt").write_text(f"# Camera list\n1 OPENCV 752 480 {half}\n")
    own = read_calibration(tmp_path / "own.yaml")
    assert own.left is not None
    for name in ("opencv.yaml", "ros.yaml", "kalibr.yaml", "cameras.txt"):
        other = read_calibration(tmp_path / name)
        assert other.size == own.size
        assert other.left is not None
        np.testing.assert_allclose(other.camera.K, own.camera.K, atol=1e-9)
        np.testing.assert_allclose(other.left.x, own.left.x, atol=1e-4)


def test_a_pair_of_kalibr_is_a_pair(tmp_path: Path) -> None:
    """T_cn_cnm1 maps the left camera's points to the right one's."""
    T_left_right = exp(np.array([0.01, -0.02, 0.005, 0.11, 0.002, -0.001]))
    second = KALIBR.replace("cam0", "cam1") + f"  T_cn_cnm1: {inverse(T_left_right).tolist()}\n"
    (tmp_path / "kalibr.yaml").write_text(KALIBR + second)
    right = f"right:\n  intrinsics: {list(NUMBERS)}\n  distortion: {BROWN}\n"
    (tmp_path / "own.yaml").write_text(
        OWN.replace("mono", "stereo") + right + f"  T_left_right: {T_left_right.tolist()}\n"
    )
    own, other = (read_calibration(tmp_path / name) for name in ("own.yaml", "kalibr.yaml"))
    assert other.camera.baseline_m == pytest.approx(own.camera.baseline_m, abs=1e-9)
    np.testing.assert_allclose(other.right.y, own.right.y, atol=1e-3)


def distorted(lens: Lens, q: np.ndarray) -> np.ndarray:
    """Kannala and Brandt's model written out: pixels (m, 2) of points (m, 3)."""
    r = np.hypot(q[:, 0], q[:, 1])
    angle = np.arctan2(r, q[:, 2])
    k1, k2, k3, k4 = lens.distortion
    bent = angle * (1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8)
    scale = np.where(r > 0, bent / np.maximum(r, 1e-12), 1.0)
    return q[:, :2] * scale[:, None] * np.diag(lens.K)[:2] + lens.K[:2, 2]


def test_a_fisheye_is_straightened_by_its_formula() -> None:
    lens = Lens(np.array([[190.0, 0, 256], [0, 190, 250], [0, 0, 1.0]]), np.array(FISHEYE), equidistant=True)
    new_K, remap = undistort(lens, (512, 512))
    assert remap is not None
    v, u = np.mgrid[0:512:37, 0:512:37]
    rays = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ np.linalg.inv(new_K).T
    expected = distorted(lens, rays)
    np.testing.assert_allclose(remap.x[v, u].ravel(), expected[:, 0], atol=2e-3)
    np.testing.assert_allclose(remap.y[v, u].ravel(), expected[:, 1], atol=2e-3)


def test_a_pair_of_fisheyes_is_rectified() -> None:
    K_fish = np.array([[190.0, 0, 256], [0, 190, 250], [0, 0, 1.0]])
    left, right = (Lens(K_fish, np.array(FISHEYE), equidistant=True) for _ in range(2))
    T_right_left = inverse(exp(np.array([0.02, -0.03, 0.01, 0.1, 0.003, 0.002])))
    pair = rectify(left, right, T_right_left, (512, 512), source="pair")
    assert pair.baseline_m == pytest.approx(np.linalg.norm(T_right_left[:3, 3]), rel=1e-6)
    rng = np.random.default_rng(0)
    new = rng.uniform([-0.6, -0.6, 2.0], [0.6, 0.6, 6.0], (200, 3))
    pixel = new @ pair.K.T
    pixel = pixel[:, :2] / pixel[:, 2:]
    disparity = pair.K[0, 0] * pair.baseline_m / new[:, 2]
    old_left = new @ pair.R_left_new.T
    old_right = old_left @ T_right_left[:3, :3].T + T_right_left[:3, 3]
    for lens, look_up, old, at in (
        (left, pair.left, old_left, pixel),
        (right, pair.right, old_right, pixel - np.column_stack([disparity, np.zeros(200)])),
    ):
        inside = ((at > 2) & (at < 508)).all(axis=1)
        found = [
            cv2.remap(table, at[inside].astype(np.float32)[:, None], None, cv2.INTER_LINEAR).ravel()
            for table in (look_up.x, look_up.y)
        ]
        assert inside.sum() > 100
        np.testing.assert_allclose(np.array(found).T, distorted(lens, old[inside]), atol=0.05)


def test_our_own_file_takes_a_fisheye(tmp_path: Path) -> None:
    text = OWN.replace(str(BROWN), str(FISHEYE)) + "lens: equidistant\n"
    (tmp_path / "own.yaml").write_text(text)
    assert read_calibration(tmp_path / "own.yaml").left is not None
    (tmp_path / "own.yaml").write_text(text.replace("equidistant", "fisheye8"))
    with pytest.raises(DataError, match="lens is 'fisheye8'; radial-tangential or equidistant is needed"):
        read_calibration(tmp_path / "own.yaml")


def test_a_lens_that_folds_the_image_is_refused_with_the_radius(tmp_path: Path) -> None:
    """r (1 + k1 r²) turns at r² = -1 / (3 k1), where it has come to 2/3 of r."""
    k1 = -0.8
    folded = OWN.replace(str(BROWN), str([k1, 0.0, 0.0, 0.0]))
    (tmp_path / "own.yaml").write_text(folded)
    radius = np.sqrt(NUMBERS[0] * NUMBERS[1]) * 2 / 3 * np.sqrt(-1 / (3 * k1))
    with pytest.raises(DataError, match=rf"folds the image {radius:.0f} px from its centre") as caught:
        read_calibration(tmp_path / "own.yaml")
    assert "the coefficients are not this lens's" in str(caught.value)
    require_no_fold(Lens(K, np.array(BROWN)), SIZE, source="EuRoC")
    kinect = Lens(
        np.array([[517.3, 0, 318.6], [0, 516.5, 255.3], [0, 0, 1.0]]),
        np.array([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    )
    require_no_fold(kinect, (640, 480), source="TUM")


def test_kittis_baseline_is_between_both_columns(tmp_path: Path) -> None:
    row = "{}: 700 0 600 {} 0 700 180 0 0 0 1 0\n"
    (tmp_path / "calib.txt").write_text(row.format("P0", 42.0) + row.format("P1", -336.0))
    assert _camera(tmp_path / "calib.txt", stereo=True).baseline_m == pytest.approx(0.54)


def written(tmp_path: Path, text: str, name: str = "calibration.yaml") -> Calibration:
    (tmp_path / name).write_text(text)
    return read_calibration(tmp_path / name)


def remapped(read: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Where the straightened image's pixels come from, and its matrix."""
    assert read.left is not None
    return np.stack([read.left.x, read.left.y]), read.camera.K


RATIONAL = [0.9, 0.35, 0.0002, -0.0001, 0.02, 1.2, 0.6, 0.08]
"""k1, k2, p1, p2, k3, k4, k5, k6 of a wide lens."""


def test_the_rational_model_is_opencv_s_own(tmp_path: Path) -> None:
    """ROS's second lens model, OpenCV's eight coefficients and COLMAP's FULL_OPENCV are one."""
    numbers = str([*BROWN, 0.0])
    ros = ROS.replace("plumb_bob", "rational_polynomial").replace("cols: 5", "cols: 8")
    by_ros = remapped(written(tmp_path, ros.replace(numbers, str(RATIONAL))))
    own = remapped(written(tmp_path, OWN.replace(str(BROWN), str(RATIONAL))))
    half = " ".join(map(repr, [*NUMBERS[:2], NUMBERS[2] + 0.5, NUMBERS[3] + 0.5, *RATIONAL]))
    by_colmap = remapped(written(tmp_path, f"1 FULL_OPENCV 752 480 {half}\n", "cameras.txt"))
    for other in (own, by_colmap):
        np.testing.assert_allclose(other[0], by_ros[0], atol=1e-4)
    (x, y), new_K = by_ros
    v, u = np.mgrid[0:480:31, 0:752:31]
    rays = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ np.linalg.inv(new_K).T
    k1, k2, p1, p2, k3, k4, k5, k6 = RATIONAL
    a, b = rays[:, 0], rays[:, 1]
    r2 = a * a + b * b
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    bent_x = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    bent_y = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    np.testing.assert_allclose(x[v, u].ravel(), K[0, 0] * bent_x + K[0, 2], atol=5e-3)
    np.testing.assert_allclose(y[v, u].ravel(), K[1, 1] * bent_y + K[1, 2], atol=5e-3)


@pytest.mark.parametrize(("matrix", "distortion"), [("K", "D"), ("k", "d")])
def test_a_printed_camera_info_message_is_read(tmp_path: Path, matrix: str, distortion: str) -> None:
    """As rostopic and ros2 topic print it, with the line that would begin the next message."""
    message = (
        "header:\n  seq: 1\n  frame_id: 'cam'\nheight: 480\nwidth: 752\ndistortion_model: 'plumb_bob'\n"
        f"{distortion}: {[*BROWN, 0.0]}\n{matrix}: {K.ravel().tolist()}\nbinning_x: 0\n---\n"
    )
    np.testing.assert_allclose(
        remapped(written(tmp_path, message))[0], remapped(written(tmp_path, OWN))[0], atol=1e-4
    )
    # An image that is rectified already has no coefficients.
    plain = message.replace(str([*BROWN, 0.0]), "[]")
    assert written(tmp_path, plain).left is None


def test_a_kalibr_chain_with_an_imu_has_the_imu_for_its_body(tmp_path: Path) -> None:
    T_cam_imu = exp(np.array([0.3, -1.2, 0.7, 0.05, -0.02, 0.01]))
    read = written(tmp_path, KALIBR + f"  T_cam_imu: {T_cam_imu.tolist()}\n  timeshift_cam_imu: 0.0\n")
    np.testing.assert_allclose(read.camera.T_body_camera, inverse(T_cam_imu), atol=1e-9)


@pytest.mark.parametrize("key", ["T_cam_imu", "T_cn_cnm1"])
def test_a_transposed_matrix_of_kalibr_is_told(tmp_path: Path, key: str) -> None:
    T = exp(np.array([0.01, -0.02, 0.005, -0.11, 0.002, -0.001]))
    line = f"  {key}: {T.T.tolist()}\n"
    second = KALIBR.replace("cam0", "cam1") + (line if key == "T_cn_cnm1" else "")
    text = KALIBR + (line if key == "T_cam_imu" else second)
    with pytest.raises(DataError, match=rf"the last row of cam.\.{key} is .* is the matrix transposed\?"):
        written(tmp_path, text)


def test_a_chain_of_three_cameras_gives_its_first_pair(tmp_path: Path) -> None:
    """Of cameras of different sizes it does not."""
    T = exp(np.array([0.0, 0.01, 0.0, -0.11, 0.0, 0.0])).tolist()
    second, third = (KALIBR.replace("cam0", name) + f"  T_cn_cnm1: {T}\n" for name in ("cam1", "cam2"))
    assert written(tmp_path, KALIBR + second + third).camera.baseline_m == pytest.approx(0.11, rel=1e-3)
    with pytest.raises(DataError, match="one size is needed"):
        written(tmp_path, KALIBR + second.replace("[752, 480]", "[640, 480]"))


@pytest.mark.parametrize(
    ("line", "own"),
    [
        ("1 SIMPLE_PINHOLE 752 480 458 367.7 248.9", "intrinsics: [458, 458, 367.2, 248.4]"),
        ("1 PINHOLE 752 480 458 457 367.7 248.9", "intrinsics: [458, 457, 367.2, 248.4]"),
        (
            "1 SIMPLE_RADIAL 752 480 458 367.7 248.9 -0.1",
            "intrinsics: [458, 458, 367.2, 248.4]\ndistortion: [-0.1, 0, 0, 0]",
        ),
        (
            "1 RADIAL 752 480 458 367.7 248.9 -0.2 0.03",
            "intrinsics: [458, 458, 367.2, 248.4]\ndistortion: [-0.2, 0.03, 0, 0]",
        ),
        (
            "1 RADIAL_FISHEYE 752 480 458 367.7 248.9 0.01 0.002",
            "intrinsics: [458, 458, 367.2, 248.4]\nlens: equidistant\ndistortion: [0.01, 0.002, 0, 0]",
        ),
        (
            "1 OPENCV_FISHEYE 752 480 458 457 367.7 248.9 0.01 0.002 -0.001 0.0003",
            "intrinsics: [458, 457, 367.2, 248.4]\nlens: equidistant\n"
            "distortion: [0.01, 0.002, -0.001, 0.0003]",
        ),
    ],
)
def test_each_model_of_colmap_is_our_own_with_its_numbers(tmp_path: Path, line: str, own: str) -> None:
    ours = written(tmp_path, f"camera: mono\nimage_size: [752, 480]\n{own}\n")
    read = written(tmp_path, f"# Camera list\n# Number of cameras: 1\n{line}\n", "cameras.txt")
    np.testing.assert_allclose(read.camera.K, ours.camera.K, atol=1e-9)
    assert (read.left is None) == (ours.left is None)
    if read.left is not None and ours.left is not None:
        np.testing.assert_allclose(read.left.x, ours.left.x, atol=1e-3)


def test_which_of_several_cameras_is_not_guessed(tmp_path: Path) -> None:
    line = "{} PINHOLE 752 480 {} 457 367.7 248.9\n"
    assert written(tmp_path, line.format(1, 458) + line.format(2, 458), "cameras.txt").camera.fx_px == 458
    with pytest.raises(DataError, match="2 cameras that differ; keep the line of the one that took these"):
        written(tmp_path, line.format(1, 458) + line.format(2, 800), "cameras.txt")
    with pytest.raises(DataError, match="camera model 'FOV'"):
        written(tmp_path, "1 FOV 752 480 458 457 367 248 0.9\n", "cameras.txt")


def test_the_lenses_of_an_opencv_pair_alone_are_no_calibration(tmp_path: Path) -> None:
    store = cv2.FileStorage(str(tmp_path / "intrinsics.yml"), cv2.FILE_STORAGE_WRITE)
    for name in ("M1", "M2"):
        store.write(name, K)
    for name in ("D1", "D2"):
        store.write(name, np.array([BROWN]))
    store.release()
    with pytest.raises(DataError, match="but not how the cameras stand to each other"):
        read_calibration(tmp_path / "intrinsics.yml")


def test_opencv_s_fisheye_flag_counts(tmp_path: Path) -> None:
    text = ROS.replace("distortion_model: plumb_bob", "fisheye_model: 1").replace("cols: 5", "cols: 4")
    text = "%YAML:1.0\n---\n" + text.replace(str([*BROWN, 0.0]), str(FISHEYE))
    fisheye = OWN.replace(str(BROWN), str(FISHEYE)) + "lens: equidistant\n"
    np.testing.assert_allclose(
        remapped(written(tmp_path, text))[0], remapped(written(tmp_path, fisheye))[0], atol=1e-4
    )
