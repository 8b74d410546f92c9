"""Compiled loops give the numbers of the filters they stand for, frame by frame and over whole streams."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends import far_points
from slamcmp.backends.filters import loops
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.errors import DataError, DivergedError, UsageError
from slamcmp.registry import back_ends
from slamcmp.types import Frame, GroundTruth, MeasurementStream, Problem
from tests.backends.graph_streams import spatial_stream
from tests.toy_stream import toy_stream


@pytest.fixture
def numba() -> Any:
    return pytest.importorskip("numba", reason="needs numba: pip install 'slamcmp[fast]'")


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Makes filters that do their frames themselves."""

    def make(name: str, *arguments: Any, **parameters: Any) -> Any:
        made = back_ends.get(name).target(*arguments, **parameters)
        made._loops = loops.Loops(made)
        return made

    return make


def without_pattern(stream: MeasurementStream) -> MeasurementStream:
    """Some frames see nothing, some stand, the robot slides sideways, and covariances are full and differ."""
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
                np.eye(3) if frame.k % 17 == 3 else frame.T_prev_body @ slide,
                mix @ frame.Q @ mix.T,
                frame.ids[:seen],
                frame.z[:seen],
                frame.R[:seen] + A @ np.swapaxes(A, 1, 2),
            )
        )
    return MeasurementStream(stream.problem, tuple(frames))


def problem_elsewhere(stream: MeasurementStream) -> Problem:
    """The stream's problem, started elsewhere with a full prior."""
    A = np.random.default_rng(2).normal(size=(3, 3)) * [0.3, 0.2, 0.05]
    return Problem(geometry.se2(40.0, -30.0, 0.8), A.T @ A, stream.problem.sensor)


VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("ekf_slam", {}),
    ("ekf_slam", {"error_state": "body"}),
    ("ekf_world", {}),
    ("ekf_right_invariant", {}),
    ("ekf_fej", {}),
    ("ekf_fej", {"new_landmark_jacobian": "updated"}),
    ("ekf_oc", {}),
    ("ekf_ideal", {}),
    ("iterated_ekf", {}),
    ("iterated_ekf", {"iterations": 2}),
    ("ukf_slam", {"alpha": 0.5}),
    ("ukf_slam", {"retraction": "right_invariant", "alpha": 0.5}),
    ("ukf_slam", {"retraction": "left_invariant", "alpha": 0.5, "kappa": 1.0}),
]


def ids_of(variant: tuple[str, dict[str, Any]]) -> str:
    return "-".join([variant[0], *map(str, variant[1].values())])


@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
@pytest.mark.parametrize("variant", VARIANTS, ids=ids_of)
def test_equals_the_plain_filter(
    numba: Any, plain: Any, variant: tuple[str, dict[str, Any]], sensor_name: str, new_landmarks: str
) -> None:
    name, parameters = variant
    if name == "iterated_ekf":
        if new_landmarks == "join_first":
            return
    else:
        parameters = {**parameters, "new_landmarks": new_landmarks}
    made, poses, world = toy_stream(frames=120, landmarks=25, sensor_name=sensor_name, seen_at_once=4, seed=6)
    stream = without_pattern(made)
    arguments: list[Any] = [problem_elsewhere(stream)]
    if name == "ekf_ideal":
        truth = GroundTruth(np.arange(len(poses), dtype=float), poses, np.arange(len(world)), world)
        arguments = [stream.problem, truth]
    here, there = back_ends.get(name).target(*arguments, **parameters), plain(name, *arguments, **parameters)
    for frame in stream.frames:
        there.update(frame)
        here.update(frame)
        assert here._loops.answer is not None
        expected, found = there.estimate(), here.estimate()
        np.testing.assert_allclose(found.T_world_body, expected.T_world_body, atol=1e-9)
        np.testing.assert_allclose(found.P, expected.P, rtol=1e-9, atol=1e-10)
        assert here.diagnostics() == pytest.approx(there.diagnostics(), rel=1e-7, nan_ok=True)
    assert_same_map(here, there)


