"""Store a measurement stream as npz and load it back to the same digest (no pickle)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError, MissingDataError
from slamcmp.models.sensors import make_sensor
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.npz import read_arrays
from slamcmp.support.files.packed_files import content, is_there
from slamcmp.support.messages import told
from slamcmp.types import Detections, FrontEndReport, MeasurementStream, Problem, RelativePoses
from slamcmp.types.columns import Columns, columns_of, parts
from slamcmp.types.stream import frames_of

FORMAT = "slamcmp-stream-1"
AnyArray = NDArray[Any]


def save_stream(stream: MeasurementStream, path: Path | str) -> None:
    """Write the stream to ``path`` atomically (an interrupted write leaves the old file).

    Raises:
        StorageError: the disk is full or the folder cannot be written.
    """
    path = Path(path)
    frames, sensor = stream.frames, stream.problem.sensor
    header = {
        "format": FORMAT,
        "digest": stream.digest,
        "sensor": sensor.name,
        "parameters": dict(sensor.parameters()),
        "stages": None if stream.report is None else list(stream.report.stages),
        "events": {} if stream.report is None else dict(stream.report.events),
        "warnings": [] if stream.report is None else list(stream.report.warnings),
    }
    columns = columns_of(frames)
    arrays: dict[str, Any] = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "prior_T": stream.problem.T_world_body,
        "prior_P": stream.problem.P,
        "t": columns.t,
        "T_prev_body": columns.T_prev_body,
        "Q": columns.Q,
        "size": columns.sizes,
        "ids": columns.ids,
        "z": columns.z,
        "R": columns.R,
    }
    entering = [frame for frame in frames if frame.entries is not None]
    if entering:
        entries = [frame.entries for frame in entering if frame.entries is not None]
        arrays["entry_frame"] = np.array([frame.k for frame in entering])
        arrays["entry_size"] = np.array([each.ids.size for each in entries])
        arrays["entry_ids"] = np.concatenate([each.ids for each in entries])
        arrays["entry_z"] = np.concatenate([each.z for each in entries])
        arrays["entry_R"] = np.concatenate([each.R for each in entries])
    related = [(frame.k, each) for frame in frames if (each := frame.relative_poses) is not None]
    if related:
        arrays["related_frame"] = np.array([k for k, _ in related])
        arrays["related_size"] = np.array([each.frames.size for _, each in related])
        arrays["related_to"] = np.concatenate([each.frames for _, each in related])
        arrays["related_T"] = np.concatenate([each.T_earlier_body for _, each in related])
        arrays["related_P"] = np.concatenate([each.P for _, each in related])
    if stream.report is not None:
        arrays["counts"] = stream.report.counts
        arrays["kept_size"] = np.array([mask.size for mask in stream.report.kept])
        arrays["kept"] = np.concatenate(stream.report.kept)
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def load_stream(path: Path | str) -> MeasurementStream:
    """Read a stream and check that its content still has the digest it was stored with.

    Raises:
        MissingDataError: there is no such file.
        DataError: the file is not a stream, is damaged, or its content does not match its digest.
    """
    path = Path(path)
    if not is_there(path):
        raise MissingDataError(f"{path}: there is no such stream file")
    try:
        data = read_arrays(content(path))
        header = json.loads(data["header"].tobytes().decode())
        if header["format"] != FORMAT:
            raise DataError(f"{path}: format {header['format']!r} where {FORMAT!r} is needed")
        stream = _rebuild(header, data)
    except DataError:
        raise
    except Exception as error:
        # A spoilt byte surfaces as whatever zipfile, zlib, json or numpy meet first: zlib.error, BadZipFile,
        # NotImplementedError (an unknown compression), RuntimeError ("encrypted"), IndexError and more.
        what = told(f"{type(error).__name__}: {error}", 300)
        raise DataError(
            f"{path}: not a measurement stream, or damaged ({what}); write one with 'slamcmp stream save'"
        ) from error
    if stream.digest != header["digest"]:
        raise DataError(
            f"{path}: the content's digest {stream.digest[:12]}… is not the stored "
            f"{header['digest'][:12]}…: the file was changed after it was written"
        )
    return stream


def _rebuild(header: dict[str, Any], data: dict[str, Any]) -> MeasurementStream:
    if len(data["ids"]) != data["size"].sum():
        raise DataError("the observation arrays do not have the length that the frames add up to")
    columns = Columns(
        np.arange(data["size"].size),
        *(data[name] for name in ("t", "T_prev_body", "Q", "size", "ids", "z", "R")),
    )
    frames = frames_of(columns, _entries(data), _relative_poses(data))
    report = None
    if header["stages"] is not None:
        kept = parts(data["kept"], data["kept_size"])
        # Streams stored before there were events have none.
        report = FrontEndReport(
            tuple(header["stages"]),
            data["counts"],
            tuple(kept),
            header.get("events", {}),
            warnings=tuple(header.get("warnings", ())),
        )
    sensor = make_sensor(header["sensor"], header["parameters"])
    return MeasurementStream(Problem(data["prior_T"], data["prior_P"], sensor), frames, report)


def _alone(part: AnyArray) -> AnyArray:
    """A copy that cannot be written to either."""
    part = part.copy()
    part.flags.writeable = False
    return part


def _entries(data: dict[str, Any]) -> dict[int, Detections]:
    """The landmarks that enter, by frame."""
    if "entry_frame" not in data:
        return {}
    ends = np.cumsum(data["entry_size"])
    if len(data["entry_ids"]) != ends[-1]:
        raise DataError("the entries do not have the length that their frames add up to")
    return {
        k: Detections(*(_alone(data[f"entry_{name}"][b - m : b]) for name in ("z", "R", "ids")))
        for k, m, b in zip(
            data["entry_frame"].tolist(), data["entry_size"].tolist(), ends.tolist(), strict=True
        )
    }


def _relative_poses(data: dict[str, Any]) -> dict[int, RelativePoses]:
    """Loop closures, by frame."""
    if "related_frame" not in data:
        return {}
    ends = np.cumsum(data["related_size"])
    if len(data["related_to"]) != ends[-1]:
        raise DataError("the relative poses do not have the length that their frames add up to")
    return {
        k: RelativePoses(
            _alone(data["related_to"][b - m : b]),
            _alone(data["related_T"][b - m : b]),
            _alone(data["related_P"][b - m : b]),
        )
        for k, m, b in zip(
            data["related_frame"].tolist(), data["related_size"].tolist(), ends.tolist(), strict=True
        )
    }
