"""The pipe's language: exact both ways, and deaf to everything else."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slamcmp.grading.sandbox.pipes.protocol import (
    HEADER_MAX,
    MAGIC,
    PREFIX,
    FrameError,
    NotTransferable,
    decode,
    encode,
    parse_prefix,
)


def there_and_back(message: dict[str, Any]) -> dict[str, Any]:
    stream = b"".join(bytes(buffer) for buffer in encode(message))
    header, body = parse_prefix(stream[: PREFIX.size], body_max=1 << 20)
    assert len(stream) == PREFIX.size + header + body
    start = PREFIX.size + header
    return decode(bytearray(stream[PREFIX.size : start]), bytearray(stream[start:]))


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=10,
)
SHAPES = hnp.array_shapes(min_dims=0, max_dims=4, min_side=0)


@given(PLAIN)
@settings(max_examples=200, deadline=None)
def test_plain_values_arrive_as_they_were(value: Any) -> None:
    assert there_and_back({"value": value}) == {"value": value}


@given(hnp.arrays(st.sampled_from([np.float64, np.int64, np.bool_]), SHAPES))
@settings(max_examples=200, deadline=None)
def test_arrays_arrive_bit_for_bit(array: np.ndarray) -> None:
    arrived = there_and_back({"value": [array, {"again": array.T}]})["value"]
    for sent, got in ((array, arrived[0]), (array.T, arrived[1]["again"])):
        assert got.dtype == sent.dtype
        assert got.shape == sent.shape
        assert got.tobytes() == sent.tobytes()


def test_other_numbers_widen() -> None:
    arrived = there_and_back(
        {"f": np.float32([1.5]), "i": np.uint8([[7]]), "s": np.float64(2.5), "b": np.bool_(1)}
    )
    assert arrived["f"].dtype == np.float64
    assert arrived["f"].tolist() == [1.5]
    assert arrived["i"].dtype == np.int64
    assert arrived["i"].tolist() == [[7]]
    assert arrived["s"] == 2.5
    assert arrived["b"] is True


def test_subclasses_arrive_as_plain_values() -> None:
    matrix = np.ma.masked_array([1.0, 2.0], mask=[False, True])
    assert type(there_and_back({"value": matrix})["value"]) is np.ndarray


@pytest.mark.parametrize(
    "value",
    [object(), {1: 2}, {1, 2}, 1j, np.array([1j]), np.array([None]), np.array(["x"]), lambda: 0, b"bytes"],
    ids=["object", "int key", "set", "complex", "complex array", "objects", "texts", "function", "bytes"],
)
def test_the_rest_does_not_cross(value: Any) -> None:
    with pytest.raises(NotTransferable):
        encode({"value": value})


def test_nesting_and_text_are_capped() -> None:
    nested: list[Any] = []
    for _ in range(40):
        nested = [nested]
    with pytest.raises(NotTransferable, match="nested too deeply"):
        encode({"value": nested})
    with pytest.raises(NotTransferable, match="too much text"):
        encode({"value": "x" * HEADER_MAX})


@pytest.mark.parametrize(
    ("magic", "header", "body"),
    [(b"EVIL", 2, 0), (MAGIC, HEADER_MAX + 1, 0), (MAGIC, 2, 1001), (MAGIC, 2, 1 << 63)],
)
def test_a_prefix_out_of_bounds_is_refused(magic: bytes, header: int, body: int) -> None:
    with pytest.raises(FrameError):
        parse_prefix(PREFIX.pack(magic, header, body), body_max=1000)


@pytest.mark.parametrize(
    ("header", "body"),
    [
        (b"", b""),
        (b"\xff\xfe", b""),
        (b"[]", b""),
        (b"{}", b""),
        (b"[" * 100_000, b""),
        (json.dumps({"arrays": [["<f8", [1]]]}).encode(), b""),
        (json.dumps({"arrays": [["<f8", [1]]]}).encode(), bytes(16)),
        (json.dumps({"arrays": [["<f8", [-1]]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [["<f8", [1.0]]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [["<f8", [True]]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [["<f8", [1 << 62, 1 << 62]]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [["<f8", [1 << 62, 0]]]}).encode(), b""),
        (json.dumps({"arrays": [["|O", [1]]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [["<f8", [1] * 9]]}).encode(), bytes(8)),
        (json.dumps({"arrays": [[]]}).encode(), b""),
        (json.dumps({"arrays": 3}).encode(), b""),
        (json.dumps({"arrays": [], "x": {"a": 0}}).encode(), b""),
        (json.dumps({"arrays": [], "x": {"a": -1}}).encode(), b""),
        (json.dumps({"arrays": [], "x": {"t": 1}}).encode(), b""),
        (json.dumps({"arrays": [], "x": {}}).encode(), b""),
        (json.dumps({"arrays": [], "x": {"q": 1}}).encode(), b""),
        (b'{"arrays": [], "x": ' + b"9" * 5000 + b"}", b""),
    ],
)
def test_a_malformed_frame_is_refused(header: bytes, body: bytes) -> None:
    with pytest.raises(FrameError):
        decode(header, bytearray(body))


@given(st.binary(max_size=300), st.binary(max_size=64))
@settings(max_examples=300, deadline=None)
def test_random_bytes_raise_nothing_else(header: bytes, body: bytes) -> None:
    try:
        decode(header, bytearray(body))
    except FrameError:
        return


def test_booleans_are_booleans_whatever_the_bytes() -> None:
    header = json.dumps({"arrays": [["|b1", [3]]], "x": {"a": 0}}).encode()
    arrived = decode(header, bytearray(b"\x00\x01\xff"))["x"]
    assert arrived.view(np.uint8).tolist() == [0, 1, 1]
