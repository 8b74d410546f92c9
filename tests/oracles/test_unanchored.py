"""What back ends would know without a start: against dense normal equations, known nullities, identities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.covariances.error_covariance import Correction, Growth, Step
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.error_state.unanchored import UnanchoredFilter
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.metrics.observability import nullity, unanchored_information
from tests.oracles.filters import CONSISTENT, BodyEkf, maker, run, world_of
from tests.oracles.observability import textbook_nullity

RIGID = {2: 3, 3: 6}
"""Dimension of the world's rigid motions."""


def told(back_end: Any, stream: Any) -> Any:
    back_end.record_linearisation()
    return run(back_end, stream).linearisation()


def information(linearisation: Any) -> np.ndarray:
    return np.asarray(linearisation.root.T @ linearisation.root)


def seen_nullity(linearisation: Any) -> int:
    return nullity(linearisation.root, linearisation.scale)


def test_square_root_against_dense_normal_equations() -> None:
    """A linear chain of three steps and two landmarks, all variables at once, and all but x_3 eliminated."""
    rng = np.random.default_rng(0)
    p, n, q = 3, 2, 2
    F = [np.eye(p) + 0.3 * rng.normal(size=(p, p)) for _ in range(3)]
    W = [rng.normal(size=(p, q)) for _ in range(3)]
    G, N = rng.normal(size=(2 * n, p)), np.diag([0.5, 1.0, 2.0, 4.0])
    H, R = [rng.normal(size=(4, p + n)) for _ in range(3)], 0.3 * np.eye(4)

    recorded = UnanchoredFilter(p)
    recorded.hear(Growth(G, N))
    # Unknowns of the dense system: x_0, u_1, u_2, u_3, landmarks; x_k = F x_{k-1} + W u_k.
    size = p + 3 * q + 2 * n
    x = np.eye(p, size)
    land = np.eye(2 * n, size, p + 3 * q)
    rows = [np.linalg.cholesky(np.linalg.inv(N)).T @ (land - G @ x), np.eye(3 * q, size, p)]
    for k in range(3):
        recorded.hear(Step(F[k], W=W[k]))
        x = F[k] @ x + W[k] @ np.eye(q, size, p + k * q)
        number = k % 2
        touched = np.concatenate([np.arange(p), p + n * number + np.arange(n)])
        recorded.hear(Correction(touched, H[k], R, np.linalg.cholesky(R), H[k], np.zeros(4)))
        rows.append(H[k] @ np.concatenate([x, land[n * number : n * number + n]]) / np.sqrt(0.3))
    A = np.concatenate(rows)
    covariance = x @ np.linalg.inv(A.T @ A) @ x.T
    root, _ = recorded.told()
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(covariance), rtol=1e-10)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", [*CONSISTENT, RobocentricEkf])
@pytest.mark.parametrize("mode", ["join_first", "update_first"])
def test_consistent_filters_would_know_nothing(filter_class: Any, space_dim: int, mode: str) -> None:
    stream, truth = world_of(space_dim)
    found = told(maker(filter_class, new_landmarks=mode)(stream.problem, truth), stream)
    assert seen_nullity(found) == RIGID[space_dim]
    np.testing.assert_allclose(information(found), 0.0, atol=1e-18)


@pytest.mark.parametrize("space_dim", [2, 3])
def test_the_standard_filter_would_know_how_the_world_is_turned(space_dim: int) -> None:
    """Nullity 2 in the plane and 3 in space: translations are left. The whole of it is about turns."""
    stream, _ = world_of(space_dim)
    found = told(EkfSlam(stream.problem), stream)
    turn, shift = unanchored_information(found.root)
    assert seen_nullity(found) == space_dim
    assert turn > 100.0
    assert shift < 1e-18
    body = told(EkfSlam(stream.problem, error_state="body"), stream)
    assert seen_nullity(body) == 0
    assert min(unanchored_information(body.root)) > 0.1


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", [*CONSISTENT, RobocentricEkf, BodyEkf, IteratedEkf])
def test_nullity_is_that_of_the_observability_matrix(filter_class: Any, space_dim: int) -> None:
    stream, truth = world_of(space_dim)
    filter_ = maker(filter_class, smooth=True)(stream.problem, truth)
    assert seen_nullity(told(filter_, stream)) == textbook_nullity(filter_.history)


