"""How grader and worker talk: a framed JSON header with the arrays as raw bytes behind it, never pickle.

A frame is ``magic (4 bytes), header length (uint32), body length (uint64), header, body``, little-endian.
In the header an array stands as ``{"a": index}``, a tuple as ``{"t": [...]}``, a dictionary as
``{"d": {...}}``; the body holds the arrays one after another in C order. Sizes are checked against caps
before a byte is allocated.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"SLC1"
PREFIX = struct.Struct("<4sIQ")
HEADER_MAX = 1 << 20
_DEPTH_MAX, _NDIM_MAX, _SIZE_MAX = 32, 8, 1 << 31
_ITEM_BYTES = {"<f8": 8, "<i8": 8, "|b1": 1}


class FrameError(ValueError):
    """The bytes are no frame of this protocol."""


class NotTransferable(TypeError):
    """A value that cannot cross the pipe: not made of arrays, numbers, text and containers of them."""


def encode(message: dict[str, Any]) -> list[bytes | memoryview]:
    """The buffers of a frame, in the order to write them.

    Raises:
        NotTransferable: the message holds something else than the protocol can carry.
    """
    arrays: list[NDArray[Any]] = []
    packed = {key: _pack(value, arrays, 0) for key, value in message.items()}
    packed["arrays"] = [[array.dtype.str, list(array.shape)] for array in arrays]
    header = json.dumps(packed, separators=(",", ":")).encode()
    if len(header) > HEADER_MAX:
        raise NotTransferable(f"too much text or too many numbers outside arrays ({len(header)} bytes)")
    body = sum(array.nbytes for array in arrays)
    buffers: list[bytes | memoryview] = [PREFIX.pack(MAGIC, len(header), body) + header]
    buffers += [array.reshape(-1).view(np.uint8).data for array in arrays if array.nbytes]
    return buffers


def parse_prefix(prefix: bytes, *, body_max: int) -> tuple[int, int]:
    """(header length, body length) of the frame that starts with these bytes.

    Raises:
        FrameError: another magic number, or a length above its cap.
    """
    magic, header, body = PREFIX.unpack(prefix)
    if magic != MAGIC:
        raise FrameError("does not start like an answer")
    if header > HEADER_MAX or body > body_max:
        raise FrameError(f"announces {header} + {body} bytes; {HEADER_MAX} + {body_max} are allowed")
    return header, body


def decode(header: bytes | bytearray, body: bytearray) -> dict[str, Any]:
    """The message of a frame; its arrays share the memory of ``body``.

    Raises:
        FrameError: not what :func:`encode` writes, in any respect.
    """
    try:
        packed = json.loads(header)
        if not isinstance(packed, dict):
            raise FrameError("header is not an object")
        arrays = _arrays(packed.pop("arrays"), body)
        return {key: _unpack(value, arrays, 0) for key, value in packed.items()}
    except FrameError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise FrameError(f"malformed header ({type(error).__name__})") from error


def _pack(value: Any, arrays: list[NDArray[Any]], depth: int) -> Any:
    if depth > _DEPTH_MAX:
        raise NotTransferable("containers nested too deeply")
    if value is None or isinstance(value, bool | int | float | str):
        # Plain types only: a subclass could print itself as it likes.
        for kind in (bool, int, float, str):
            if isinstance(value, kind):
                return kind(value)
        return None
    if isinstance(value, np.generic) and value.dtype.kind in "fiub":
        # Not item(): a long double's is a long double.
        return {"f": float, "b": bool}.get(value.dtype.kind, int)(value)
    if isinstance(value, np.ndarray):
        arrays.append(_plain(value))
        return {"a": len(arrays) - 1}
    # What the containers hold, not what a subclass tells of it: that may have no end.
    if isinstance(value, list):
        return [_pack(item, arrays, depth + 1) for item in list.__iter__(value)]
    if isinstance(value, tuple):
        return {"t": [_pack(item, arrays, depth + 1) for item in tuple.__iter__(value)]}
    if isinstance(value, dict) and all(isinstance(key, str) for key in dict.keys(value)):
        return {"d": {str(key): _pack(item, arrays, depth + 1) for key, item in dict.items(value)}}
    raise NotTransferable(
        f"{type(value).__name__} is not an array, a number, a text, or a list, tuple or dictionary of these"
    )


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    kinds = {"f": "<f8", "i": "<i8", "u": "<i8", "b": "|b1"}
    kind = kinds.get(array.dtype.kind)
    if kind is None or array.ndim > _NDIM_MAX:
        raise NotTransferable(
            f"array of type {array.dtype} with {array.ndim} axes; float, integer or bool with "
            f"at most {_NDIM_MAX} axes is needed (rows of different lengths make an object array)"
        )
    # np.array drops subclasses such as np.matrix and masked arrays.
    return np.array(array, dtype=kind, order="C", copy=None, subok=False)


def _arrays(described: Any, body: bytearray) -> list[NDArray[Any]]:
    arrays, offset = [], 0
    for kind, shape in described:
        if kind not in _ITEM_BYTES or len(shape) > _NDIM_MAX:
            raise FrameError("array of a type or rank that is not allowed")
        if not all(type(size) is int and 0 <= size <= _SIZE_MAX for size in shape):
            raise FrameError("array of an impossible shape")
        count = math.prod(shape)
        if offset + count * _ITEM_BYTES[kind] > len(body):
            raise FrameError("arrays are larger than the body")
        array = np.frombuffer(body, dtype=kind, count=count, offset=offset).reshape(shape)
        if kind == "|b1":
            # Bytes other than 0 and 1 are no booleans to numpy.
            array = np.frombuffer(body, dtype=np.uint8, count=count, offset=offset).reshape(shape) != 0
        arrays.append(array)
        offset += count * _ITEM_BYTES[kind]
    if offset != len(body):
        raise FrameError("body is larger than its arrays")
    return arrays


def _unpack(value: Any, arrays: list[NDArray[Any]], depth: int) -> Any:
    if depth > _DEPTH_MAX:
        raise FrameError("containers nested too deeply")
    if isinstance(value, list):
        return [_unpack(item, arrays, depth + 1) for item in value]
    if not isinstance(value, dict):
        return value
    ((tag, content),) = value.items()
    if tag == "a" and type(content) is int and 0 <= content < len(arrays):
        return arrays[content]
    if tag == "t" and isinstance(content, list):
        return tuple(_unpack(item, arrays, depth + 1) for item in content)
    if tag == "d" and isinstance(content, dict):
        return {key: _unpack(item, arrays, depth + 1) for key, item in content.items()}
    raise FrameError("unknown tag in the header")
