"""Single runs of an ensemble as ordinary streams, and what ordinary back ends make of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.ensembles import targets
from slamcmp.ensembles.kernels import settings as at
from slamcmp.ensembles.problem import EnsembleFilter, EnsembleProblem
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.models.sensors import make_sensor
from slamcmp.protocols import BackEnd
from slamcmp.types import (
    BoolArray,
    FloatArray,
    Frame,
    GroundTruth,
    MeasurementStream,
    Problem,
)


@dataclass(frozen=True)
class SampleRun:
    """One run as the program made it."""

    seed: int
    stream: MeasurementStream
    truth: GroundTruth
    T_world_body: FloatArray
    """What the filter answered, (K, 3, 3)."""
    P: FloatArray
    """Its covariances in the body tangent, (K, 3, 3)."""
    failed_at: int
    """The frame at which the filter gave up; -1: it did not."""


def sample_run(problem: EnsembleProblem, which: EnsembleFilter, seed: int) -> SampleRun:
    """The run of that seed, with everything that went into it; the same stream for every filter.

    Raises:
        UsageError: numba is not installed.
    """
    frames, count = len(problem.path), len(problem.landmarks)
    increments, Q = np.zeros((frames, 4)), np.zeros((frames, 3, 3))
    seen, z = np.zeros((frames, count)), np.zeros((frames, count, 2))
    poses, P, landmarks, start = (
        np.zeros((frames, 4)),
        np.zeros((frames, 3, 3)),
        np.zeros((count, 2)),
        np.zeros(4),
    )
    failed = np.zeros(1, dtype=np.int64)
    targets.load("cpu").entry(
        np.array([seed], dtype=np.int64),
        problem.numbers,
        which.options,
        problem.path,
        problem.controls,
        problem.landmarks,
        problem.most,
        np.zeros((1, at.SCORES)),
        np.zeros((frames, 2)),
        failed,
        True,
        (increments, Q, seen, z, poses, P, landmarks, start),
    )
    increments[0] = 1.0, 0.0, 0.0, 0.0
    t = np.arange(frames) * problem.numbers[at.TIME_STEP]
    truth = GroundTruth(t, _matrices(problem.path), np.arange(count), landmarks)
    stream = _stream(problem, t, _matrices(increments), Q, seen > 0, z, _matrices(start[None])[0])
    return SampleRun(seed, stream, truth, _matrices(poses), P, int(failed[0]))


def deviation(sample: SampleRun, which: EnsembleFilter) -> float:
    """The largest difference to the ordinary back end on the same stream.

    Of poses in metres (and of their rotations' entries), of covariances relative to the largest of the frame.
    """
    plugin = which.component.plugin()
    told = [sample.truth] if plugin.traits.get("needs_truth") else []
    arguments = which.component.arguments()

    def make(problem: Problem) -> BackEnd:
        made: BackEnd = plugin.target(problem, *told, **arguments)
        return made

    run = run_back_end(make, sample.stream, label=which.label, parameters=arguments, seed=sample.seed)
    done = min(len(run.online.T_world_body), len(sample.P) if sample.failed_at < 0 else sample.failed_at)
    if (run.status == "ok") != (sample.failed_at < 0) or not done:
        return float("inf")
    answered = run.online.P
    assert answered is not None
    poses = np.abs(run.online.T_world_body[:done] - sample.T_world_body[:done]).max()
    scale = np.abs(answered[:done]).max(axis=(1, 2))
    covariances = np.abs(answered[:done] - sample.P[:done]).max(axis=(1, 2)) / np.where(scale > 0, scale, 1.0)
    return float(max(poses, covariances.max()))


def _stream(
    problem: EnsembleProblem,
    t: FloatArray,
    increments: FloatArray,
    Q: FloatArray,
    seen: BoolArray,
    z: FloatArray,
    start: FloatArray,
) -> MeasurementStream:
    sensor = make_sensor("range_bearing" if problem.polar else "relative_position", _space(problem))
    numbers = problem.numbers
    R = np.diag([numbers[at.FIRST_SIGMA] ** 2, numbers[at.SECOND_SIGMA] ** 2])
    sigmas = numbers[[at.PRIOR_POSITION, at.PRIOR_POSITION, at.PRIOR_HEADING]]
    frames = []
    for k, mask in enumerate(seen):
        ids = np.flatnonzero(mask)
        frames.append(
            Frame(k, float(t[k]), increments[k], Q[k], ids, z[k, ids], np.tile(R, (ids.size, 1, 1)))
        )
    return MeasurementStream(Problem(start, np.diag(sigmas**2), sensor), tuple(frames))


def _space(problem: EnsembleProblem) -> dict[str, int]:
    return {} if problem.polar else {"space_dim": 2}


def _matrices(poses: FloatArray) -> FloatArray:
    """(K, 4) of cosine, sine, x and y as (K, 3, 3)."""
    c, s, x, y = np.moveaxis(poses, -1, 0)
    one, zero = np.ones_like(c), np.zeros_like(c)
    rows = [np.stack(row, axis=-1) for row in ((c, -s, x), (s, c, y), (zero, zero, one))]
    return np.stack(rows, axis=-2)
