"""Arrays of npz files, against numpy's own reader."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
import pytest

from slamcmp.support.files.npz import read_arrays

ARRAYS: dict[str, Any] = {
    "floats": np.arange(12.0).reshape(3, 4),
    "by_columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "none": np.empty((0, 2, 2)),
    "whole": np.array([-1, 2**62]),
    "flags": np.array([True, False]),
    "scalar": np.float64(3.5),
    "text": np.array(["ä", "bc"]),
    "big_endian": np.arange(3.0).astype(">f8"),
    "with/slash": np.ones(1, dtype=np.uint8),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_all_kinds_are_read_as_numpy_reads_them(save: Any) -> None:
    file = io.BytesIO()
    save(file, **ARRAYS)
    found = read_arrays(file.getvalue())
    expected = np.load(io.BytesIO(file.getvalue()))
    assert list(found) == list(expected)
    for name in expected:
        assert found[name].dtype == expected[name].dtype
        np.testing.assert_array_equal(found[name], expected[name])
        assert not found[name].flags.writeable


def test_long_headers_are_read() -> None:
    """Version 2 of the format, for a header of more than 64 kB."""
    kind = np.dtype([(f"a field with a very long name, number {i:05d}" * 3, "f8") for i in range(700)])
    file = io.BytesIO()
    with pytest.warns(UserWarning, match="format 2.0"):
        np.savez(file, wide=np.zeros(2, dtype=kind))
    np.testing.assert_array_equal(read_arrays(file.getvalue())["wide"], np.zeros(2, dtype=kind))


def test_objects_and_other_members_are_refused() -> None:
    file = io.BytesIO()
    np.savez(file, bad=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="objects"):
        read_arrays(file.getvalue())
    with zipfile.ZipFile(other := io.BytesIO(), "w") as archive:
        archive.writestr("x.npy", b"no array at all")
    with pytest.raises(ValueError, match="no array"):
        read_arrays(other.getvalue())


def test_every_cut_and_flipped_byte_is_noticed_or_harmless() -> None:
    file = io.BytesIO()
    np.savez(file, a=np.arange(5.0), b=np.arange(3))
    whole = file.getvalue()
    for at in range(0, len(whole), 3):
        for spoilt in (whole[:at], whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]):
            try:
                found = read_arrays(spoilt)
            except Exception:
                continue
            for name, array in found.items():
                if name in ("a", "b"):
                    np.testing.assert_array_equal(array, {"a": np.arange(5.0), "b": np.arange(3)}[name])
