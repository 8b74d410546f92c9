"""The program on a GPU: a block a run, its state in shared memory, all runs in one launch.

Sums are per batch of seeds as on the CPU, but in the order in which blocks end: their last bits differ from
launch to launch. Scores do not.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import cuda, float64, int64

from slamcmp.ensembles.kernels.program import run
from slamcmp.ensembles.kernels.settings import SCORES
from slamcmp.types.arrays import FloatArray, IntArray

THREADS = 64
"""Of a block: as many as P has columns, or so."""
BLOCKS = 4096
"""At most; each takes one run after the other."""


@functools.cache
def kernel(count: int, most: int) -> Any:
    """The kernel for so many landmarks, ``most`` of them in sight at once: sizes of arrays are constants."""
    n, k, rows = 3 + 2 * count, 2 * most, max(2 * most, 2)
    columns = n + 1

    @cuda.jit
    def entry(  # type: ignore[no-untyped-def]
        first, seeds, numbers, options, path, controls, given, batches, together, scores, curves, failed, log
    ):
        P = cuda.shared.array((n, n), float64)
        W = cuda.shared.array((k, columns), float64)
        S = cuda.shared.array((k, k), float64)
        H = cuda.shared.array((rows, 5), float64)
        dx = cuda.shared.array(n, float64)
        landmarks = cuda.shared.array((count, 2), float64)
        points = cuda.shared.array((count, 2), float64)
        truth = cuda.shared.array((count, 2), float64)
        z = cuda.shared.array((count, 2), float64)
        visible = cuda.shared.array(count, int64)
        places = cuda.shared.array(count, int64)
        order = cuda.shared.array(count, int64)
        states = cuda.shared.array(count, int64)
        pose = cuda.local.array(4, float64)
        last = cuda.local.array(4, float64)
        memory = cuda.local.array(4, float64)
        start = cuda.local.array(2, float64)
        Q = cuda.local.array((3, 3), float64)
        noise = cuda.local.array((3, 3), float64)
        G = cuda.local.array((2, 3), float64)
        N = cuda.local.array((2, 2), float64)
        of_pose = cuda.local.array((3, 3), float64)
        of_frame = cuda.local.array(SCORES, float64)
        for i in range(cuda.blockIdx.x, seeds, cuda.gridDim.x):
            seed = first + i
            end = run(
                seed,
                numbers,
                options,
                path,
                controls,
                given,
                (P, W, S, H, dx, landmarks, points, truth, z),
                (visible, places, order, states),
                (pose, last, memory, start, Q, noise, G, N, of_pose, of_frame),
                scores[i],
                curves[(seed // together) % batches],
                False,
                log,
            )
            if cuda.threadIdx.x == 0:
                failed[i] = end
            cuda.syncthreads()

    return entry


def launch(
    first: int,
    seeds: int,
    numbers: FloatArray,
    options: IntArray,
    path: FloatArray,
    controls: FloatArray,
    landmarks: FloatArray,
    most: int,
    batches: int,
    together: int,
    threads: int = THREADS,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Runs of ``seeds`` seeds from ``first`` on; ``together`` in a row belong to one batch.

    Returns:
        Scores (seeds, 5), sums of the curves (batches, K, 2), frames of failure (seeds,), and runs in each
        batch's sums. A failed run leaves part of itself in its batch: where there is one, the sums are NaN.
    """
    frames = len(path)
    scores, failed = np.zeros((seeds, SCORES)), np.zeros(seeds, dtype=np.int64)
    curves = np.zeros((batches, frames, 2))
    nothing = tuple(
        cuda.to_device(np.zeros(shape))
        for shape in ((1, 4), (1, 3, 3), (1, 1), (1, 1, 2), (1, 4), (1, 3, 3), (1, 2), (1,))
    )
    on_device = [cuda.to_device(each) for each in (numbers, options, path, controls, landmarks)]
    d_scores, d_curves, d_failed = cuda.to_device(scores), cuda.to_device(curves), cuda.to_device(failed)
    entry = kernel(len(landmarks), most)
    entry[min(seeds, BLOCKS), threads](
        first, seeds, *on_device, batches, together, d_scores, d_curves, d_failed, nothing
    )
    d_scores.copy_to_host(scores)
    d_curves.copy_to_host(curves)
    d_failed.copy_to_host(failed)
    batch = (np.arange(first, first + seeds) // together) % batches
    counts = np.bincount(batch[failed < 0], minlength=batches)
    curves[np.unique(batch[failed >= 0])] = np.nan
    return scores, curves, failed, counts
