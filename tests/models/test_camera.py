"""Camera models against hand-computed pixels, central differences and gtsam's factors."""

from __future__ import annotations

import json

import gtsam
import numpy as np
import pytest

from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import exp, inverse, retract
from slamcmp.models.camera import FORWARD_CAMERA, MonoCamera, RgbdCamera, StereoCamera
from slamcmp.models.sensors import make_sensor

INTRINSICS = {"fx_px": 410.0, "fy_px": 395.0, "cx_px": 320.5, "cy_px": 236.0}
MOUNTING = exp(np.array([0.1, -0.05, 0.2, 0.3, -0.1, 0.4])) @ FORWARD_CAMERA
POSE = exp(np.array([0.2, -0.1, 0.7, 1.0, 2.0, -0.5]))
# In front of the camera by construction.
LANDMARKS = np.array(
    [
        (POSE @ MOUNTING @ np.array([*point, 1.0]))[:3]
        for point in [(0.3, -0.2, 2.0), (-1.0, 0.5, 6.0), (0.0, 0.0, 1.0)]
    ]
)
CAMERAS = [
    MonoCamera(**INTRINSICS, T_body_camera=MOUNTING),
    StereoCamera(**INTRINSICS, T_body_camera=MOUNTING, baseline_m=0.12),
    RgbdCamera(**INTRINSICS, T_body_camera=MOUNTING),
]
each_camera = pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)


def test_a_forward_camera_sees_left_points_on_the_left_and_high_points_at_the_top() -> None:
    camera = StereoCamera(fx_px=100.0, fy_px=200.0, cx_px=320.0, cy_px=240.0, baseline_m=0.5)
    # 4 m ahead, 1 m to the left, 0.5 m up: u = 320 - 100/4, v = 240 - 200·0.5/4, disparity = 100·0.5/4.
    z = camera.predict(np.eye(4), np.array([4.0, 1.0, 0.5]))
    np.testing.assert_allclose(z, [295.0, 282.5, 215.0], rtol=1e-14)
    depth = RgbdCamera(fx_px=100.0, fy_px=200.0, cx_px=320.0, cy_px=240.0)
    np.testing.assert_allclose(depth.predict(np.eye(4), np.array([4.0, 1.0, 0.5])), [295.0, 215.0, 4.0])


@each_camera
def test_jacobians_equal_central_differences(camera: MonoCamera) -> None:
    H_pose, H_landmark = camera.jacobians(POSE, LANDMARKS)
    step = 1e-6
    for i in range(6):
        xi = np.zeros(6)
        xi[i] = step
        ahead = camera.predict(retract(POSE, xi), LANDMARKS)
        behind = camera.predict(retract(POSE, -xi), LANDMARKS)
        np.testing.assert_allclose(H_pose[..., i], (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-5)
    for i in range(3):
        delta = np.zeros(3)
        delta[i] = step
        difference = camera.predict(POSE, LANDMARKS + delta) - camera.predict(POSE, LANDMARKS - delta)
        np.testing.assert_allclose(H_landmark[..., i], difference / (2 * step), rtol=1e-6, atol=1e-5)


@each_camera
def test_one_landmark_is_a_row_of_the_batch(camera: MonoCamera) -> None:
    batch = camera.predict(POSE, LANDMARKS)
    batch_jacobians = camera.jacobians(POSE, LANDMARKS)
    for i, landmark in enumerate(LANDMARKS):
        np.testing.assert_allclose(camera.predict(POSE, landmark), batch[i], rtol=1e-13)
        for whole, single in zip(batch_jacobians, camera.jacobians(POSE, landmark), strict=True):
            np.testing.assert_allclose(single, whole[i], rtol=1e-12, atol=1e-12)


def _gtsam_jacobians(factor: gtsam.NonlinearFactor, landmark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(POSE))
    values.insert(1, landmark)
    A, b = factor.linearize(values).jacobian()
    assert np.abs(b).max() < 1e-9
    return A[:, :6], A[:, 6:]


def test_mono_agrees_with_gtsams_projection_factor() -> None:
    camera = CAMERAS[0]
    calibration = gtsam.Cal3_S2(410.0, 395.0, 0.0, 320.5, 236.0)
    for landmark in LANDMARKS:
        z = camera.predict(POSE, landmark)
        factor = gtsam.GenericProjectionFactorCal3_S2(
            z, gtsam.noiseModel.Unit.Create(2), 0, 1, calibration, gtsam.Pose3(MOUNTING)
        )
        for mine, theirs in zip(
            camera.jacobians(POSE, landmark), _gtsam_jacobians(factor, landmark), strict=True
        ):
            np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-9)