def assert_same_map(here: Any, there: Any) -> None:
    one, other = here.landmarks(), there.landmarks()
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)
    np.testing.assert_allclose(one.covariances, other.covariances, rtol=1e-9, atol=1e-10)
    P = here.joint_covariance()
    np.testing.assert_allclose(P, there.joint_covariance(), rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(P, P.T)


def test_small_sigma_points_agree_as_far_as_their_differences_are_exact(numba: Any, plain: Any) -> None:
    """alpha = 1e-3 divides rounding of 12 m by the square of 3e-3: some 1e-9 m, in either arithmetic."""
    stream, _, _ = toy_stream(frames=120, landmarks=25, seen_at_once=4, seed=6)
    here, there = back_ends.get("ukf_slam").target(stream.problem), plain("ukf_slam", stream.problem)
    for frame in stream.frames:
        here.update(frame)
        there.update(frame)
    np.testing.assert_allclose(here.estimate().T_world_body, there.estimate().T_world_body, atol=1e-8)
    np.testing.assert_allclose(here.estimate().P, there.estimate().P, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("name", ["ekf_slam", "ekf_fej", "ukf_slam"])
def test_a_whole_stream_at_once_is_the_same_to_the_bit(numba: Any, name: str) -> None:
    made, _, _ = toy_stream(frames=100, landmarks=30, seen_at_once=4, seed=7)
    stream = without_pattern(made)
    target = back_ends.get(name).target
    stepped, whole = target(stream.problem), target(stream.problem)
    online = whole.run(stream.frames[:60])
    # A run may also go on from what is known, and be gone on from.
    rest = whole.run(stream.frames[60:99])
    whole.update(stream.frames[99])
    assert online.P is not None
    assert rest.P is not None
    last = whole.estimate()
    poses = np.concatenate([online.T_world_body, rest.T_world_body, last.T_world_body[None]])
    P = np.concatenate([online.P, rest.P, last.P[None]])
    for frame in stream.frames:
        stepped.update(frame)
        np.testing.assert_array_equal(poses[frame.k], stepped.estimate().T_world_body)
        np.testing.assert_array_equal(P[frame.k], stepped.estimate().P)
    np.testing.assert_array_equal(rest.t, [frame.t for frame in stream.frames[60:99]])
    np.testing.assert_array_equal(whole.joint_covariance(), stepped.joint_covariance())
    assert whole.diagnostics() == pytest.approx(stepped.diagnostics(), nan_ok=True)


def test_without_a_kernel_a_whole_stream_is_its_frames_one_by_one(plain: Any) -> None:
    stream, _, _ = toy_stream(frames=10)
    whole, stepped = plain("ekf_slam", stream.problem), plain("ekf_slam", stream.problem)
    online = whole.run(stream.frames)
    for frame in stream.frames:
        stepped.update(frame)
        np.testing.assert_array_equal(online.T_world_body[frame.k], stepped.estimate().T_world_body)
    nothing = plain("ekf_slam", stream.problem).run([])
    assert nothing.T_world_body.shape == (0, 3, 3)


def test_an_exactly_known_start_and_a_first_frame_that_sees(numba: Any, plain: Any) -> None:
    """P0 = 0 and a bearing on either side of ±180°, where the innovation must be wrapped."""
    stream, _, _ = toy_stream(frames=60, prior_sigma=0.0, noise=3.0, seed=1)
    bearings = np.concatenate([frame.z[:, 1] for frame in stream.frames])
    assert bearings.min() < -3.0
    assert bearings.max() > 3.0
    there, whole = plain("ekf_slam", stream.problem), EkfSlam(stream.problem)
    for frame in stream.frames:
        there.update(frame)
    whole.run(stream.frames)
    assert_same_map(whole, there)


def test_on_a_large_map_that_grows_past_its_buffers(numba: Any, plain: Any) -> None:
    """150 landmarks: BLAS instead of loops, both layouts of the plain covariance."""
    stream, _, _ = toy_stream(frames=60, landmarks=150, seen_at_once=9, seed=3)
    here, there = EkfSlam(stream.problem), plain("ekf_slam", stream.problem)
    for frame in stream.frames:
        here.update(frame)
        there.update(frame)
    assert_same_map(here, there)


def test_without_a_blas_to_call_the_loops_are_plain(numba: Any, plain: Any) -> None:
    stream, _, _ = toy_stream(frames=30, landmarks=40, seen_at_once=9, seed=3)
    here, there = EkfSlam(stream.problem), plain("ekf_slam", stream.problem)
    here.update(stream.frames[0])
    assert here._loops._state._blas != 0
    here._loops._state._blas = 0
    there.update(stream.frames[0])
    for frame in stream.frames[1:]:
        here.update(frame)
        there.update(frame)
    assert_same_map(here, there)


@pytest.mark.parametrize("name", ["ekf_slam", "iterated_ekf", "ukf_slam"])
def test_says_where_it_diverged(numba: Any, name: str) -> None:
    stream, _, _ = toy_stream(frames=30)
    bad = stream.frames[20]
    known = np.array([i in np.concatenate([f.ids for f in stream.frames[:20]]) for i in bad.ids])
    assert known.all()
    spoilt = Frame(bad.k, bad.t, bad.T_prev_body, bad.Q, bad.ids, np.nan * bad.z, bad.R)
    negative = Frame(bad.k, bad.t, bad.T_prev_body, bad.Q, bad.ids, bad.z, -100.0 * bad.R)
    for wrong in (spoilt, negative):
        frames = (*stream.frames[:20], wrong, *stream.frames[21:])
        ekf = back_ends.get(name).target(stream.problem)
        for frame in stream.frames[:20]:
            ekf.update(frame)
        with pytest.raises(DivergedError, match="frame 20: the innovation covariance"):
            ekf.update(wrong)
        with pytest.raises(DivergedError, match="frame 20: the innovation covariance"):
            back_ends.get(name).target(stream.problem).run(frames)


@pytest.mark.parametrize("name", ["ekf_slam", "ukf_slam"])
def test_a_landmark_that_cannot_be_placed_is_the_data_s_fault(numba: Any, plain: Any, name: str) -> None:
    stream, _, _ = toy_stream(frames=1)
    first = stream.frames[0]
    z = first.z.copy()
    z[2] = np.nan
    spoilt = Frame(0, 0.0, first.T_prev_body, first.Q, first.ids, z, first.R)
    for made in (back_ends.get(name).target(stream.problem), plain(name, stream.problem)):
        with pytest.raises(DataError, match=f"frame 0: landmark {first.ids[2]} cannot be placed"):
            made.update(spoilt)


@pytest.mark.parametrize("name", ["ekf_fej", "ekf_oc"])
def test_points_that_are_left_behind_stop_both_in_the_same_frame(
    numba: Any, plain: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "FARTHEST", 0.3)
    monkeypatch.setattr(far_points, "FARTHEST", 0.3)
    said = []
    stream, _, _ = toy_stream(frames=400, noise=20.0, seed=2)
    for made in (back_ends.get(name).target(stream.problem), plain(name, stream.problem)):
        with pytest.raises(DivergedError, match="far from the estimates") as caught:
            made.run(stream.frames)
        said.append(str(caught.value))
    assert said[0] == said[1]


def test_what_no_kernel_is_for_is_left_to_the_filter(numba: Any, plain: Any) -> None:
    """Listeners, other ways to keep P, other sensors, and whatever a user's class does differently."""
    planar, _, _ = toy_stream(frames=3)
    spatial, _, _ = spatial_stream(frames=3)

    class Mine(EkfSlam):
        """Not of this package."""

    recorded = EkfSlam(planar.problem)
    recorded.record_linearisation()
    made = [
        recorded,
        back_ends.get("ekf_fej").target(planar.problem, smooth=True),
        EkfSlam(planar.problem, active_landmarks=3),
        EkfSlam(planar.problem, forget_after=5),
        EkfSlam(planar.problem, robust="huber"),
        Mine(planar.problem),
    ]
    for stream, filters in ((planar, made), (spatial, [EkfSlam(spatial.problem)])):
        for each in filters:
            for frame in stream.frames:
                each.update(frame)
            assert each._loops.answer is None


def test_without_numba_the_numbers_are_the_plain_ones(monkeypatch: pytest.MonkeyPatch, plain: Any) -> None:
    stream, _, _ = toy_stream(frames=10)
    monkeypatch.setattr(loops.importlib.util, "find_spec", lambda name: None)
    loops.kernels.cache_clear()
    try:
        here, there = EkfSlam(stream.problem), plain("ekf_slam", stream.problem)
        for frame in stream.frames:
            here.update(frame)
            there.update(frame)
        np.testing.assert_array_equal(here.joint_covariance(), there.joint_covariance())
        assert not loops.is_kept()
    finally:
        loops.kernels.cache_clear()


def test_the_old_name_says_what_to_name_instead() -> None:
    with pytest.raises(UsageError, match=r"^back end 'ekf_compiled' is gone: ekf_slam .*name ekf_slam"):
        back_ends.get("ekf_compiled")


def test_compiles_where_nothing_can_be_cached(numba: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package folder and a home that are both read-only leave numba no place: it refuses to cache."""
    from numba.core.caching import FunctionCache

    from slamcmp.backends.filters.compiled.compiling import compiled

    monkeypatch.setattr(FunctionCache._impl_class, "_locator_classes", [])
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(lambda x: x + 1)
    assert compiled(numba.int64(numba.int64))(lambda x: x + 1)(41) == 42


def test_what_is_kept_is_known_by_the_text_of_all_kernels(
    numba: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba itself looks at the file of the entry alone, which most changes do not touch."""
    from slamcmp.backends.filters.compiled import compiling, ekf_kernel

    assert ekf_kernel.run._cache._cache_file._source_stamp == compiling.sources_digest()
    before = loops._mark()
    texts = {path: path.read_bytes() for path in Path(compiling.__file__).parent.glob("*.py")}
    for changed in texts:
        read = lambda path, c=changed: texts[path] + (b"# changed" if path == c else b"")  # noqa: E731
        monkeypatch.setattr(Path, "read_bytes", read)
        assert loops._mark() != before, changed
        assert compiling.sources_digest.__wrapped__() != compiling.sources_digest()


def test_who_is_listened_to_gives_the_same_answers(numba: Any) -> None:
    """A recording or smoothing filter does its frames itself, the one beside it is compiled."""
    stream, _, _ = toy_stream(frames=100, landmarks=20)
    recording = EkfSlam(stream.problem)
    recording.record_linearisation()
    made = [
        EkfSlam(stream.problem),
        recording,
        back_ends.get("ekf_world").target(stream.problem, smooth=True),
        EkfSlam(stream.problem, active_landmarks=20),
    ]
    for frame in stream.frames:
        for each in made:
            each.update(frame)
    first, *others = made
    for other in others:
        np.testing.assert_allclose(
            other.estimate().T_world_body, first.estimate().T_world_body, rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(other.joint_covariance(), first.joint_covariance(), rtol=1e-10, atol=1e-12)


def test_what_a_filter_has_shown_stays_and_what_it_holds_counts(numba: Any) -> None:
    stream, _, _ = toy_stream(frames=20)
    ekf = EkfSlam(stream.problem)
    for frame in stream.frames[:10]:
        ekf.update(frame)
    before, shown = ekf.estimate(), ekf.landmarks()
    copies = before.T_world_body.copy(), before.P.copy(), shown.positions.copy()
    for frame in stream.frames[10:]:
        ekf.update(frame)
    for now, then in zip((before.T_world_body, before.P, shown.positions), copies, strict=True):
        np.testing.assert_array_equal(now, then)
    assert not np.array_equal(ekf.landmarks().positions, copies[2])
