"""Whatever bytes a file has, it is read as what it was, refused in one line, or, in a pack, not there.

Thirty examples of each kind run always, ten thousand with ``-m slow``, from a fixed seed. Configurations are
tests/experiment/test_bounds.py's own, here ten thousand times.
"""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import slamcmp
from slamcmp.datasets.graphs.graph_file import graph_file
from slamcmp.datasets.trajectory_files import read_trajectory, write_trajectory
from slamcmp.errors import SlamcmpError
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.grading.hand_in.archive import read_zip
from slamcmp.grading.hand_in.hand_in import SubmissionError
from slamcmp.support.files.packed_files import FOLDER, PackedFiles, content
from slamcmp.support.messages import LIMIT
from slamcmp.types import Trajectory
from tests.experiment import test_bounds

Read = Callable[[Path], object]
COUNTS = [pytest.param(30, id="30"), pytest.param(10_000, id="10000", marks=pytest.mark.slow)]


@st.composite
def spoiling(draw: Any) -> Callable[[bytes], bytes]:
    """One to three of: another byte, a piece cut out, doubled or put elsewhere, the end gone, more behind."""
    kinds = draw(
        st.lists(st.sampled_from(["byte", "cut", "double", "move", "end", "more"]), min_size=1, max_size=3)
    )
    places = [draw(st.tuples(*[st.floats(0, 1, exclude_max=True)] * 3)) for _ in kinds]
    mark = draw(
        st.binary(min_size=1, max_size=8) | st.sampled_from([b"nan", b"1e400", b"-", b"\n", b"\0", b"PK"])
    )

    def spoil(text: bytes) -> bytes:
        for kind, place in zip(kinds, places, strict=True):
            a, b, c = (int(share * (len(text) + 1)) for share in place)
            a, b = min(a, b), max(a, b)
            if kind == "byte":
                text = text[:a] + mark + text[a + len(mark) :]
            elif kind == "cut":
                text = text[:a] + text[b:]
            elif kind == "double":
                text = text[:b] + text[a:b] + text[b:]
            elif kind == "move":
                rest = text[:a] + text[b:]
                text = rest[:c] + text[a:b] + rest[c:]
            elif kind == "end":
                text = text[:a]
            else:
                text = text[:a] + mark + text[a:]
        return text

    return spoil


def stream_file(path: Path) -> Read:
    save_stream(slamcmp.make_stream("circle", steps=6, landmarks=4), path.with_suffix(".npz"))
    path.with_suffix(".npz").replace(path)
    digest = load_stream(path).digest

    def read(spoilt: Path) -> None:
        assert load_stream(spoilt).digest == digest

    return read


def graph(path: Path) -> Read:
    rows = ["#slamcmp-sensor relative_position"] + [
        f"EDGE_SE2 {k} {k + 1} 1 0 0 4 0 0 4 0 9" for k in range(4)
    ]
    rows += [f"EDGE_SE2_XY {k} -7 {2 - k} 3 100 0 100" for k in range(5)]
    path.write_text("\n".join(rows) + "\n")
    return lambda spoilt: graph_file(path=str(spoilt))


def trajectory(format: Any) -> Callable[[Path], Read]:
    def make(path: Path) -> Read:
        T = np.tile(np.eye(4), (6, 1, 1))
        T[:, 0, 3] = np.arange(6)
        write_trajectory(path, Trajectory(100.0 + 0.1 * np.arange(6), T), format)
        return lambda spoilt: read_trajectory(spoilt, format)

    return make


def archive(path: Path) -> Read:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("hand_in/solution.py", "def update(x):\n    return x\n")
        file.writestr("hand_in/notes.txt", "none", zipfile.ZIP_DEFLATED)
    return read_zip


FILES: dict[str, Callable[[Path], Read]] = {
    "stream": stream_file,
    "graph": graph,
    "zip": archive,
    **{name: trajectory(name) for name in ("tum", "kitti", "euroc", "csv", "parquet")},
}


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", FILES)
@pytest.mark.filterwarnings("ignore")
def test_spoilt_files_are_what_they_were_or_refused(tmp_path: Path, kind: str, count: int) -> None:
    path = tmp_path / "file"
    read = FILES[kind](path)
    read(path)
    good = path.read_bytes()

    @settings(max_examples=count, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(spoiling())
    def each(spoil: Callable[[bytes], bytes]) -> None:
        path.write_bytes(spoil(good))
        try:
            read(path)
        except (SlamcmpError, SubmissionError) as error:
            text = str(error)
            assert "\n" not in text
            assert 0 < len(text.encode("utf-8", "backslashreplace")) <= LIMIT

    each()


@pytest.mark.parametrize("count", COUNTS)
def test_a_spoilt_pack_gives_what_was_packed_or_nothing(tmp_path: Path, count: int) -> None:
    root = tmp_path / "whole"
    (root / "runs").mkdir(parents=True)
    made = {f"runs/{i}.npz": bytes([65 + i]) * (40 * i + 3) for i in range(4)}
    for name, text in made.items():
        (root / name).write_bytes(text)
    PackedFiles(root).pack(made)
    (pack,) = (root / FOLDER).glob("*.pack")
    good = pack.read_bytes()

    @settings(max_examples=count, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(spoiling())
    def each(spoil: Callable[[bytes], bytes]) -> None:
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        (copy / FOLDER).mkdir(parents=True)
        (copy / FOLDER / pack.name).write_bytes(spoil(good))
        packs = PackedFiles(copy)
        for name, text in made.items():
            if name in packs.names():
                assert packs.content(name) in (None, text)

    each()
    assert content(root / "runs" / "2.npz") == made["runs/2.npz"]


CONFIGURATIONS: list[tuple[Any, tuple[st.SearchStrategy[Any], ...]]] = [
    (
        test_bounds.test_any_mapping_is_an_experiment_or_one_clear_message,
        (st.dictionaries(st.sampled_from(test_bounds.KEYS), test_bounds.VALUES, max_size=6),),
    ),
    (
        test_bounds.test_any_text_is_an_experiment_or_one_clear_message,
        (st.text(test_bounds.SIGNS, max_size=60), st.booleans()),
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("test", "drawn"), CONFIGURATIONS, ids=["mapping", "text"])
def test_ten_thousand_configurations(test: Any, drawn: tuple[st.SearchStrategy[Any], ...]) -> None:
    everything = settings(
        max_examples=10_000, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    everything(given(*drawn)(test.hypothesis.inner_test))()