def test_stereo_agrees_with_gtsams_stereo_factor() -> None:
    camera = CAMERAS[1]
    calibration = gtsam.Cal3_S2Stereo(410.0, 395.0, 0.0, 320.5, 236.0, 0.12)
    for landmark in LANDMARKS:
        z = camera.predict(POSE, landmark)
        factor = gtsam.GenericStereoFactor3D(
            gtsam.StereoPoint2(*z), gtsam.noiseModel.Unit.Create(3), 0, 1, calibration, gtsam.Pose3(MOUNTING)
        )
        for mine, theirs in zip(
            camera.jacobians(POSE, landmark), _gtsam_jacobians(factor, landmark), strict=True
        ):
            np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS[1:], ids=lambda camera: camera.name)
def test_invert_undoes_predict(camera: StereoCamera | RgbdCamera) -> None:
    np.testing.assert_allclose(camera.invert(POSE, camera.predict(POSE, LANDMARKS)), LANDMARKS, atol=1e-12)


def test_mono_needs_a_depth() -> None:
    camera = CAMERAS[0]
    z = camera.predict(POSE, LANDMARKS)
    with pytest.raises(UsageError, match="depth"):
        camera.invert(POSE, z)
    depth = camera.camera_point(POSE, LANDMARKS)[:, 2]
    np.testing.assert_allclose(depth, [2.0, 6.0, 1.0], rtol=1e-13)
    np.testing.assert_allclose(camera.point_at_depth(POSE, z, depth), LANDMARKS, atol=1e-12)


@each_camera
def test_what_lies_behind_the_camera_has_no_image(camera: MonoCamera) -> None:
    T_world_camera = POSE @ MOUNTING
    behind = (T_world_camera @ np.array([0.1, 0.1, -2.0, 1.0]))[:3]
    assert np.isnan(camera.predict(POSE, behind)).all()
    both = camera.predict(POSE, np.stack([behind, LANDMARKS[0]]))
    assert np.isnan(both[0]).all()
    assert np.isfinite(both[1]).all()


@each_camera
def test_parameters_rebuild_the_same_camera_through_json(camera: MonoCamera) -> None:
    stored = json.loads(json.dumps(camera.parameters()))
    again = make_sensor(camera.name, stored)
    np.testing.assert_array_equal(again.predict(POSE, LANDMARKS), camera.predict(POSE, LANDMARKS))


def test_wrong_calibrations_are_refused() -> None:
    with pytest.raises(DataError, match="rigid"):
        MonoCamera(**INTRINSICS, T_body_camera=np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(DataError, match="rigid"):
        MonoCamera(**INTRINSICS, T_body_camera=np.eye(3))
    with pytest.raises(DataError, match="focal"):
        MonoCamera(**{**INTRINSICS, "fx_px": -1.0})
    with pytest.raises(DataError, match="baseline"):
        StereoCamera(**INTRINSICS, baseline_m=0.0)


def test_the_forward_mounting_is_rigid() -> None:
    np.testing.assert_array_equal(FORWARD_CAMERA @ inverse(FORWARD_CAMERA), np.eye(4))
