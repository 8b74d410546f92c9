"""Noise from innovations: the factors on stated sigmas under which a log's innovations are likeliest.

EKF-SLAM predicts each frame's sights of known landmarks before it takes them in; under a right Q and R its
innovations y are normal with covariance S, whatever the truth is. So the factors s maximise

    sum over frames of  - y^T S(s)^-1 y / 2 - log det S(s) / 2

(the prediction-error form of the likelihood; Mehra 1970, Abbeel and others 2005). A landmark's first sight is
no innovation. Maximised by scoring in log s with the frames' own scores (Berndt and others 1974); the
sum of their outer products is also the information that the intervals come from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamcmp.backends.filters.covariances.error_covariance import Correction, Event
from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.errors import DataError, DivergedError
from slamcmp.types import FloatArray, Frame, MeasurementStream

LARGEST = 100.0
"""Factor on a stated sigma beyond which no search goes, and one over it."""
WIDE = 2.0
"""An interval that reaches farther than this factor to each side says little: little is known then."""
_STEP = 0.02
_ITERATIONS = 30
_Z95 = 1.959964


@dataclass(frozen=True)
class Fit:
    """Factors on the stated sigmas, one of each noise."""

    names: tuple[str, ...]
    factors: FloatArray
    lower: FloatArray
    upper: FloatArray
    """95 % intervals of the factors, each for itself."""
    frames: int
    """That had innovations."""
    gained: float
    """Log-likelihood over that of the stated noise."""

    def is_identifiable(self, k: int) -> bool:
        """Whether the log says something of the k-th noise."""
        inside = 1.01 / LARGEST < self.factors[k] < LARGEST / 1.01
        return bool(inside and self.upper[k] <= WIDE**2 * self.lower[k])


def fit_noise(
    stream: MeasurementStream,
    parts: Sequence[tuple[str, FloatArray]],
    components: Sequence[tuple[str, Sequence[int]]],
) -> Fit:
    """Fit a factor on each part of the odometry's sigmas and on each component's sigma.

    ``parts`` are names and shares of Q that add up to it, each (K, p, p); ``components`` names and those of
    z's entries that have one sigma.

    Raises:
        DataError: too few frames have innovations.
        DivergedError: the filter fails under the stated noise already.
    """
    likelihood = _Likelihood(stream, [Q for _, Q in parts], [which for _, which in components])
    x = np.zeros(len(parts) + len(components))
    terms = likelihood(x)
    used = int(np.count_nonzero(terms))
    if used < 5 * x.size:
        raise DataError(
            f"{used} frames see a landmark again; at least {5 * x.size} are needed to fit {x.size} noises"
        )
    start, information = float(terms.sum()), np.eye(x.size)
    damping = 1e-3
    for _ in range(_ITERATIONS):
        scores = _scores(likelihood, x)
        gradient, information = scores.sum(axis=0), scores.T @ scores
        while True:
            # Levenberg's damping, for stated values can be far off.
            scaled = information + damping * np.diag(np.maximum(np.diagonal(information), 1e-6))
            step = np.clip(np.linalg.solve(scaled, gradient), -1.0, 1.0)
            tried = np.clip(x + step, -np.log(LARGEST), np.log(LARGEST))
            found = _or_nothing(likelihood, tried)
            if found is not None and found.sum() >= terms.sum():
                moved, x, terms, damping = float(np.abs(tried - x).max()), tried, found, damping / 10
                break
            damping *= 10
            if damping > 1e6:
                moved = 0.0
                break
        if moved < 1e-4:
            break
    scores = _scores(likelihood, x)
    spread = _Z95 * np.sqrt(np.diagonal(np.linalg.pinv(scores.T @ scores, hermitian=True)))
    # Of what no score depends on nothing is known.
    spread = np.where(np.diagonal(scores.T @ scores) > 1e-9, spread, np.inf)
    spread = np.minimum(spread, 2 * np.log(LARGEST))
    return Fit(
        (*(name for name, _ in parts), *(name for name, _ in components)),
        np.exp(x),
        np.exp(x - spread),
        np.exp(x + spread),
        used,
        float(terms.sum()) - start,
    )


class _Likelihood:
    """Of each frame the log density of its innovations, by the logarithms of the factors."""

    def __init__(
        self, stream: MeasurementStream, parts: Sequence[FloatArray], components: Sequence[Sequence[int]]
    ) -> None:
        self._stream, self._parts, self._components = stream, parts, components

    def __call__(self, x: FloatArray) -> FloatArray:
        of_odometry, of_sensor = np.split(np.exp(x), [len(self._parts)])
        Q = sum((s**2 * part for s, part in zip(of_odometry, self._parts, strict=True)), np.zeros(()))
        ekf = EkfSlam(self._stream.problem)
        sigmas = np.ones(self._stream.problem.sensor.dim)
        for s, which in zip(of_sensor, self._components, strict=True):
            sigmas[list(which)] = s
        heard = ekf.covariance.add_listener(_Innovations(len(self._stream.frames)))
        for k, frame in enumerate(self._stream.frames):
            heard.frame = k
            ekf.update(_scaled(frame, Q[k], np.outer(sigmas, sigmas)))
        return heard.terms


class _Innovations:
    """Hears of each correction how likely its innovation was."""

    def __init__(self, frames: int) -> None:
        self.terms = np.zeros(frames)
        self.frame = 0

    def hear(self, event: Event) -> None:
        """Add the log density, without the constant."""
        if isinstance(event, Correction):
            density = -0.5 * event.e @ event.e - np.log(np.diagonal(event.L)).sum()
            self.terms[self.frame] += density


def _scaled(frame: Frame, Q: FloatArray, by: FloatArray) -> Frame:
    entries = frame.entries
    if entries is not None:
        entries = replace(entries, R=entries.R * by)
    return replace(frame, Q=Q, R=frame.R * by, entries=entries)


def _scores(likelihood: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """(frames, parameters): derivatives of each frame's term, by central differences."""
    columns = []
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = _STEP
        columns.append((likelihood(x + step) - likelihood(x - step)) / (2 * _STEP))
    return np.stack(columns, axis=1)


def _or_nothing(likelihood: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray | None:
    try:
        terms = likelihood(x)
    except DivergedError:
        return None
    return terms if np.isfinite(terms).all() else None