@pytest.mark.parametrize("space_dim", [2, 3])
def test_equal_estimators_tell_the_same(space_dim: int) -> None:
    """Window 1 with one iteration and frozen windows are the EKF, window 1 iterated the iterated EKF."""
    stream, _ = world_of(space_dim)
    problem = stream.problem
    ekf = information(told(EkfSlam(problem), stream))
    frozen = {"linearisation": "frozen", "iterations": 1}
    for other in (
        EkfSlam(problem, active_landmarks=3),
        IteratedEkf(problem, iterations=1),
        SlidingWindow(problem, window=1, iterations=1),
        SlidingWindow(problem, window=1, **frozen),
        SlidingWindow(problem, window=7, **frozen),
        SlidingWindow(problem, window=None, **frozen),
    ):
        np.testing.assert_allclose(information(told(other, stream)), ekf, rtol=1e-6, atol=1e-7 * ekf.max())
    iterated = information(told(IteratedEkf(problem), stream))
    window = information(told(SlidingWindow(problem, window=1, iterations=30, tolerance=1e-12), stream))
    np.testing.assert_allclose(window, iterated, rtol=1e-5, atol=1e-6 * iterated.max())


@pytest.mark.parametrize("space_dim", [2, 3])
def test_windows(space_dim: int) -> None:
    """First estimates and full smoothing know nothing; a window that relinearises knows less than the EKF."""
    stream, _ = world_of(space_dim)
    for settings in (
        {"window": 5, "linearisation": "fej"},
        {"window": 5, "linearisation": "fej", "landmarks": "drop_unseen"},
        {"window": None},
    ):
        found = told(SlidingWindow(stream.problem, **settings), stream)
        assert seen_nullity(found) == RIGID[space_dim]
        np.testing.assert_allclose(information(found), 0.0, atol=1e-18)
    latest = told(SlidingWindow(stream.problem, window=5), stream)
    assert seen_nullity(latest) == space_dim
    ekf = unanchored_information(told(EkfSlam(stream.problem), stream).root)[0]
    assert 1.0 < unanchored_information(latest.root)[0] < 0.5 * ekf


@pytest.mark.parametrize(("retraction", "expected"), [("additive", 2), ("right_invariant", 3)])
def test_sigma_points_see_what_their_chart_sees(retraction: Any, expected: int) -> None:
    stream, _ = world_of(2)
    found = told(UkfSlam(stream.problem, retraction=retraction), stream)
    assert seen_nullity(found) == expected


def test_recording_changes_no_estimate(plain_filters: None) -> None:
    stream, _ = world_of(2)
    for make in (lambda: EkfSlam(stream.problem), lambda: SlidingWindow(stream.problem, window=3)):
        plain, recording = make(), make()
        recording.record_linearisation()
        run(plain, stream), run(recording, stream)
        np.testing.assert_array_equal(plain.estimate().T_world_body, recording.estimate().T_world_body)
        np.testing.assert_array_equal(plain.joint_covariance(), recording.joint_covariance())


def test_points_of_the_jacobians() -> None:
    """First estimates stay where they were; the standard filter's points are the means before its update."""
    stream, truth = world_of(2)
    fej, standard = maker(CONSISTENT[1])(stream.problem, truth), EkfSlam(stream.problem)
    first: dict[int, np.ndarray] = {}
    for filter_ in (fej, standard):
        filter_.record_linearisation()
    for frame in stream.frames:
        before = standard.estimate().T_world_body @ frame.T_prev_body
        known = standard.landmarks()
        for filter_ in (fej, standard):
            filter_.update(frame)
        seen = [i for i in frame.ids.tolist() if i in known.ids.tolist()]
        at = standard.linearisation()
        if seen:
            np.testing.assert_allclose(at.T_world_body, before, atol=1e-12)
            rows = [known.ids.tolist().index(i) for i in seen]
            np.testing.assert_allclose(at.landmarks_at, known.positions[rows], atol=1e-12)
            for i, point in zip(seen, fej.linearisation().landmarks_at, strict=True):
                np.testing.assert_array_equal(first.setdefault(i, point), point)


def test_a_windows_points_of_the_jacobians_are_the_predicted_pose_and_the_maps_means() -> None:
    """A window of one pose, solved by one step, linearises where an EKF does."""
    stream, _ = world_of(2)
    window = SlidingWindow(stream.problem, window=1, iterations=1)
    window.record_linearisation()
    told = 0
    for frame in stream.frames[:12]:
        pose = window.estimate().T_world_body @ frame.T_prev_body if frame.k else None
        known = {} if not frame.k else dict(zip(*window_map(window), strict=True))
        window.update(frame)
        seen = [i for i in frame.ids.tolist() if i in known]
        if pose is None or len(seen) < frame.ids.size or not seen:
            continue
        at = window.linearisation()
        np.testing.assert_allclose(at.T_world_body, pose, atol=1e-12)
        np.testing.assert_allclose(at.landmarks_at, [known[i] for i in seen], atol=1e-12)
        now = dict(zip(*window_map(window), strict=True))
        np.testing.assert_array_equal(at.landmarks, [now[i] for i in seen])
        told += 1
    assert told > 3


def window_map(window: SlidingWindow) -> tuple[list[int], np.ndarray]:
    found = window.landmarks()
    return found.ids.tolist(), found.positions
