"""Text files as they come from other systems: marks, encodings, line ends, and numbers as C reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp.datasets.folders import number_table, text_rows
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.images.yaml_file import read_mapping
from slamcmp.datasets.text import ends_in_a_line, fields_of, number, read_text, text_lines, whole
from slamcmp.datasets.trajectories import read_kitti_poses, read_tum_trajectory
from slamcmp.errors import DataError

ENCODINGS = {
    "plain": lambda text: text.encode(),
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16, big end first": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "Latin-1": lambda text: text.encode("latin-1"),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "mark, Latin-1 and CRLF": lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode("latin-1"),
}

# The comment has a letter and, in Latin-1, the byte 0x85, at which Python's splitlines ends a line.
COMMENT = "# Messfahrt bei Tür 5 \x85 12 m\n"
POSES = COMMENT + "0.5 1 2 3 0 0 0 1\n1.5 4 5 6 0 0 0 1\n"
GRAPH = COMMENT + "VERTEX_SE2 0 5 6 1.5\nEDGE_SE2 0 1 1 0 0 4 0 0 4 0 4\nEDGE_SE2_XY 1 7 1 2 4 0 4\n"
MATRIX = COMMENT + "1 0 0 5 0 1 0 6 0 0 1 7\n"
SHEET = "# Tür 5\n" + "camera: mono\nintrinsics: [1, 2, 3, 4]\n"


@pytest.mark.parametrize("encode", ENCODINGS.values(), ids=ENCODINGS.keys())
def test_every_reader_takes_every_encoding(tmp_path: Path, encode) -> None:
    path = tmp_path / "file.txt"

    def put(text: str) -> Path:
        path.write_bytes(encode(text))
        return path

    stamps, poses = read_tum_trajectory(put(POSES))
    assert stamps.tolist() == [0.5, 1.5]
    assert poses[:, :3, 3].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read_kitti_poses(put(MATRIX))[0, :3, 3].tolist() == [5, 6, 7]
    graph = read_graph(put(GRAPH))
    assert graph.poses[0][:2, 2].tolist() == [5, 6]
    assert [(edge.pose, edge.landmark) for edge in graph.landmark_edges] == [(1, 7)]
    assert graph.landmark_edges[0].where == f"{path}:4"
    assert graph.warnings == []
    assert read_mapping(put(SHEET))["intrinsics"] == [1, 2, 3, 4]
    assert [fields for _, fields in text_rows(put("# t,name\n0.1,a.png\n"), 2)] == [["0.1", "a.png"]]
    np.testing.assert_array_equal(number_table(put("1 2\n3 4\n"), 2), [[1, 2], [3, 4]])


def test_what_is_no_text_is_said_to_be_none(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    for raw in (b"\xff\xfe\x00", b"12 \x00 3", b"\xfe\xff\xd8\x00"):
        path.write_bytes(raw)
        with pytest.raises(DataError, match=r"file\.txt: not a text file"):
            read_text(path)


def test_lines_end_at_line_breaks_only(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_bytes("a\x0bb\x0cc\n\nd\u2028e\r\nf".encode())
    assert text_lines(path) == ["a\x0bb\x0cc", "", "d\u2028e", "f"]
    assert not ends_in_a_line(path)
    assert fields_of("a\x0bb\x0cc \t d\u00a0e") == ["a", "b", "c", "d\u00a0e"]
    path.write_bytes(b"a\r")
    assert text_lines(path) == ["a"]
    assert ends_in_a_line(path)


@pytest.mark.parametrize("text", ["1", "+1", "-1.5", "1.", ".5", "1e5", "1E-05", "-.5e+3", "007"])
def test_numbers_as_c_writes_them(text: str) -> None:
    assert number("here", text) == float(text)


@pytest.mark.parametrize(
    "text",
    ["1_0", "1_0.5", "0x10", "0x1p3", "inf", "-Infinity", "nan", "NAN(1)", "١٢", "１", "1e", "1.5e-", "-",
     ".", "+-1", "1,5", "1d5", "1e400", "--1", "", "1\u00a0", "−1", "True"],
)  # fmt: skip
def test_what_is_no_number(tmp_path: Path, text: str) -> None:
    with pytest.raises(DataError, match=r"^here: .* is not a finite number"):
        number("here", text)
    path = tmp_path / "table.txt"
    path.write_text(f"2 3\n{text} 4\n")
    if text:
        with pytest.raises(DataError, match=r"table\.txt:2: "):
            number_table(path, 2, exactly=True)


@pytest.mark.parametrize("text", ["0", "-1", "+7", "007", "-9223372036854775808", "9223372036854775807"])
def test_ids_have_64_bits_and_a_sign(text: str) -> None:
    assert whole("here", text) == int(text)


@pytest.mark.parametrize(
    "text",
    ["1_0", "1.0", "1e3", "0x1", "٣", "x1", "-", "9223372036854775808", "-9223372036854775809", "9" * 5000],
)
def test_what_is_no_id(text: str) -> None:
    with pytest.raises(DataError, match=r"^here: .* is not an id") as raised:
        whole("here", text)
    assert len(str(raised.value)) < 200
