"""Whatever a name or a file is: a log, or one line that says what is wrong with it."""

from __future__ import annotations

import contextlib
import copy
import json
import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.images.calibration_file import read_calibration
from slamcmp.datasets.plain.plain_recording import recording
from slamcmp.datasets.trajectories import poses_from
from slamcmp.errors import DataError, MissingDataError, SlamcmpError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.image_files import read_image
from tests.datasets.plain_drive import Drive

SOURCES = {
    "graph_file": "path: {}",
    "recording": "odometry: {}",
    "kitti_odometry": "folder: {}",
    "tum_rgbd": "folder: {}",
    "euroc": "folder: {}",
    "seven_scenes": "folder: {}",
    "image_folder": "folder: {}, rate_hz: 1.0",
}


@pytest.mark.parametrize("name", ["~nobody.of.that.name/x.g2o", "a" * 5000, "a/" * 3000, "."])
@pytest.mark.parametrize("source", list(SOURCES))
def test_names_that_no_file_has(tmp_path: Path, source: str, name: str) -> None:
    front_end = "labelled" if source in ("graph_file", "recording") else "tracked_features"
    (tmp_path / "e.yaml").write_text(
        f"source: {{name: {source}, {SOURCES[source].format(name)}}}\n"
        f"front_end: {{name: {front_end}}}\nback_ends: [{{name: dead_reckoning}}]\n"
    )
    with pytest.raises(MissingDataError) as caught:
        make_trials(load_experiment(tmp_path / "e.yaml"))
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file that cannot be read is Linux's here")
def test_files_that_cannot_be_read() -> None:
    for reader in (lambda path: graph_file(path=path), lambda path: read_image(Path(path))):
        with pytest.raises(MissingDataError, match=r"/proc/self/mem.* cannot be read"):
            reader("/proc/self/mem")


def test_numbers_beyond_all_measure(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(f"width_px: {'9' * 5000}\n")
    with pytest.raises(DataError, match=r"c\.yaml: not valid YAML"):
        read_calibration(tmp_path / "c.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DataError, match="quaternion of norm 1e"):
            poses_from(Path("poses.txt"), np.zeros((1, 3)), np.array([[0.0, 0.0, 1e300, 1.0]]))


def spoilt(text: bytes, rng: random.Random) -> bytes:
    """One of the ways in which files go wrong."""
    lines = text.split(b"\n")
    row = rng.randrange(len(lines))
    fields = re.split(rb"([ ,]+)", lines[row])
    field = rng.randrange(0, len(fields), 2)
    kind = rng.randrange(12)
    if kind == 0:
        return text[: rng.randrange(len(text))]
    if kind == 1:
        return bytes(rng.randrange(256) if rng.random() < 0.002 else byte for byte in text)
    if kind == 2:
        rng.shuffle(lines)
    elif kind == 3:
        lines[row] = lines[rng.randrange(len(lines))]
    elif kind == 4:
        del lines[row]
    else:
        numbers = [b"nan", b"1e400", b"1e300", b"-0", b"1_0", b"9223372036854775808", b"9" * 5000]
        fields[field] = rng.choice([*numbers, b'"', b"[" * 400, b"7 7", b"", b"-" + fields[field]])
        lines[row] = b"".join(fields)
    return b"\n".join(lines)


def plain(folder: Path) -> Callable[[], object]:
    files = Drive(seconds=8.0).write(folder)
    paths = {name: str(path) for name, path in files.items()}
    return lambda: recording(0, **paths, range_sigma_m=0.05, bearing_sigma_rad=0.01)


def graph(folder: Path) -> Callable[[], object]:
    rows = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(8)] + ["FIX 0"]
    rows += [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 400" for k in range(7)]
    rows += [f"EDGE_SE2_XY {k} 50 {2 - k} 3 100 0 100" for k in range(8)]
    (folder / "own.g2o").write_text("\n".join(rows) + "\n")
    return lambda: graph_file(path=str(folder / "own.g2o"))


@pytest.mark.parametrize("make", [plain, graph])
def test_spoilt_files_are_read_or_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Callable[[], object]]
) -> None:
    read = make(tmp_path)
    read()
    rng = random.Random(make.__name__)
    refused = []
    for path in sorted(tmp_path.iterdir()):
        good = path.read_bytes()
        for _ in range(60):
            path.write_bytes(spoilt(good, rng))
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    read()
                except SlamcmpError as error:
                    refused.append(str(error))
        path.write_bytes(good)
    assert len(refused) > 30
    assert [text for text in refused if "\n" in text] == []


CALIBRATIONS: list[dict[str, Any]] = [
    {"camera": "mono", "image_size": [640, 480], "intrinsics": [500.0, 500.0, 320.0, 240.0]}
    | {
        "lens": "radial-tangential",
        "distortion": [-0.1, 0.01, 0, 0],
        "T_body_camera": np.eye(4).ravel().tolist(),
    },
    {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [500.0, 500.0, 320.0, 240.0],
            "resolution": [640, 480],
        }
        | {"distortion_model": "radtan", "distortion_coeffs": [0, 0, 0, 0]}
    },
]
VALUES: list[Any] = [
    *(None, "x", "", [], {}, True, -1, 0, np.inf, np.nan, 1e300, [[1]], [None], ["a"], {"a": 1}, 10**30),
    *(
        [1] * 4,
        [0] * 4,
        [1e300] * 4,
        [10**30] * 2,
        [0] * 16,
        [1e200] * 16,
        [640.5, 480],
        [0, 0],
        [10**6, 10**6],
    ),
]


@pytest.mark.parametrize("good", CALIBRATIONS, ids=["own", "kalibr"])
def test_calibrations_with_values_of_any_kind(tmp_path: Path, good: dict[str, Any]) -> None:
    path = tmp_path / "c.yaml"
    refused = 0
    for within in ((), *((name,) for name, value in good.items() if isinstance(value, dict))):
        for name in good[within[0]] if within else good:
            for value in VALUES:
                wrong = copy.deepcopy(good)
                (wrong[within[0]] if within else wrong)[name] = value
                path.write_text(json.dumps(wrong).replace("Infinity", ".inf").replace("NaN", ".nan"))
                with warnings.catch_warnings(), contextlib.suppress(DataError):
                    warnings.simplefilter("error")
                    read_calibration(path)
                    continue
                refused += 1
    assert refused > 100
