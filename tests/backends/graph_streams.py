"""Streams for the tests of the graph back ends, and how to run one."""

from __future__ import annotations

from typing import Any

import numpy as np

from slamcmp import geometry
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, MeasurementStream, Problem


def run(back_end: Any, stream: MeasurementStream) -> Any:
    for frame in stream.frames:
        back_end.update(frame)
    return back_end


def spatial_stream(*, frames: int = 30, landmarks: int = 10, seed: int = 0, noise: float = 1.0):  # type: ignore[no-untyped-def]
    """The stream, true poses (K, 4, 4) and landmarks (L, 3): a helix, relative positions with full R."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-6, 6, size=(landmarks, 3))
    increment = geometry.exp(np.array([0.02, 0.05, 0.2, 0.6, 0.0, 0.05]))
    A = rng.normal(size=(6, 6)) * 0.01
    Q = noise**2 * (A @ A.T + 1e-4 * np.eye(6))
    B = rng.normal(size=(3, 3)) * 0.05
    R = noise**2 * (B @ B.T + 0.0025 * np.eye(3))
    P = noise**2 * 1e-4 * np.eye(6)
    L_Q, L_R = np.linalg.cholesky(Q), np.linalg.cholesky(R)
    sensor = RelativePosition(space_dim=3)
    T = geometry.exp(np.linalg.cholesky(P) @ rng.normal(size=6))
    made, truth = [], []
    for k in range(frames):
        if k:
            T = T @ increment @ geometry.exp(L_Q @ rng.normal(size=6))
        ids = rng.permutation(landmarks)[:4]
        z = sensor.predict(T, world[ids]) + rng.normal(size=(4, 3)) @ L_R.T
        made.append(
            Frame(
                k,
                float(k),
                increment if k else np.eye(4),
                Q if k else np.zeros((6, 6)),
                ids,
                z,
                np.broadcast_to(R, (4, 3, 3)),
            )
        )
        truth.append(T)
    return MeasurementStream(Problem(np.eye(4), P, sensor), tuple(made)), np.stack(truth), world


def without_observations(stream: MeasurementStream) -> MeasurementStream:
    frames = [Frame(f.k, f.t, f.T_prev_body, f.Q, f.ids[:0], f.z[:0], f.R[:0]) for f in stream.frames]
    return MeasurementStream(stream.problem, tuple(frames))


def with_frame(stream: MeasurementStream, k: int, **changes: Any) -> list[Frame]:
    """The frames with one of them changed, unchecked by the stream."""
    frames = list(stream.frames)
    old = frames[k]
    content = {name: getattr(old, name) for name in ("k", "t", "T_prev_body", "Q", "ids", "z", "R")}
    frames[k] = Frame(**{**content, **changes})
    return frames


def odometry_only(stream: MeasurementStream) -> tuple[np.ndarray, np.ndarray]:
    """Closed form: poses by chaining, P_{k+1} = A P A^T + Q with A = Ad(T_prev_body^-1)."""
    T, P = stream.problem.T_world_body, stream.problem.P
    poses, covariances = [T], [P]
    for frame in stream.frames[1:]:
        A = geometry.adjoint(geometry.inverse(frame.T_prev_body))
        T, P = T @ frame.T_prev_body, A @ P @ A.T + frame.Q
        poses.append(T)
        covariances.append(P)
    return np.array(poses), np.array(covariances)
