"""The published planar benchmarks as seeded streams, and the numbers their authors print.

P1: the SLAM example of the ukfm project (Brossard, Barrau, Bonnabel). P2: the loop scenario of Huang,
Mourikis, Roumeliotis 2010, "Observability-based rules for designing consistent EKF SLAM estimators". P3: the
exploration-and-loop scenario of Brossard, Barrau, Bonnabel 2018, "Exploiting symmetries to design EKFs with
consistency properties for navigation and SLAM".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slamcmp.geometry import heading, wrap
from slamcmp.randomness import random_streams
from slamcmp.types import Frame, GroundTruth, Log, MeasurementStream
from slamcmp.worlds.settings import Settings
from slamcmp.worlds.simulate import World, simulate


@dataclass(frozen=True)
class Scenario:
    """A robot on a circle that sees relative positions."""

    speed: float
    turn: float
    sigma: float
    """speed noise sigma/sqrt 2, turn-rate noise 2 sqrt 2 sigma."""
    range_min: float
    landmarks: np.ndarray
    prior_sigma: float = 0.0

    def log(self, seed: int, steps: int) -> Log:
        settings = Settings(
            steps=steps,
            landmarks=len(self.landmarks),
            speed_m_s=self.speed,
            turn_deg_s=math.degrees(self.turn),
            sensor="relative_position",
            position_sigma_m=0.1,
            range_min_m=self.range_min,
            range_max_m=5.0,
            odometry="straight_then_turn",
            speed_sigma_m_s=self.sigma / math.sqrt(2),
            turn_sigma_deg_s=math.degrees(2 * math.sqrt(2) * self.sigma),
            lateral_sigma_m=0.0,
            prior_position_sigma_m=self.prior_sigma,
            prior_heading_sigma_rad=self.prior_sigma,
            resolution=0.0,
        )
        controls = np.tile([self.speed, self.turn], (steps - 1, 1))
        return simulate("anchor", World(controls, self.landmarks), settings, random_streams(seed))


def p1() -> Scenario:
    """20 landmarks evenly on a ring 3 m outside the path."""
    turn = math.radians(1.5)
    angles = 2 * math.pi * np.arange(20) / 20
    centre = np.array([0.0, 0.25 / turn])
    ring = centre + (0.25 / turn + 3.0) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return Scenario(0.25, turn, 0.05 * 0.25, 1.0, ring)


def p2(map_seed: int) -> Scenario:
    """20 landmarks 0.5 to 5 m off the path, on both sides; the map is drawn once."""
    return Scenario(0.25, 0.025, 0.05 * 0.25, 0.5, _annulus(0.25 / 0.025, 20, map_seed), 1e-4)


def p3(map_seed: int) -> Scenario:
    """15 landmarks as in P2 around a circle of 3.3 m, stronger noise."""
    return Scenario(0.25, 0.075, 0.02, 0.5, _annulus(0.25 / 0.075, 15, map_seed))


def _annulus(radius: float, count: int, seed: int) -> np.ndarray:
    draws = np.random.default_rng(seed).random((count, 3))
    gaps = 0.5 + 4.5 * draws[:, 1]
    distances = np.where(draws[:, 2] < 0.5, radius + gaps, radius - gaps)
    angles = 2 * math.pi * draws[:, 0]
    return np.array([0.0, radius]) + distances[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def stream_of(log: Log) -> MeasurementStream:
    """The log's detections with their labels, from the first step on.

    All three simulations move before they look. It matters: a look from the exactly known start would tie
    the map's heading to the world, and halve every error.
    """
    frames = []
    for k, seen in enumerate(log.detections):
        some = slice(None) if k else slice(0)
        frames.append(
            Frame(
                k,
                float(log.t[k]),
                log.T_prev_body[k],
                log.Q[k],
                seen.ids[some],
                seen.z[some],
                seen.R[some],
            )
        )
    return MeasurementStream(log.problem, tuple(frames))


@dataclass
class Errors:
    """World-additive errors and their NEES over all runs and frames, (runs, frames, …)."""

    heading: list[np.ndarray] = field(default_factory=list)
    position: list[np.ndarray] = field(default_factory=list)
    heading_nees: list[np.ndarray] = field(default_factory=list)
    position_nees: list[np.ndarray] = field(default_factory=list)
    pose_nees: list[np.ndarray] = field(default_factory=list)

    def add(self, poses: np.ndarray, P: np.ndarray, truth: GroundTruth) -> None:
        """One run's estimates (K, 3, 3) and body-tangent covariances (K, 3, 3)."""
        R = poses[:, :2, :2]
        offset = truth.T_world_body[:, :2, 2] - poses[:, :2, 2]
        turn = wrap(heading(truth.T_world_body) - heading(poses))
        in_body = np.concatenate([(offset[:, None] @ R)[:, 0], turn[:, None]], axis=1)
        # The prior may be exact: the first frames have no NEES.
        with np.errstate(divide="ignore", invalid="ignore"):
            self.heading_nees.append(turn**2 / P[:, 2, 2])
            safe = P + 1e-30 * np.eye(3)
            self.position_nees.append(_form(in_body[:, :2], safe[:, :2, :2]))
            self.pose_nees.append(_form(in_body, safe))
        self.heading.append(turn)
        self.position.append(offset)

    def heading_rmse_deg(self, first: int = 0) -> float:
        return math.degrees(math.sqrt(np.mean(np.square(np.array(self.heading)[:, first:]))))

    def position_rmse(self, first: int = 0) -> float:
        return math.sqrt(np.mean(np.square(np.array(self.position)[:, first:]).sum(axis=-1)))

    def mean_rmse(self) -> tuple[float, float]:
        """Time-means of the RMSE over runs: position [m] and heading [deg]."""
        position = np.sqrt(np.mean(np.square(np.array(self.position)).sum(axis=-1), axis=0)).mean()
        turn = np.sqrt(np.mean(np.square(np.array(self.heading)), axis=0)).mean()
        return float(position), math.degrees(turn)

    def mean_nees(self, what: str, skip: int = 10) -> float:
        """Over runs and frames; the first ``skip`` frames count as 0."""
        values = np.array(getattr(self, what))
        values[:, :skip] = 0.0
        return float(values.mean())

    def nees_of_runs(self, skip: int = 10) -> list[float]:
        """Each run's time-mean of the pose's NEES, without its first ``skip`` frames."""
        return [float(run[skip:].mean()) for run in self.pose_nees]


def _form(error: np.ndarray, P: np.ndarray) -> np.ndarray:
    try:
        return np.einsum("ki,ki->k", error, np.linalg.solve(P, error[..., None])[..., 0])
    except np.linalg.LinAlgError:
        return np.einsum("ki,kij,kj->k", error, np.linalg.pinv(P), error)


def monte_carlo(
    scenario: Scenario,
    back_ends: dict[str, Callable[[Any, GroundTruth], Any]],
    *,
    seeds: Iterable[int],
    steps: int,
) -> dict[str, Errors]:
    """Every back end (made from the problem and the truth) on every seed's stream."""
    errors = {name: Errors() for name in back_ends}
    for seed in seeds:
        log = scenario.log(seed, steps)
        assert log.truth is not None
        stream = stream_of(log)
        for name, make in back_ends.items():
            back_end = make(stream.problem, log.truth)
            poses, P = np.empty((steps, 3, 3)), np.empty((steps, 3, 3))
            for k, frame in enumerate(stream.frames):
                back_end.update(frame)
                estimate = back_end.estimate()
                poses[k], P[k] = estimate.T_world_body, estimate.P
            errors[name].add(poses, P, log.truth)
    return errors
