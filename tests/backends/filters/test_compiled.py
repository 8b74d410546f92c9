"""The compiled EKF gives the numbers of the plain one, frame by frame and over whole streams."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters import compiled
from slamcmp.backends.filters.ekf_compiled import CompiledEkf
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.errors import DivergedError, UsageError
from slamcmp.models.camera import StereoCamera
from slamcmp.types import Frame, MeasurementStream, Problem
from tests.backends.graph_streams import spatial_stream
from tests.toy_stream import toy_stream


@pytest.fixture
def numba() -> Any:
    return pytest.importorskip("numba", reason="needs numba: pip install 'slamcmp[fast]'")


def without_pattern(stream: MeasurementStream) -> MeasurementStream:
    """Some frames see nothing, the robot slides sideways, and all covariances are full and differ."""
    rng = np.random.default_rng(11)
    frames = []
    for frame in stream.frames:
        seen = frame.ids.size if frame.k % 5 else 0
        slide = geometry.se2(0.0, rng.normal(scale=0.01), 0.0) if frame.k else np.eye(3)
        mix = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
        A = 0.3 * rng.normal(size=(seen, 2, 2)) * np.sqrt(frame.R[:seen])
        frames.append(
            Frame(
                frame.k,
                frame.t,
                frame.T_prev_body @ slide,
                mix @ frame.Q @ mix.T,
                frame.ids[:seen],
                frame.z[:seen],
                frame.R[:seen] + A @ np.swapaxes(A, 1, 2),
            )
        )
    return MeasurementStream(stream.problem, tuple(frames))


@pytest.mark.parametrize("error_state", ["world", "body"])
@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_equals_the_plain_filter(numba: Any, sensor_name: str, new_landmarks: Any, error_state: Any) -> None:
    made, _, _ = toy_stream(frames=1000, landmarks=40, sensor_name=sensor_name, seen_at_once=4, seed=6)
    stream = without_pattern(made)
    plain = EkfSlam(stream.problem, new_landmarks=new_landmarks, error_state=error_state)
    compiled_ekf = CompiledEkf(stream.problem, new_landmarks=new_landmarks, error_state=error_state)
    for frame in stream.frames:
        plain.update(frame)
        compiled_ekf.update(frame)
        expected, found = plain.estimate(), compiled_ekf.estimate()
        np.testing.assert_allclose(found.T_world_body, expected.T_world_body, atol=1e-9)
        np.testing.assert_allclose(found.P, expected.P, rtol=1e-9, atol=1e-12)
        assert compiled_ekf.diagnostics() == pytest.approx(plain.diagnostics(), rel=1e-9, nan_ok=True)
    assert_same_map(compiled_ekf, plain)
    P = compiled_ekf.joint_covariance()
    np.testing.assert_array_equal(P, P.T)


def assert_same_map(one: CompiledEkf, other: EkfSlam) -> None:
    here, there = one.landmarks(), other.landmarks()
    np.testing.assert_array_equal(here.ids, there.ids)
    np.testing.assert_allclose(here.positions, there.positions, atol=1e-9)
    np.testing.assert_allclose(here.covariances, there.covariances, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.joint_covariance(), other.joint_covariance(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
def test_a_whole_stream_at_once_is_the_same_to_the_bit(numba: Any, sensor_name: str) -> None:
    made, _, _ = toy_stream(frames=200, landmarks=30, sensor_name=sensor_name, seen_at_once=4, seed=7)
    stream = without_pattern(made)
    stepped, whole = CompiledEkf(stream.problem), CompiledEkf(stream.problem)
    online = whole.run(stream.frames[:120])
    # A run may also go on from what is known.
    rest = whole.run(stream.frames[120:])
    assert online.P is not None
    assert rest.P is not None
    poses, P = np.concatenate([online.T_world_body, rest.T_world_body]), np.concatenate([online.P, rest.P])
    for frame in stream.frames:
        stepped.update(frame)
        np.testing.assert_array_equal(poses[frame.k], stepped.estimate().T_world_body)
        np.testing.assert_array_equal(P[frame.k], stepped.estimate().P)
    np.testing.assert_array_equal(rest.t, [frame.t for frame in stream.frames[120:]])
    np.testing.assert_array_equal(whole.joint_covariance(), stepped.joint_covariance())
    assert whole.diagnostics() == pytest.approx(stepped.diagnostics(), nan_ok=True)


def test_an_exactly_known_start_and_a_first_frame_that_sees(numba: Any) -> None:
    """P0 = 0 and a bearing on either side of ±180°, where the innovation must be wrapped."""
    stream, _, _ = toy_stream(frames=60, prior_sigma=0.0, noise=3.0, seed=1)
    bearings = np.concatenate([frame.z[:, 1] for frame in stream.frames])
    assert bearings.min() < -3.0
    assert bearings.max() > 3.0
    plain, whole = EkfSlam(stream.problem), CompiledEkf(stream.problem)
    for frame in stream.frames:
        plain.update(frame)
    whole.run(stream.frames)
    assert_same_map(whole, plain)


def test_says_where_it_diverged(numba: Any) -> None:
    stream, _, _ = toy_stream(frames=30)
    bad = stream.frames[20]
    spoilt = Frame(bad.k, bad.t, bad.T_prev_body, bad.Q, bad.ids, np.nan * bad.z, bad.R)
    frames = (*stream.frames[:20], spoilt, *stream.frames[21:])
    ekf = CompiledEkf(stream.problem)
    for frame in stream.frames[:20]:
        ekf.update(frame)
    with pytest.raises(DivergedError, match="frame 20: the innovation covariance"):
        ekf.update(spoilt)
    with pytest.raises(DivergedError, match="frame 20: the innovation covariance"):
        CompiledEkf(stream.problem).run(frames)
    negative = Frame(bad.k, bad.t, bad.T_prev_body, bad.Q, bad.ids, bad.z, -100.0 * bad.R)
    ekf = CompiledEkf(stream.problem)
    ekf.run(stream.frames[:20])
    with pytest.raises(DivergedError, match="frame 20"):
        ekf.update(negative)


def test_names_the_sensors_it_takes() -> None:
    stream, _, _ = spatial_stream(frames=2)
    with pytest.raises(UsageError, match=r"relative_position' in 3 dimensions; .* ekf_slam takes all others"):
        CompiledEkf(stream.problem)
    camera = StereoCamera(fx_px=400.0, fy_px=400.0, cx_px=320.0, cy_px=240.0, baseline_m=0.2)
    with pytest.raises(UsageError, match="stereo_camera"):
        CompiledEkf(Problem(np.eye(4), np.eye(6), camera))


def test_without_numba_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    stream, _, _ = toy_stream(frames=2)
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "slamcmp.backends.filters.compiled.ekf_kernel", raising=False)
    monkeypatch.delattr(compiled, "ekf_kernel", raising=False)
    with pytest.raises(UsageError, match=r"needs numba .*pip install 'slamcmp\[fast\]', or use ekf_slam"):
        CompiledEkf(stream.problem)


def test_compiles_where_nothing_can_be_cached(numba: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package folder and a home that are both read-only leave numba no place: it refuses to cache."""
    from numba.core.caching import FunctionCache

    from slamcmp.backends.filters.compiled.ekf_kernel import compiled

    monkeypatch.setattr(FunctionCache._impl_class, "_locator_classes", [])
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(lambda x: x + 1)
    assert compiled()(lambda x: x + 1)(41) == 42
