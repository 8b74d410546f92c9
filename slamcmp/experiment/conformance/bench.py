"""The streams that back ends are checked on, and how they are fed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.geometry import dead_reckoning
from slamcmp.protocols import BackEnd
from slamcmp.registry import front_ends, sources
from slamcmp.types import Estimate, FloatArray, Frame, GroundTruth, MeasurementStream, Problem

WORLDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("range-bearing", {"sensor": "range_bearing"}),
    ("relative-position", {"sensor": "relative_position"}),
    (
        "relative-position, known heading",
        {"sensor": "relative_position", "turn_sigma_deg_s": 1e-6, "prior_heading_sigma_rad": 1e-9},
    ),
)
"""Kinds of problem, the first of which that the back end accepts is the one it is checked on."""

COMMON: dict[str, Any] = {
    "steps": 70,
    "landmarks": 15,
    "prior_position_sigma_m": 0.01,
    "prior_heading_sigma_rad": 0.002,
}


@dataclass(frozen=True)
class Bench:
    """What a check works on."""

    make: Callable[[Problem, GroundTruth], BackEnd]
    kind: str
    settings: Mapping[str, Any]
    stream: MeasurementStream
    truth: GroundTruth
    closes_loops: bool = True
    """Whether it knows places again, which its trait of this name says."""

    def new(self, stream: MeasurementStream, truth: GroundTruth | None = None) -> BackEnd:
        """A back end for a stream; one that needs the truth gets the bench's unless told another."""
        return self.make(stream.problem, self.truth if truth is None else truth)

    def world(self, seed: int) -> tuple[MeasurementStream, GroundTruth]:
        """Another stream of the same kind, and its truth."""
        return make_world(self.settings, seed)


def make_world(settings: Mapping[str, Any], seed: int) -> tuple[MeasurementStream, GroundTruth]:
    """A stream of a circling robot, and its truth; made once in a process, for nobody can change it."""
    return _world(tuple(sorted(settings.items())), seed)


@lru_cache(maxsize=256)
def _world(ordered: tuple[tuple[str, Any], ...], seed: int) -> tuple[MeasurementStream, GroundTruth]:
    settings = dict(ordered)
    log = sources.get("circle").target(seed, **settings)
    stream: MeasurementStream = front_ends.get("labelled").target(log, seed)
    # Names that are no indices, a frame without sight, and a landmark that comes late: what real logs do.
    frames = []
    for frame in stream.frames:
        keep = np.zeros(frame.ids.size, dtype=bool) if frame.k == 11 else np.ones(frame.ids.size, dtype=bool)
        frames.append(
            Frame(
                frame.k,
                frame.t,
                frame.T_prev_body,
                frame.Q,
                _renamed(frame.ids[keep]),
                frame.z[keep],
                frame.R[keep],
            )
        )
    truth: GroundTruth = log.truth
    renamed = GroundTruth(truth.t, truth.T_world_body, _renamed(truth.ids), truth.positions)
    return MeasurementStream(stream.problem, tuple(frames)), renamed


def _renamed(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    return 1_000_003 * (ids + 1)


def feed(
    bench: Bench, stream: MeasurementStream, truth: GroundTruth | None = None
) -> Iterator[tuple[Frame, Estimate]]:
    """Each frame with the estimate after it; ``truth`` for a back end that needs one."""
    back_end = bench.new(stream, truth)
    for frame in stream.frames:
        back_end.update(frame)
        yield frame, back_end.estimate()


def run(
    bench: Bench, stream: MeasurementStream, truth: GroundTruth | None = None
) -> tuple[FloatArray, FloatArray]:
    """All estimated poses (K, n+1, n+1) and covariances (K, p, p)."""
    estimates = [estimate for _, estimate in feed(bench, stream, truth)]
    return (
        np.stack([estimate.T_world_body for estimate in estimates]),
        np.stack([estimate.P for estimate in estimates]),
    )


def blind(stream: MeasurementStream) -> MeasurementStream:
    """The stream without its observations."""
    d = stream.problem.sensor.dim
    none = np.empty(0, dtype=np.int64), np.empty((0, d)), np.empty((0, d, d))
    frames = tuple(Frame(f.k, f.t, f.T_prev_body, f.Q, *none) for f in stream.frames)
    return MeasurementStream(stream.problem, frames)


def reckoned(stream: MeasurementStream) -> FloatArray:
    """The poses (K, n+1, n+1) by odometry alone."""
    increments = np.stack([frame.T_prev_body for frame in stream.frames])
    return dead_reckoning(stream.problem.T_world_body, increments)
