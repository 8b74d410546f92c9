"""Error-state charts: retraction, its inverse, its derivatives, and transitions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.backends.filters.error_state.charts import (
    Chart,
    LeftInvariantChart,
    RightInvariantChart,
    RobocentricChart,
    WorldChart,
)

CHARTS = (Chart, WorldChart, RightInvariantChart, LeftInvariantChart, RobocentricChart)


def some_state(space_dim: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(0)
    p = {2: 3, 3: 6}[space_dim]
    return geometry.exp(rng.normal(size=p)), 3 * rng.normal(size=(4, space_dim)), rng


def border(chart: Chart, T: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """[A, 0; B, C]: the chart's errors to body tangent and world offsets."""
    p, n, count = chart.p, chart.n, len(landmarks)
    D = np.eye(p + n * count)
    A, B, C = chart.to_body(T), chart.offsets(T, landmarks), chart.axes(T)
    if A is not None:
        D[:p, :p] = A
    if B is not None:
        D[p:, :p] = B.reshape(-1, p)
    if C is not None:
        D[p:, p:] = np.kron(np.eye(count), C)
    return D


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("chart_class", CHARTS)
def test_chart_maps_are_the_derivatives_of_its_retraction(chart_class: Any, space_dim: int) -> None:
    T, landmarks, _ = some_state(space_dim)
    chart = chart_class(space_dim)

    def offset(error: np.ndarray) -> np.ndarray:
        T_moved, moved = chart.retract(T, landmarks, error)
        return np.concatenate([geometry.local(T, T_moved), (moved - landmarks).ravel()])

    h = 1e-6
    D = border(chart, T, landmarks)
    numerical = np.stack([(offset(h * unit) - offset(-h * unit)) / (2 * h) for unit in np.eye(len(D))], -1)
    np.testing.assert_allclose(D, numerical, atol=2e-9)
    if chart.to_body(T) is not None:
        np.testing.assert_allclose(chart.to_body(T) @ chart.from_body(T), np.eye(chart.p), atol=1e-13)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("chart_class", CHARTS)
def test_chart_errors_invert_the_retraction_also_in_batches(chart_class: Any, space_dim: int) -> None:
    T, landmarks, rng = some_state(space_dim)
    chart = chart_class(space_dim)
    errors = 0.5 * rng.normal(size=(6, chart.p + landmarks.size))
    poses, moved = chart.retract(T, landmarks, errors)
    np.testing.assert_allclose(chart.errors(T, landmarks, poses, moved), errors, atol=1e-12)
    one, one_moved = chart.retract(T, landmarks, errors[2])
    np.testing.assert_allclose(poses[2], one, atol=1e-15)
    np.testing.assert_allclose(moved[2], one_moved, atol=1e-14)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("chart_class", CHARTS)
def test_chart_transition_is_the_body_tangents_in_its_own_coordinates(
    chart_class: Any, space_dim: int
) -> None:
    """[F, 0; 0, D] = border(T_to)^-1 [Ad(step^-1), 0; 0, 1] border(T_from): a step leaves landmarks alone."""
    T, landmarks, rng = some_state(space_dim)
    chart = chart_class(space_dim)
    p, n = chart.p, chart.n
    step = geometry.exp(0.3 * rng.normal(size=p))
    in_body = np.eye(p + landmarks.size)
    in_body[:p, :p] = geometry.adjoint(geometry.inverse(step))
    expected = np.linalg.solve(border(chart, T @ step, landmarks), in_body @ border(chart, T, landmarks))
    F = chart.transition(T, T @ step)
    np.testing.assert_allclose(np.eye(p) if F is None else F, expected[:p, :p], atol=1e-13)
    turned = np.eye(n) if chart.axes(T) is None else step[:n, :n].T
    np.testing.assert_allclose(np.kron(np.eye(4), turned), expected[p:, p:], atol=1e-13)
    np.testing.assert_allclose(expected[p:, :p], 0.0, atol=1e-12)
    np.testing.assert_allclose(expected[:p, p:], 0.0, atol=1e-15)
