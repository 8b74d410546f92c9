"""Forgetting landmarks: exact where they never come back, honest where they do."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.backends.filters.covariances.covariance import FULL_LIMIT, JointCovariance
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.errors import UsageError
from tests.camera_stream import Kind, camera_stream, without_returns
from tests.toy_stream import toy_stream


@pytest.mark.parametrize("kind", ["stereo", "mono"])
@pytest.mark.parametrize("forget_after", [1, 3])
def test_forgetting_what_is_never_seen_again_changes_nothing_else(kind: Kind, forget_after: int) -> None:
    """After every frame: the full filter's pose, and its blocks of the landmarks that remain."""
    stream = without_returns(camera_stream(kind)[0])
    full, forgetful = EkfSlam(stream.problem), EkfSlam(stream.problem, forget_after=forget_after)
    last_seen: dict[int, int] = {}
    for frame in stream.frames:
        full.update(frame)
        forgetful.update(frame)
        entries = [] if frame.entries is None else frame.entries.ids.tolist()
        last_seen.update(dict.fromkeys([*frame.ids.tolist(), *entries], frame.k))
        remaining = [i for i in full.landmarks().ids.tolist() if frame.k - last_seen[i] < forget_after]
        own, whole = forgetful.landmarks(), full.landmarks()
        assert own.ids.tolist() == remaining
        rows = np.flatnonzero(np.isin(whole.ids, remaining))
        states = np.concatenate([np.arange(6), (6 + 3 * rows[:, None] + np.arange(3)).ravel()])
        np.testing.assert_allclose(
            forgetful.estimate().T_world_body, full.estimate().T_world_body, rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(own.positions, whole.positions[rows], rtol=0, atol=1e-12)
        joint = full.joint_covariance()[np.ix_(states, states)]
        np.testing.assert_allclose(forgetful.joint_covariance(), joint, rtol=0, atol=1e-12)
        assert forgetful.diagnostics()["dropped"] == 0
    assert len(full.landmarks().ids) > len(remaining)


def test_a_forgotten_landmark_enters_anew_where_one_measurement_places_it() -> None:
    """In the plane, landmarks come and go at random: each return is a first sight."""
    stream, _, _ = toy_stream(frames=40)
    forgetful = EkfSlam(stream.problem, forget_after=2)
    last_seen: dict[int, int] = {}
    for frame in stream.frames:
        again = [i for i in frame.ids.tolist() if frame.k - last_seen.get(i, -99) <= 2]
        forgetful.update(frame)
        last_seen.update(dict.fromkeys(frame.ids.tolist(), frame.k))
        assert forgetful.diagnostics()["nis_dof"] == 2 * len(again)
        assert forgetful.diagnostics()["dropped"] == 0


def test_what_a_camera_sees_of_a_forgotten_landmark_is_dropped_and_counted() -> None:
    stream, _ = camera_stream("mono", frames=12)
    frames = list(stream.frames)
    victim = int(frames[4].ids[0])
    assert all(victim in frames[k].ids for k in (3, 4, 5, 6))
    without = frames[4].ids != victim
    frames[4] = type(frames[4])(
        4,
        frames[4].t,
        frames[4].T_prev_body,
        frames[4].Q,
        frames[4].ids[without],
        frames[4].z[without],
        frames[4].R[without],
        frames[4].entries,
    )
    forgetful = EkfSlam(stream.problem, forget_after=1)
    for frame in frames[:6]:
        forgetful.update(frame)
    assert forgetful.diagnostics()["dropped"] == 1
    assert forgetful.diagnostics()["nis_dof"] == 2 * (frames[5].ids.size - 1)
    assert victim not in forgetful.landmarks().ids


def test_postponing_and_forgetting_exclude_each_other() -> None:
    stream, _, _ = toy_stream(frames=1)
    with pytest.raises(UsageError, match="give one of the two"):
        EkfSlam(stream.problem, active_landmarks=5, forget_after=5)


@pytest.mark.parametrize(("states", "removed"), [(60, 20), (700, 100), (700, 600)])
def test_removing_states_is_deleting_rows_and_columns(states: int, removed: int) -> None:
    """In the small layout, in the large one, and from the large one to the small."""
    rng = np.random.default_rng(states)
    P = JointCovariance(np.eye(6))
    G = rng.normal(size=(states, 6))
    P.augment(G, np.diag(rng.uniform(1, 2, states)))
    dense = P.dense()
    gone = np.sort(rng.choice(np.arange(6, 6 + states), removed, replace=False))
    buffer = P._buffer
    P.remove(gone)
    left = np.delete(np.arange(6 + states), gone)
    np.testing.assert_array_equal(P.dense(), dense[np.ix_(left, left)])
    # Whatever comes next works on what is left only.
    W_t = 0.01 * rng.normal(size=(4, left.size))
    P.downdate(W_t)
    P.augment(G[:30], np.eye(30))
    expected = dense[np.ix_(left, left)] - W_t.T @ W_t
    np.testing.assert_allclose(P.dense()[: left.size, : left.size], expected, atol=1e-13)
    np.testing.assert_allclose(P.dense()[left.size :, :6], G[:30] @ expected[:6, :6], atol=1e-12)
    if states - removed > FULL_LIMIT and removed < states / 8:
        assert P._buffer is buffer


def test_a_large_buffer_is_reused_and_never_copied() -> None:
    """BLAS works in place on the Fortran-ordered buffer, before and after states come and go."""
    P = JointCovariance(np.eye(6))
    P.augment(np.zeros((900, 6)), np.eye(900))
    buffer = P._buffer
    for _ in range(5):
        P.remove(np.arange(6, 66))
        P.augment(np.zeros((60, 6)), np.eye(60))
        P.downdate(np.full((3, P.size), 1e-3))
        assert P._buffer is buffer
        assert buffer.flags.f_contiguous
    # 5 downdates by 3e-6 have reached the oldest states: those of the pose.
    np.testing.assert_allclose(np.diag(P.dense())[:6], 1 - 5 * 3e-6, rtol=1e-14)
    P.remove(np.arange(6, 606))
    P.downdate(np.zeros((1, P.size)))
    assert P._buffer.shape[0] < 330 * 1.25
