"""Small trajectories and runs whose scores can be derived by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from slamcmp.types import GroundTruth, Landmarks, Run, Trajectory


@pytest.fixture
def truth_of() -> Callable[..., GroundTruth]:
    """Truth from poses (K, n+1, n+1), at t = 0, 1, 2, … s, with landmarks numbered from 10."""

    def make(poses: Any, positions: Any = None) -> GroundTruth:
        poses = np.asarray(poses, dtype=float)
        n = poses.shape[-1] - 1
        positions = np.empty((0, n)) if positions is None else np.asarray(positions, dtype=float)
        return GroundTruth(
            t=np.arange(len(poses), dtype=float),
            T_world_body=poses,
            ids=np.arange(10, 10 + len(positions)),
            positions=positions,
        )

    return make


@pytest.fixture
def trajectory_of() -> Callable[..., Trajectory]:
    def make(poses: Any, P: Any = None) -> Trajectory:
        poses = np.asarray(poses, dtype=float)
        return Trajectory(np.arange(len(poses), dtype=float), poses, P)

    return make


@pytest.fixture
def run_of(trajectory_of: Callable[..., Trajectory]) -> Callable[..., Run]:
    """A run over ``poses``; landmarks are numbered from 10 unless ``ids`` says otherwise."""

    def make(poses: Any, P: Any = None, positions: Any = None, ids: Any = None, **fields: Any) -> Run:
        online = trajectory_of(poses, P)
        frames = online.t.size
        landmarks = None
        if positions is not None:
            positions = np.asarray(positions, dtype=float)
            count, n = positions.shape
            covariances = fields.pop("covariances", np.broadcast_to(np.eye(n), (count, n, n)))
            ids = np.arange(10, 10 + count) if ids is None else ids
            landmarks = Landmarks(ids, positions, covariances)
        defaults: dict[str, Any] = {
            "back_end": "hand_made",
            "parameters": {},
            "digest": "0" * 64,
            "seed": 1,
            "frames": frames,
            "status": "ok",
            "message": "",
            "update_s": np.full(frames, 0.002),
            "estimate_s": np.full(frames, 0.001),
        }
        return Run(online=online, landmarks=landmarks, **(defaults | fields))

    return make
