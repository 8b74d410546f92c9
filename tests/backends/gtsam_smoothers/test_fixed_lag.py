"""What leaves the window, when, and how it is remembered."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.gtsam_smoothers.fixed_lag import FixedLag
from slamcmp.datasets.victoria_park import victoria_park
from slamcmp.frontend.labelled import labelled
from slamcmp.types import Frame, MeasurementStream
from tests.backends.graph_streams import run
from tests.toy_stream import toy_stream

LAG = 6


def with_a_gap(stream: MeasurementStream, landmark: int, gap: range) -> MeasurementStream:
    """The stream without the sightings of one landmark in some frames."""
    frames = []
    for f in stream.frames:
        kept = np.ones(f.ids.size, bool) if f.k not in gap else f.ids != landmark
        frames.append(Frame(f.k, f.t, f.T_prev_body, f.Q, f.ids[kept], f.z[kept], f.R[kept]))
    return MeasurementStream(stream.problem, tuple(frames))


@pytest.mark.parametrize("sensor_name", ["range_bearing", "relative_position"])
@pytest.mark.parametrize("mode", ["incremental", "batch"])
def test_a_dropped_landmark_leaves_is_remembered_and_comes_back_fresh(mode: str, sensor_name: str) -> None:
    """Landmark 3 is always seen but in frames 20 to 29; it leaves at frame 26 and comes back at 30."""
    stream, _, _ = toy_stream(frames=36, landmarks=4, seen_at_once=4, sensor_name=sensor_name)
    gapped = with_a_gap(stream, 3, range(20, 30))
    back_end = FixedLag(gapped.problem, lag_frames=LAG, mode=mode, landmarks="drop")
    last_in_window = None
    for frame in gapped.frames:
        back_end.update(frame)
        count = back_end.diagnostics()["landmarks"]
        assert count == (3 if 19 + LAG < frame.k < 30 else 4)
        landmarks = back_end.landmarks()
        assert landmarks.ids.tolist() == [0, 1, 2, 3]
        entry = landmarks.positions[3], landmarks.covariances[3]
        if frame.k == 19 + LAG:
            last_in_window = entry
        if 19 + LAG < frame.k < 30:
            np.testing.assert_array_equal(entry[0], last_in_window[0])
            np.testing.assert_array_equal(entry[1], last_in_window[1])
        if frame.k == 30:
            # Known from one sighting only, it is vaguer than what was forgotten.
            assert np.trace(entry[1]) > 1.5 * np.trace(last_in_window[1])


@pytest.mark.parametrize("mode", ["incremental", "batch"])
def test_a_kept_landmark_never_leaves(mode: str) -> None:
    stream, _, _ = toy_stream(frames=36, landmarks=4, seen_at_once=4)
    gapped = with_a_gap(stream, 3, range(8, 36))
    back_end = FixedLag(gapped.problem, lag_frames=LAG, mode=mode)
    before = None
    for frame in gapped.frames:
        back_end.update(frame)
        assert back_end.diagnostics()["landmarks"] == 4
        assert back_end.diagnostics()["variables"] == 4 + min(frame.k + 1, LAG + 1)
        if frame.k == 7:
            before = back_end.landmarks()
    # Its neighbours' sightings still improve it: their errors are correlated.
    assert np.trace(back_end.landmarks().covariances[3]) < np.trace(before.covariances[3])


@pytest.mark.parametrize("mode", ["incremental", "batch"])
def test_trajectory_holds_each_pose_as_it_left(mode: str) -> None:
    """Pose j of the trajectory is pose j of a smoother that was stopped at frame j + lag."""
    stream, _, _ = toy_stream(frames=20)
    whole = run(FixedLag(stream.problem, lag_frames=LAG, mode=mode), stream).trajectory()
    for j in (0, 5, 19 - LAG):
        short = FixedLag(stream.problem, lag_frames=LAG, mode=mode)
        for frame in stream.frames[: j + LAG + 1]:
            short.update(frame)
        np.testing.assert_allclose(
            short.trajectory().T_world_body[j], whole.T_world_body[j], rtol=0, atol=1e-12
        )
    assert whole.P is None
    np.testing.assert_array_equal(whole.t, [frame.t for frame in stream.frames])


def test_hindsight_shrinks_the_gap_to_the_batch_solution() -> None:
    """Median over 8 seeds of the trajectory's distance from the optimum: longer lag, smaller distance."""
    distances = {1: [], 8: [], 40: []}
    for seed in range(8):
        stream, _, _ = toy_stream(frames=60, seed=seed)
        best = run(Batch(stream.problem), stream).trajectory().T_world_body
        for lag, found in distances.items():
            poses = run(FixedLag(stream.problem, lag_frames=lag), stream).trajectory().T_world_body
            found.append(np.sqrt(np.mean((poses - best)[:, :2, 2] ** 2)))
    medians = [np.median(found) for found in distances.values()]
    assert medians[0] > medians[1] > medians[2]


def test_qr_survives_dropped_landmarks_on_victoria_park() -> None:
    """4000 poses; Cholesky fails at frame 3037."""
    stream = labelled(victoria_park(steps=4000), 0, gate_probability=None)
    back_end = run(FixedLag(stream.problem, landmarks="drop"), stream)
    assert np.linalg.eigvalsh(back_end.estimate().P)[0] > 0
    assert back_end.landmarks().ids.size > back_end.diagnostics()["landmarks"]
