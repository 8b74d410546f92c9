"""Stored streams come back exactly, and damaged files are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.errors import DataError, MissingDataError, StorageError
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, FrontEndReport, MeasurementStream, Problem, RelativePoses
from tests.test_types import camera_stream
from tests.toy_stream import toy_stream


@pytest.fixture
def planar():
    stream, _, _ = toy_stream(frames=12)
    return stream


def spatial_stream():
    generator = np.random.default_rng(1)
    frames = [Frame(0, 0.5, np.eye(4), np.zeros((6, 6)), [], np.empty((0, 3)), np.empty((0, 3, 3)))]
    for k in range(1, 4):
        T = g.exp(generator.uniform(-1, 1, 6))
        frames.append(
            Frame(k, 0.5 + k / 3, T, np.eye(6), [k], generator.normal(size=(1, 3)), np.eye(3)[None])
        )
    kept = tuple(np.array([True, False] * k, dtype=bool) for k in range(4))
    counts = np.array([[2 * k, k, k] for k in range(4)])
    return MeasurementStream(
        Problem(np.eye(4), np.eye(6), RelativePosition(space_dim=3)),
        tuple(frames),
        FrontEndReport(("gate",), counts, kept),
    )


def test_entries_come_back(tmp_path):
    stream = camera_stream(4)
    save_stream(stream, tmp_path / "stream.npz")
    loaded = load_stream(tmp_path / "stream.npz")
    assert loaded.digest == stream.digest
    assert [frame.entries is None for frame in loaded.frames] == [False, True]
    entries = loaded.frames[0].entries
    assert entries.ids.tolist() == [4]
    np.testing.assert_array_equal(entries.z, stream.frames[0].entries.z)
    np.testing.assert_array_equal(entries.R, stream.frames[0].entries.R)


def test_loop_closures_come_back_with_their_frames(tmp_path):
    """Two frames with closures, of two and of one earlier pose: each gets its own."""
    generator = np.random.default_rng(3)

    def related(*frames):
        P = np.stack([np.eye(3) * (1 + k) for k in frames])
        return RelativePoses(frames, g.exp(generator.uniform(-1, 1, (len(frames), 3))), P)

    nothing = [], np.empty((0, 2)), np.empty((0, 2, 2))
    closures = {2: related(0, 1), 4: related(3)}
    frames = [Frame(0, 0.0, np.eye(3), np.zeros((3, 3)), *nothing)]
    for k in range(1, 5):
        Q = np.eye(3)
        frames.append(Frame(k, float(k), np.eye(3), Q, *nothing, relative_poses=closures.get(k)))
    stream = MeasurementStream(Problem(np.eye(3), np.eye(3), RelativePosition()), tuple(frames))
    save_stream(stream, tmp_path / "stream.npz")
    loaded = load_stream(tmp_path / "stream.npz")
    assert loaded.digest == stream.digest
    assert [k for k, frame in enumerate(loaded.frames) if frame.relative_poses is not None] == [2, 4]
    for k, made in closures.items():
        found = loaded.frames[k].relative_poses
        for name in ("frames", "T_earlier_body", "P"):
            np.testing.assert_array_equal(getattr(found, name), getattr(made, name))


def test_round_trip_is_exact(tmp_path, planar):
    for stream in (planar, spatial_stream()):
        path = tmp_path / "stream.npz"
        save_stream(stream, path)
        loaded = load_stream(path)
        assert loaded.digest == stream.digest
        assert loaded.problem.sensor.parameters() == stream.problem.sensor.parameters()
        assert len(loaded.frames) == len(stream.frames)
        for ours, theirs in zip(stream.frames, loaded.frames, strict=True):
            assert (ours.k, ours.t) == (theirs.k, theirs.t)
            for name in ("T_prev_body", "Q", "ids", "z", "R"):
                np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
                assert not getattr(theirs, name).flags.writeable
    np.testing.assert_array_equal(loaded.report.counts, stream.report.counts)
    assert loaded.report.stages == ("gate",)
    assert loaded.report.totals() == {"raw": 12, "gate": 6, "kept": 6}
    for ours, theirs in zip(stream.report.kept, loaded.report.kept, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def rewrite(path, **changes):
    with np.load(path) as stored:
        data = {name: stored[name] for name in stored.files}
    data |= changes
    with path.open("wb") as file:
        np.savez(file, **data)


def test_a_changed_number_is_noticed(tmp_path, planar):
    path = tmp_path / "stream.npz"
    save_stream(planar, path)
    with np.load(path) as stored:
        z = stored["z"].copy()
    z[3, 1] = np.nextafter(z[3, 1], 1)
    rewrite(path, z=z)
    with pytest.raises(DataError, match="was changed after it was written"):
        load_stream(path)


def header(**changes):
    base = {"format": "slamcmp-stream-1", "digest": "0", "sensor": "range_bearing", "parameters": {}}
    return np.frombuffer(json.dumps(base | {"stages": None} | changes).encode(), dtype=np.uint8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"header": header(format="slamcmp-stream-9")}, "slamcmp-stream-9"),
        ({"header": np.frombuffer(b"{", dtype=np.uint8)}, "not a measurement stream"),
        ({"header": np.frombuffer(b"[]", dtype=np.uint8)}, "not a measurement stream"),
        ({"header": header(parameters={"colour": 1})}, "not a measurement stream"),
        ({"t": np.array(["a"])}, "not a measurement stream|stream"),
        ({"size": np.array([1])}, "length that the frames add up to"),
        ({"Q": np.zeros((1, 3, 3))}, "not a measurement stream"),
        ({"z": np.array([{}], dtype=object)}, "not a measurement stream"),
    ],
)
def test_damaged_content_is_refused(tmp_path, planar, changes, message):
    path = tmp_path / "stream.npz"
    save_stream(planar, path)
    rewrite(path, **changes)
    with pytest.raises(DataError, match=message) as raised:
        load_stream(path)
    assert "stream.npz" in str(raised.value) or "length" in message


def test_truncated_and_foreign_files_are_refused(tmp_path, planar):
    path = tmp_path / "stream.npz"
    save_stream(planar, path)
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match=r"stream\.npz"):
            load_stream(path)
    path.write_text("VERTEX_SE2 0 0 0 0\n")
    with pytest.raises(DataError, match="not a measurement stream"):
        load_stream(path)
    with pytest.raises(MissingDataError, match="no such stream file"):
        load_stream(tmp_path / "absent.npz")


def test_every_flipped_byte_is_refused_or_harmless(tmp_path, planar):
    path = tmp_path / "stream.npz"
    save_stream(planar, path)
    whole = bytearray(path.read_bytes())
    generator = np.random.default_rng(2)
    refused = 0
    for position in generator.choice(len(whole), 150, replace=False):
        spoilt = whole.copy()
        spoilt[position] ^= 0xFF
        path.write_bytes(spoilt)
        try:
            assert load_stream(path).digest == planar.digest
        except DataError:
            refused += 1
    assert refused > 100


def test_a_failed_write_leaves_the_old_file(tmp_path, planar, monkeypatch):
    path = tmp_path / "stream.npz"
    save_stream(planar, path)
    before = path.read_bytes()

    def fail(file, **arrays):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(StorageError, match="disk full"):
        save_stream(planar, path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["stream.npz"]
