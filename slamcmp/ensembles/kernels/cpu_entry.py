"""The program on a core: runs one after the other."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numba as nb
import numpy as np

from slamcmp.ensembles.kernels.program import run
from slamcmp.ensembles.kernels.settings import SCORES
from slamcmp.types.arrays import FloatArray, IntArray


@nb.njit(  # type: ignore[untyped-decorator]
    error_model="numpy", fastmath={"contract"}, cache=True, nogil=True
)
def entry(
    seeds: IntArray,
    numbers: FloatArray,
    options: IntArray,
    path: FloatArray,
    controls: FloatArray,
    landmarks: FloatArray,
    most: int,
    scores: FloatArray,
    curves: FloatArray,
    failed: IntArray,
    keep: bool,
    log: tuple[FloatArray, ...],
) -> None:
    """Runs of these seeds: scores (runs, 5), curves (K, 2) summed over them, and frames of failure (runs,).

    ``most`` is the largest number of landmarks seen at once. With ``keep`` the log (program.run) is of the
    last run.
    """
    count = len(landmarks)
    n, k = 3 + 2 * count, 2 * most
    shared = (
        np.empty((n, n)),
        np.empty((k, n + 1)),
        np.empty((k, k)),
        np.empty((max(k, 2), 5)),
        np.empty(n),
        np.empty((count, 2)),
        np.empty((count, 2)),
        np.empty((count, 2)),
        np.empty((count, 2)),
    )
    marks = (
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
    )
    own = (
        np.empty(4),
        np.empty(4),
        np.empty(4),
        np.empty(2),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((2, 3)),
        np.empty((2, 2)),
        np.empty((3, 3)),
        np.empty(SCORES),
    )
    sums = np.empty_like(curves)
    for i in range(len(seeds)):
        sums[:] = 0.0
        failed[i] = run(
            seeds[i],
            numbers,
            options,
            path,
            controls,
            landmarks,
            shared,
            marks,
            own,
            scores[i],
            sums,
            keep,
            log,
        )
        if failed[i] < 0:
            curves += sums


def _know_by_all_sources() -> None:
    """Numba knows what it has kept by this file alone; a change in another body has to count too."""
    texts = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
    kept: Any = getattr(getattr(entry, "_cache", None), "_cache_file", None)
    if hasattr(kept, "_source_stamp"):
        kept._source_stamp = hashlib.sha256(b"".join(texts)).hexdigest()


_know_by_all_sources()
