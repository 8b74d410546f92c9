"""Streams in which single measurements are wrong, for tests of robust back ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from slamcmp.types import FloatArray, Frame, MeasurementStream


def spoilt(stream: MeasurementStream, wrong: Mapping[tuple[int, int], FloatArray]) -> MeasurementStream:
    """The stream with measurement ``row`` of frame k replaced, for each (k, row) of ``wrong``."""

    def changed(frame: Frame) -> Frame:
        z = frame.z.copy()
        for (k, row), value in wrong.items():
            if k == frame.k:
                z[row] = value
        return replace(frame, z=z)

    return of_frames(stream, map(changed, stream.frames))


def without(stream: MeasurementStream, gone: Iterable[tuple[int, int]]) -> MeasurementStream:
    """The stream without measurement ``row`` of frame k, for each (k, row)."""
    gone = set(gone)

    def changed(frame: Frame) -> Frame:
        stays = np.array([(frame.k, row) not in gone for row in range(frame.ids.size)], dtype=bool)
        return replace(frame, ids=frame.ids[stays], z=frame.z[stays], R=frame.R[stays])

    return of_frames(stream, map(changed, stream.frames))


def with_noise(stream: MeasurementStream, R_of: Callable[[Frame], FloatArray]) -> MeasurementStream:
    """The stream with the covariances (m, d, d) that ``R_of`` gives."""
    return of_frames(stream, (replace(frame, R=R_of(frame)) for frame in stream.frames))


def of_frames(stream: MeasurementStream, frames: Iterable[Frame]) -> MeasurementStream:
    return MeasurementStream(stream.problem, tuple(frames))


def ghosts(stream: MeasurementStream, share: float, seed: int) -> MeasurementStream:
    """A share of the measurements replaced by a uniform draw of range and bearing."""
    rng = np.random.default_rng(seed)
    wrong = {
        (frame.k, row): np.array([rng.uniform(0.5, 20.0), rng.uniform(-np.pi, np.pi)])
        for frame in stream.frames
        for row in range(frame.ids.size)
        if rng.random() < share
    }
    return spoilt(stream, wrong)
