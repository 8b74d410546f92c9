"""The frozen types: shapes, signs, read-only arrays, and a digest of the content alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.errors import DataError
from slamcmp.models.camera import MonoCamera
from slamcmp.models.sensors import RangeBearing, RelativePosition
from slamcmp.randomness import random_streams
from slamcmp.types import (
    Detections,
    Estimate,
    Frame,
    GroundTruth,
    Landmarks,
    Log,
    MeasurementStream,
    Problem,
    Trajectory,
)


def problem(**changes) -> Problem:
    return Problem(**{"T_world_body": np.eye(3), "P": 0.01 * np.eye(3), "sensor": RangeBearing()} | changes)


def frame(k=1, **changes) -> Frame:
    fields = {
        "k": k,
        "t": float(k),
        "T_prev_body": g.se2(1.0, 0.0, 0.1) if k else np.eye(3),
        "Q": 0.01 * np.eye(3) if k else np.zeros((3, 3)),
        "ids": [4, 7],
        "z": [[1.0, 0.1], [2.0, -0.2]],
        "R": np.tile(0.01 * np.eye(2), (2, 1, 1)),
    }
    return Frame(**fields | changes)


def stream(second: Frame | None = None, **changes) -> MeasurementStream:
    return MeasurementStream(problem(**changes), (frame(0), second or frame(1)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"T_prev_body": np.eye(5)}, r"Frame.T_prev_body: shape \(5, 5\)"),
        ({"Q": np.eye(2)}, r"Frame.Q: shape \(2, 2\) where \(3, 3\) is needed"),
        ({"z": np.ones((3, 2))}, r"Frame.z: shape \(3, 2\)"),
        ({"R": np.ones((2, 2))}, r"Frame.R: shape \(2, 2\)"),
        ({"ids": [[1], [2]]}, r"Frame.ids: shape \(2, 1\)"),
    ],
)
def test_frame_shapes(change, message):
    with pytest.raises(DataError, match=message):
        frame(**change)


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"k": 2}, "numbered from 0 without gaps"),
        ({"t": 0.0}, "does not come after"),
        ({"ids": [4, 4]}, "stands twice"),
        ({"z": [[np.nan, 0.1], [2.0, -0.2]]}, r"frames\[\*\].z: has entries that are not finite"),
        ({"Q": np.diag([1.0, 1.0, -1e-3])}, "Frame.Q: a covariance is not positive semi-definite"),
        ({"Q": np.eye(3) + np.triu(0.1 * np.ones((3, 3)), 1)}, "Frame.Q: a covariance is not symmetric"),
        ({"R": np.zeros((2, 2, 2))}, "Frame.R: a covariance is not positive definite"),
        (
            {"z": np.ones((2, 3)), "R": np.tile(np.eye(3), (2, 1, 1))},
            "do not fit sensor 'range_bearing'",
        ),
    ],
)
def test_stream_content(second, message):
    with pytest.raises(DataError, match=message):
        stream(frame(**second))


def test_stream_starts_with_the_identity():
    with pytest.raises(DataError, match="must carry the identity"):
        MeasurementStream(problem(), (frame(0, Q=np.eye(3)),))
    with pytest.raises(DataError, match="at least one frame"):
        MeasurementStream(problem(), ())


def test_problem_prior_must_be_a_covariance():
    with pytest.raises(DataError, match=r"Problem\.P: a covariance is not positive semi-definite"):
        problem(P=-np.eye(3))
    with pytest.raises(DataError, match=r"Problem\.T_world_body: has entries that are not finite"):
        problem(T_world_body=np.full((3, 3), np.inf))
    with pytest.raises(DataError, match=r"Problem.T_world_body: shape \(3, 3\)"):
        problem(sensor=RelativePosition(space_dim=3))
    assert not problem(P=np.zeros((3, 3))).P.any()


def test_arrays_are_read_only_copies():
    mine = np.eye(3)
    kept = problem(T_world_body=mine)
    mine[0, 2] = 5.0
    assert kept.T_world_body[0, 2] == 0.0
    everything = [
        problem(),
        frame(),
        Detections(np.ones((1, 2)), np.ones((1, 2, 2)), [1]),
        Estimate(np.eye(3), np.eye(3)),
        Landmarks([1], np.ones((1, 2)), np.ones((1, 2, 2))),
        Trajectory([0.0], np.eye(3)[None], np.eye(3)[None]),
        GroundTruth([0.0], np.eye(3)[None], [1], np.ones((1, 2))),
    ]
    checked = 0
    for value in everything:
        for field in dataclasses.fields(value):
            array = getattr(value, field.name)
            if isinstance(array, np.ndarray):
                checked += 1
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 0
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, dataclasses.fields(value)[0].name, None)
    assert checked == 22


def test_log_lengths():
    t, T, Q = np.arange(2.0), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3, 3))
    none = Detections(np.empty((0, 2)), np.empty((0, 2, 2)), [])
    truth = GroundTruth([0.5], np.eye(3)[None], [], np.empty((0, 2)))
    Log("x", problem(), t, T, Q, (none, none))
    with pytest.raises(DataError, match="1 entries for 2 frames"):
        Log("x", problem(), t, T, Q, (none,))
    with pytest.raises(DataError, match=r"GroundTruth\.t: .*0\.5.* s is none of the log's 2 time stamps"):
        Log("x", problem(), t, T, Q, (none, none), truth)
    with pytest.raises(DataError, match=r"Log\.Q"):
        Log("x", problem(), t, T, Q[:1], (none, none))


def nudged(array) -> list[np.ndarray]:
    """Copies of ``array`` with one entry moved to the next number."""
    array = np.asarray(array, dtype=float)
    copies = []
    for index in np.ndindex(array.shape):
        copy = array.copy()
        copy[index] = np.nextafter(copy[index], np.inf)
        copies.append(copy)
    return copies


def test_digest_changes_with_every_number():
    base = stream()
    digests = [base.digest]
    one = frame(1)
    for name in ("T_prev_body", "z"):
        digests += [stream(frame(1, **{name: array})).digest for array in nudged(getattr(one, name))]
    for i in range(3):
        Q = one.Q.copy()
        Q[i, i] = np.nextafter(Q[i, i], 1)
        digests.append(stream(frame(1, Q=Q)).digest)
        P = base.problem.P.copy()
        P[i, i] = np.nextafter(P[i, i], 1)
        digests.append(stream(P=P).digest)
    R = one.R.copy()
    R[1, 1, 1] = np.nextafter(R[1, 1, 1], 1)
    digests += [
        stream(frame(1, R=R)).digest,
        stream(frame(1, t=np.nextafter(1.0, 2))).digest,
        stream(frame(1, ids=[4, 8])).digest,
        stream(frame(1, ids=[7, 4])).digest,
        stream(T_world_body=g.se2(1e-300, 0.0, 0.0)).digest,
        stream(sensor=RelativePosition()).digest,
        MeasurementStream(problem(), (frame(0),)).digest,
        MeasurementStream(problem(), (frame(0), frame(1), frame(2))).digest,
    ]
    assert len(set(digests)) == len(digests) == 1 + 9 + 4 + 6 + 8


def test_digest_does_not_know_memory_layout():
    one = frame(1)
    wide = np.zeros((4, 4))
    wide[::2, ::2] = one.z
    same = frame(
        1,
        T_prev_body=np.asfortranarray(one.T_prev_body),
        Q=one.Q.astype(">f8"),
        ids=np.array([4, 7], dtype=np.int32),
        z=wide[::2, ::2],
        R=np.swapaxes(one.R, 1, 2),
    )
    assert stream(same).digest == stream().digest


def test_digest_is_the_one_of_the_first_release():
    # The format is promised to users' stored results: a change must raise "format" in the header.
    assert stream().digest == "ac5f28b1893cc3a3913896fa2b6f33145d0633939fe1e8a00c7c4426afad3c2a"


def test_random_streams_are_independent_children():
    first, again, other = random_streams(7), random_streams(7), random_streams(8)
    names = [field.name for field in dataclasses.fields(first)]
    assert names == ["world", "odometry", "sensor", "outliers", "front_end"]
    firsts = [getattr(first, name).random() for name in names]
    # Drawing from one child moves no other.
    again.world.random(1000)
    assert [getattr(again, name).random() for name in names[1:]] == firsts[1:]
    assert len({*firsts, *(getattr(other, name).random() for name in names)}) == 10


def test_a_landmark_id_stands_once() -> None:
    with pytest.raises(DataError, match=r"Landmarks\.ids: id 7 stands twice"):
        Landmarks([7, 1, 7], np.ones((3, 2)), np.ones((3, 2, 2)))
    with pytest.raises(DataError, match=r"GroundTruth\.ids: id 7 stands twice"):
        GroundTruth([0.0], np.eye(3)[None], [7, 7], np.ones((2, 2)))


def camera_stream(*second, entries_at=0) -> MeasurementStream:
    """Landmark 4 enters in one of two frames; the second frame measures the given ids."""
    camera = MonoCamera(fx_px=400.0, fy_px=400.0, cx_px=320.0, cy_px=240.0)
    entry = Detections([[320.0, 280.0, 240.0]], np.eye(3)[None], [4])
    frames = []
    for k, ids in ((0, ()), (1, second)):
        frames.append(
            Frame(
                k,
                float(k),
                np.eye(4),
                k * np.eye(6),
                list(ids),
                np.full((len(ids), 2), 300.0),
                np.tile(np.eye(2), (len(ids), 1, 1)),
                entry if k == entries_at else None,
            )
        )
    return MeasurementStream(Problem(np.eye(4), np.eye(6), camera), tuple(frames))


def test_a_camera_measures_only_landmarks_that_have_entered():
    assert camera_stream(4).frames[0].entries.ids.tolist() == [4]
    with pytest.raises(DataError, match="landmark 5 is measured before it entered"):
        camera_stream(4, 5)
    with pytest.raises(DataError, match="landmark 4 is measured before it entered"):
        camera_stream(4, entries_at=1)


def test_a_landmark_enters_once_and_by_the_entry_sensor():
    stream = camera_stream(4)
    again = dataclasses.replace(stream.frames[1], entries=stream.frames[0].entries)
    with pytest.raises(DataError, match="landmark 4 enters twice"):
        dataclasses.replace(stream, frames=(stream.frames[0], again))
    flat = Detections([[320.0, 240.0]], np.eye(2)[None], [4])
    with pytest.raises(DataError, match="entries of dimension 2 where 3 is needed"):
        dataclasses.replace(
            stream, frames=(dataclasses.replace(stream.frames[0], entries=flat), stream.frames[1])
        )
    planar_entry = dataclasses.replace(frame(0), entries=Detections([[1.0, 0.1]], np.eye(2)[None], [9]))
    with pytest.raises(DataError, match="places a landmark by itself"):
        MeasurementStream(problem(), (planar_entry, frame(1)))


def test_the_digest_covers_entries():
    stream = camera_stream(4)
    moved = Detections([[320.0, 281.0, 240.0]], np.eye(3)[None], [4])
    first = dataclasses.replace(stream.frames[0], entries=moved)
    assert dataclasses.replace(stream, frames=(first, stream.frames[1])).digest != stream.digest
