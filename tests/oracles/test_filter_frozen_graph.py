"""A filter is the marginal of one linear least-squares problem: its own, frozen where it linearised.

Prior at the start, motion between the updated and the predicted mean, observations at the predicted mean,
new landmarks at their own point with no residual. In the errors' coordinates about each predicted mean the
problem is linear for every chart, so the solution, all marginals and the chi² are closed forms.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf
from slamcmp.backends.filters.variants import FirstEstimatesEkf, ObservabilityConstrainedEkf, WorldEkf
from slamcmp.types import MeasurementStream
from tests.oracles.filters import BodyEkf, world_of


class FrozenGraph:
    """Rows ``J x = r`` of unit variance; x: poses' errors about their predicted means, then landmarks'."""

    def __init__(self, filter_: ErrorStateEkf, stream: MeasurementStream, total_landmarks: int) -> None:
        chart = filter_._chart
        self.p, self.n = chart.p, chart.n
        self.poses = len(stream.frames)
        self.size = self.p * self.poses + self.n * total_landmarks
        self.blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self.corrections = np.zeros((self.poses, self.p))
        self.landmark_moves = np.zeros(self.n * total_landmarks)
        self.chi2_filter = 0.0
        self._record(filter_, stream)

    def _row(self, height: int) -> np.ndarray:
        return np.zeros((height, self.size))

    def _add(self, J: np.ndarray, r: np.ndarray, covariance: np.ndarray) -> None:
        L = np.linalg.cholesky(covariance)
        self.blocks.append((np.linalg.solve(L, J), np.linalg.solve(L, r)))

    def _landmark_columns(self, numbers: np.ndarray) -> np.ndarray:
        return self.p * self.poses + numbers

    def _record(self, filter_: Any, stream: MeasurementStream) -> None:
        p, base = self.p, self.p * self.poses
        J = self._row(p)
        J[:, :p] = np.eye(p)
        self._add(J, np.zeros(p), filter_._P.pose_block())
        observe, grow = filter_._P.observe, filter_._P.grow

        def recorded_observe(touched: np.ndarray, H: np.ndarray, R: np.ndarray, y: np.ndarray) -> np.ndarray:
            J = self._row(y.size)
            J[:, p * self.k : p * (self.k + 1)] = H[:, :p]
            columns = base + touched[p:] - p
            J[:, columns] = H[:, p:]
            # y is about the newest means; landmarks have moved since they joined.
            self._add(J, y + H[:, p:] @ self.landmark_moves[touched[p:] - p], R)
            dx = observe(touched, H, R, y)
            self.corrections[self.k] = dx[:p]
            self.landmark_moves[: dx.size - p] += dx[p:]
            self.chi2_filter += filter_._P.nis
            return dx

        def recorded_grow(G: np.ndarray, N: np.ndarray) -> None:
            first = filter_._P.size - p
            J = self._row(len(G))
            J[:, base + first : base + first + len(G)] = np.eye(len(G))
            J[:, p * self.k : p * (self.k + 1)] = -G
            self._add(J, -G @ self.corrections[self.k], N)
            grow(G, N)

        filter_._P.observe, filter_._P.grow = recorded_observe, recorded_grow
        for frame in stream.frames:
            self.k = frame.k
            if frame.k:
                previous = filter_._T
                filter_.update(frame)
                step = [event for event in filter_.history.events if hasattr(event, "D")][-1]
                J = self._row(p)
                J[:, p * self.k : p * (self.k + 1)] = np.eye(p)
                J[:, p * (self.k - 1) : p * self.k] = -step.F
                noise_map = filter_._chart.from_body(previous @ frame.T_prev_body)
                Q = frame.Q if noise_map is None else noise_map @ frame.Q @ noise_map.T
                self._add(J, -step.F @ self.corrections[self.k - 1], Q)
            else:
                filter_.update(frame)

    def solve(self) -> tuple[np.ndarray, np.ndarray, float]:
        J = np.concatenate([J for J, _ in self.blocks])
        r = np.concatenate([r for _, r in self.blocks])
        x, *_ = np.linalg.lstsq(J, r, rcond=None)
        return x, np.linalg.inv(J.T @ J), float(np.sum((r - J @ x) ** 2))


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", [BodyEkf, WorldEkf, FirstEstimatesEkf, ObservabilityConstrainedEkf])
@pytest.mark.parametrize("new_landmarks", ["join_first", "update_first"])
def test_filter_and_its_smoother_are_marginals_of_the_frozen_graph(
    filter_class: Any, space_dim: int, new_landmarks: str
) -> None:
    stream, _ = world_of(space_dim, frames=25, landmarks=8)
    filter_ = filter_class(stream.problem, new_landmarks=new_landmarks, smooth=True)
    graph = FrozenGraph(filter_, stream, 8)
    x, covariance, chi2 = graph.solve()
    p, last = graph.p, graph.p * (graph.poses - 1)

    # Last pose and map: the filter's own answer.
    np.testing.assert_allclose(x[last : last + p], graph.corrections[-1], atol=1e-9)
    np.testing.assert_allclose(x[last + p :], graph.landmark_moves, atol=1e-9)
    P = filter_._P.dense()
    np.testing.assert_allclose(covariance[last:, last:], P, atol=1e-9 * np.abs(P).max())
    # The innovations' squares are the graph's chi² at its optimum.
    assert graph.chi2_filter == pytest.approx(chi2, rel=1e-9)
    # Every pose with hindsight: the RTS smoother.
    _, errors, smoothed = filter_.history.smoothed_errors()
    poses = x[: graph.poses * p].reshape(-1, p)
    np.testing.assert_allclose(graph.corrections + errors, poses, atol=1e-9)
    for k in range(graph.poses):
        block = covariance[k * p : (k + 1) * p, k * p : (k + 1) * p]
        np.testing.assert_allclose(smoothed[k], block, atol=1e-9 * np.abs(block).max())
