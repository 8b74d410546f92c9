"""Run an ensemble: every filter on the same seeds, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

import numpy as np

from slamcmp.ensembles import targets
from slamcmp.ensembles.kernels import settings as at
from slamcmp.ensembles.outcome import BATCHES, BLOCK, Ensemble, FilterRuns
from slamcmp.ensembles.problem import EnsembleFilter, EnsembleProblem
from slamcmp.ensembles.sample import deviation, sample_run
from slamcmp.support.cores import available_cores
from slamcmp.types import FloatArray

STEP = BLOCK * BATCHES
"""Seeds that every filter has done before any goes on: what an interruption leaves is paired."""
ON_GPU = 20 * STEP
Progress = Callable[[str, int, int], None]


def ensemble_in_steps(
    problem: EnsembleProblem,
    seeds: int,
    *,
    target: targets.Target = "cpu",
    workers: int | None = None,
    compared: int = 2,
    before: Ensemble | None = None,
    progress: Progress | None = None,
) -> Iterator[Ensemble]:
    """Every filter of a problem on the seeds 0 to ``seeds - 1``; the same noise for all.

    Each step gives what is known so far, of as many runs of one filter as of another; the last one is the
    whole.

    Args:
        problem: of :func:`slamcmp.ensembles.problem.ensemble_problem`.
        seeds: runs of each filter.
        target: "cpu" or "cuda".
        workers: threads on the CPU; default: one a core. They change no number.
        compared: so many runs of each filter are repeated by the ordinary back ends.
        before: the runs to go on from.
        progress: called with a label, runs done and runs wanted.

    Raises:
        UsageError: the target is not there.
    """
    targets.load(target)
    found = before
    if found is None or len(found.deviations) < len(problem.filters):
        deviations = {
            each.label: max(deviation(sample_run(problem, each, seed), each) for seed in range(compared))
            for each in problem.filters
            if compared
        }
        runs = () if found is None else found.runs
        found = Ensemble(problem, runs, deviations)
    if found.runs and found.seeds >= seeds:
        yield found
        return
    while found.seeds < seeds:
        first = found.seeds
        last = min(seeds, first - first % STEP + (ON_GPU if target == "cuda" else STEP))
        more: list[FilterRuns] = []
        for which in problem.filters:
            tell = None if progress is None else _told(progress, which.label, first, seeds)
            if target == "cuda":
                more.append(_on_gpu(problem, which, first, last, tell))
            else:
                more.append(_on_cores(problem, which, first, last, workers or available_cores(), tell))
        found = found.with_more(tuple(more))
        yield found


def run_ensemble(problem: EnsembleProblem, seeds: int, *, workers: int | None = None) -> Ensemble:
    """The whole at once, on the CPU: see :func:`ensemble_in_steps`."""
    *_, found = ensemble_in_steps(problem, seeds, workers=workers)
    return found


def _told(progress: Progress, label: str, first: int, wanted: int) -> Callable[[int], None]:
    return lambda done: progress(label, first + done, wanted)


def _on_cores(
    problem: EnsembleProblem,
    which: EnsembleFilter,
    first: int,
    last: int,
    workers: int,
    tell: Callable[[int], None] | None,
) -> FilterRuns:
    """Blocks of seeds on threads: compiled code holds no lock of Python's."""
    entry = targets.load("cpu").entry
    frames, count = len(problem.path), last - first
    scores, failed = np.empty((count, at.SCORES)), np.empty(count, dtype=np.int64)
    curves, counts = np.zeros((BATCHES, frames, 2)), np.zeros(BATCHES, dtype=np.int64)
    nothing = _no_log()

    def block(start: int) -> tuple[int, FloatArray]:
        of_block = slice(start - first, min(start - first + BLOCK, count))
        sums = np.zeros((frames, 2))
        entry(
            np.arange(start, first + of_block.stop, dtype=np.int64),
            problem.numbers,
            which.options,
            problem.path,
            problem.controls,
            problem.landmarks,
            problem.most,
            scores[of_block],
            sums,
            failed[of_block],
            False,
            nothing,
        )
        return start, sums

    # In their order whatever ends first: sums of floating-point numbers depend on it.
    waiting: dict[int, FloatArray] = {}
    following = first
    starts = range(first, last, BLOCK)
    with ThreadPoolExecutor(workers) as pool:
        for start, sums in _as_they_come(pool, block, starts, 2 * workers):
            waiting[start] = sums
            while following in waiting:
                batch = following // BLOCK % BATCHES
                curves[batch] += waiting.pop(following)
                of_block = failed[following - first : following - first + BLOCK]
                counts[batch] += int((of_block < 0).sum())
                following += BLOCK
            if tell is not None:
                tell(min(following - first, count))
    return FilterRuns(which.label, scores, curves, counts, failed)


def _as_they_come(
    pool: ThreadPoolExecutor,
    block: Callable[[int], tuple[int, FloatArray]],
    firsts: Sequence[int],
    ahead: int,
) -> Iterator[tuple[int, FloatArray]]:
    """Results in the order of their ends, few submitted at a time: Ctrl-C then waits for these alone."""
    left = iter(firsts)
    running: set[Future[tuple[int, FloatArray]]] = set()
    try:
        while True:
            while len(running) < ahead and (first := next(left, None)) is not None:
                running.add(pool.submit(block, first))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                yield each.result()
    finally:
        for each in running:
            each.cancel()


def _on_gpu(
    problem: EnsembleProblem,
    which: EnsembleFilter,
    first: int,
    last: int,
    tell: Callable[[int], None] | None,
) -> FilterRuns:
    """These seeds in one launch, a block a run."""
    scores, curves, failed, counts = targets.load("cuda").launch(
        first,
        last - first,
        problem.numbers,
        which.options,
        problem.path,
        problem.controls,
        problem.landmarks,
        problem.most,
        BATCHES,
        BLOCK,
    )
    if tell is not None:
        tell(last - first)
    return FilterRuns(which.label, scores, curves, counts, failed)


def _no_log() -> tuple[FloatArray, ...]:
    shapes = ((0, 4), (0, 3, 3), (0, 0), (0, 0, 2), (0, 4), (0, 3, 3), (0, 2), (0,))
    return tuple(np.zeros(shape) for shape in shapes)
