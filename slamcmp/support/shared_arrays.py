"""Arrays that outlive the process that fills them: what a worker had done when it was ended.

They lie in a file without a name that both processes hold open, mapped into memory: filling them costs what
it costs with any array, and nothing is left when the last process closes the file.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import tempfile
from multiprocessing import reduction
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

DIRECTORY_BYTES = 16 * mmap.PAGESIZE
"""At the start of the file: the length of a JSON text and the text, which says where each array lies."""
LENGTH_BYTES = 8
MEMORY_FOLDER = Path("/dev/shm")


class SharedArrays:
    """One process adds arrays and fills them; another, that holds the same file, reads them."""

    def __init__(self, descriptor: int | None = None) -> None:
        """A new file, or the one of that descriptor, which is taken over."""
        self._file: IO[bytes] = _nameless_file() if descriptor is None else os.fdopen(descriptor, "r+b", 0)
        self._end = DIRECTORY_BYTES
        self._directory: dict[str, tuple[int, tuple[int, ...], str]] = {}

    def new(self, name: str, shape: tuple[int, ...], fill: float, dtype: str = "float64") -> NDArray[Any]:
        """A new array; where there is no room for one that is shared, one of this process alone."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size == 0:
            return np.full(shape, fill, dtype=dtype)
        try:
            array = self._mapped(name, shape, dtype, size)
        except (OSError, ValueError, MemoryError):
            return np.full(shape, fill, dtype=dtype)
        array[...] = fill
        return array

    def _mapped(self, name: str, shape: tuple[int, ...], dtype: str, size: int) -> NDArray[Any]:
        directory = {**self._directory, name: (self._end, shape, dtype)}
        text = json.dumps(directory).encode()
        if len(text) + LENGTH_BYTES > DIRECTORY_BYTES:
            raise ValueError("too many arrays")
        whole = -(-size // mmap.PAGESIZE) * mmap.PAGESIZE
        descriptor = self._file.fileno()
        # To write to a mapped page for which the disk has no room would end the process.
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, self._end + whole)
        else:
            os.ftruncate(descriptor, self._end + whole)
        memory = mmap.mmap(descriptor, whole, offset=self._end)
        array = np.frombuffer(memory, dtype=dtype, count=math.prod(shape)).reshape(shape)
        os.pwrite(descriptor, text, LENGTH_BYTES)
        os.pwrite(descriptor, len(text).to_bytes(LENGTH_BYTES, "little"), 0)
        self._directory = directory
        self._end += whole
        return array

    def read(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays that any process has added."""
        descriptor = self._file.fileno()
        length = int.from_bytes(os.pread(descriptor, LENGTH_BYTES, 0), "little")
        found: dict[str, NDArray[Any]] = {}
        # A process may have died while it wrote the directory.
        with contextlib.suppress(ValueError):
            for name, (at, shape, dtype) in json.loads(os.pread(descriptor, length, LENGTH_BYTES)).items():
                size = math.prod(shape) * np.dtype(dtype).itemsize
                found[name] = np.frombuffer(_read(descriptor, size, at), dtype=dtype).reshape(shape).copy()
        return found

    def clear(self) -> None:
        """Begin anew, for another job of the same process; earlier arrays must not be used any more."""
        os.ftruncate(self._file.fileno(), 0)
        self._end, self._directory = DIRECTORY_BYTES, {}

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """For a process that is being started: it gets the open file itself."""
        return _reopened, (reduction.DupFd(self._file.fileno()),)


def _reopened(descriptor: Any) -> SharedArrays:
    return SharedArrays(descriptor.detach())


def _nameless_file() -> IO[bytes]:
    # In memory where the system has a place for it: no disk then ever waits for it.
    for folder in (MEMORY_FOLDER, None):
        with contextlib.suppress(OSError):
            file: IO[bytes] = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115
            return file
    raise OSError(f"no file can be made in {tempfile.gettempdir()}")


def _read(descriptor: int, size: int, at: int) -> bytes:
    parts: list[bytes] = []
    while size > 0:
        part = os.pread(descriptor, min(size, 1 << 30), at)
        if not part:
            raise ValueError("the file ends before its arrays")
        parts.append(part)
        size, at = size - len(part), at + len(part)
    return b"".join(parts)
