"""The ends of the dial on camera streams: window 1 is the EKF, the infinite window the batch solution."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.variants import FirstEstimatesEkf
from slamcmp.backends.gtsam_smoothers.batch import Batch
from slamcmp.backends.window.sliding_window import SlidingWindow
from tests.backends.graph_streams import run
from tests.camera_stream import Kind, camera_stream, without_returns
from tests.oracles.test_dial_identities import assert_ekf_all_along, assert_same_posterior
from tests.oracles.window_graph import WindowOneGraph, assert_same_all_along

KINDS: tuple[Kind, ...] = ("stereo", "mono", "rgbd")


@pytest.mark.parametrize("kind", KINDS)
def test_window_one_with_one_iteration_is_the_ekf(kind: Kind) -> None:
    """Mean, map and joint covariance after every frame to 1e-9; chi-square is the sum of the NIS."""
    stream, _ = camera_stream(kind)
    assert_ekf_all_along(stream, SlidingWindow(stream.problem, window=1, iterations=1), 1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_longer_window_with_frozen_linear_forms_is_still_the_ekf(kind: Kind) -> None:
    stream, _ = camera_stream(kind, frames=12)
    window = SlidingWindow(stream.problem, window=4, iterations=2, linearisation="frozen")
    assert_ekf_all_along(stream, window, 1e-8)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_window_one_with_first_estimates_is_the_fej_ekf(kind: Kind) -> None:
    stream, _ = camera_stream(kind, frames=15)
    window = SlidingWindow(stream.problem, window=1, iterations=1, linearisation="fej")
    fej = FirstEstimatesEkf(stream.problem)
    for frame in stream.frames:
        fej.update(frame)
        window.update(frame)
        assert_same_posterior(window, fej)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
@pytest.mark.parametrize("axes", ["world", "body"])
def test_ekf_is_the_window_one_graph_of_gtsams_own_factors(
    kind: Kind, axes: Literal["world", "body"]
) -> None:
    """linearize, eliminatePartialSequential, LinearContainerFactor: the filter after each of 25 frames."""
    stream, _ = camera_stream(kind, frames=25, landmarks=60, seen_at_once=8)
    ekf = EkfSlam(stream.problem, error_state=axes)
    graph = WindowOneGraph(stream.problem, axes=axes)
    assert_same_all_along(stream, ekf, graph)
    assert len(graph.ids) > 15


@pytest.mark.parametrize("kind", KINDS)
def test_infinite_window_to_convergence_is_the_batch_solution(kind: Kind) -> None:
    stream, _ = camera_stream(kind, frames=14, landmarks=40, seen_at_once=8)
    window = run(SlidingWindow(stream.problem, window=None, iterations=60, tolerance=1e-10), stream)
    batch = run(
        Batch(stream.problem, optimizer="gauss_newton", relative_error_tol=0.0, max_iterations=30), stream
    )
    ours = window.trajectory()
    # With no tolerance Gauss-Newton stops where the cost does not fall any more.
    theirs = batch.trajectory()
    np.testing.assert_allclose(ours.T_world_body, theirs.T_world_body, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-5, atol=1e-10)
    assert window.diagnostics()["chi2"] == pytest.approx(batch.diagnostics()["chi2"], rel=1e-8)
    assert window.diagnostics()["dof"] == batch.diagnostics()["dof"]


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_marginalising_unseen_landmarks_is_forgetting_them(kind: Kind) -> None:
    """Window 1 that drops what neither it nor the new frame sees keeps what was seen one frame ago."""
    stream = without_returns(camera_stream(kind, frames=15)[0])
    window = SlidingWindow(stream.problem, window=1, iterations=1, landmarks="drop_unseen")
    ekf = EkfSlam(stream.problem, forget_after=1)
    for frame in stream.frames:
        ekf.update(frame)
        window.update(frame)
        assert_same_posterior(window, ekf)
        assert window.diagnostics()["dropped"] == 0


def test_what_a_camera_sees_of_a_dropped_landmark_is_counted() -> None:
    stream, _ = camera_stream("mono", frames=30)
    window = SlidingWindow(stream.problem, window=1, iterations=2, landmarks="drop_unseen")
    seen, dropped = {}, 0
    for frame in stream.frames:
        expected = sum(frame.k - seen[i] > 1 for i in frame.ids.tolist())
        window.update(frame)
        assert window.diagnostics()["dropped"] == expected
        dropped += expected
        ids = [i for i in frame.ids.tolist() if frame.k - seen[i] <= 1]
        ids += [] if frame.entries is None else frame.entries.ids.tolist()
        seen.update(dict.fromkeys(ids, frame.k))
    assert dropped > 0
