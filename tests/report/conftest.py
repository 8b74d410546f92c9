"""Results made from run objects through the metrics' own tables, without running an experiment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from slamcmp.geometry import exp, se2
from slamcmp.metrics import frame_table, landmark_table, reference_truth, score_run
from slamcmp.results.store import Results
from slamcmp.types import GroundTruth, Landmarks, Run, Trajectory

FRAMES = 120
P_ONLINE = np.diag([0.04, 0.02, 0.0004])
P_FINAL = P_ONLINE / 4
P_LANDMARK = np.array([[0.05, 0.02], [0.02, 0.03]])

DESCRIPTION = "Does hindsight help, <b>and</b> what does it cost?"


def circle(landmarks: int = 12) -> GroundTruth:
    angle = np.linspace(0, 2 * np.pi, FRAMES)
    around = np.linspace(0, 2 * np.pi, landmarks, endpoint=False)
    return GroundTruth(
        t=0.5 * np.arange(FRAMES),
        T_world_body=se2(10 * np.cos(angle), 10 * np.sin(angle), angle + np.pi / 2),
        ids=np.arange(landmarks),
        positions=13 * np.stack([np.cos(around), np.sin(around)], axis=1),
    )


def drifting(truth: GroundTruth, P: np.ndarray, scale: float, rng: np.random.Generator) -> np.ndarray:
    """Poses whose errors are ``scale`` times as large as P says, and change slowly."""
    noise = rng.normal(size=(FRAMES, 3))
    for k in range(1, FRAMES):
        noise[k] = 0.95 * noise[k - 1] + np.sqrt(1 - 0.95**2) * noise[k]
    return truth.T_world_body @ exp(-scale * noise * np.sqrt(np.diagonal(P)))


def make_run(label: str, truth: GroundTruth, seed: int, noise: float, **changes: Any) -> Run:
    """``ekf`` is overconfident and has no hindsight; the others are consistent and have."""
    rng = np.random.default_rng([seed, len(label)])
    frames = changes.pop("finished", FRAMES)
    filters = label == "ekf"
    P_online, P_final = P_ONLINE * noise**2, P_FINAL * noise**2
    online = Trajectory(
        truth.t[:frames],
        drifting(truth, P_online, 2.5 if filters else 1.0, rng)[:frames],
        np.broadcast_to(P_online, (frames, 3, 3)),
    )
    final = None
    if not filters and frames == FRAMES:
        final = Trajectory(
            truth.t, drifting(truth, P_final, 1.0, rng), np.broadcast_to(P_final, (FRAMES, 3, 3))
        )
    dof = np.full(frames, 4.0)
    size = np.minimum(1 + np.arange(frames) // 8, truth.ids.size).astype(float)
    fields: dict[str, Any] = {
        "status": "ok",
        "message": "",
        "update_s": (1e-4 if filters else 6e-4) * (1 + 0.02 * size**2) * rng.uniform(0.9, 1.3, frames),
        "estimate_s": np.full(frames, 2e-5 if filters else 4e-4),
        "final_s": 0.0 if filters else 0.05,
        "landmarks": Landmarks(
            truth.ids,
            truth.positions
            + noise * rng.multivariate_normal([0, 0], P_LANDMARK, len(truth.ids)) * (2 if filters else 1),
            np.broadcast_to(noise**2 * P_LANDMARK, (truth.ids.size, 2, 2)),
        ),
        "diagnostics": {"nis": rng.chisquare(4.0, frames), "nis_dof": dof, "landmarks": size},
        "final_diagnostics": {} if filters else {"chi2": 470.0, "dof": 480.0},
        "peak_memory_mb": 3.0,
    }
    return Run(label, {}, f"{seed:064d}", seed, FRAMES, online=online, final=final, **(fields | changes))


def tabulate(trials: list[tuple[dict[str, Any], GroundTruth | None, str, list[Run]]], tmp: Any) -> Results:
    """Tables of trials, each (swept values, truth, reference, runs)."""
    rows, frames, landmarks = [], [], []
    for number, (swept, truth, reference, runs) in enumerate(trials):
        for run in runs:
            keys = {
                "trial": number,
                "label": run.back_end,
                "back_end": run.back_end,
                "seed": run.seed,
                "digest": run.digest,
                **swept,
            }
            is_reference = reference not in ("truth", "none")
            state = {
                "status": run.status,
                "message": run.message,
                "frames": run.frames,
                "reference": reference,
                "final_s": run.final_s,
            }
            rows.append(keys | state | score_run(run, truth, reference=is_reference))
            frames.append(frame_table(run, truth, reference=is_reference).assign(**keys))
            landmarks.append(landmark_table(run, truth, reference=is_reference).assign(**keys))
    table = pd.DataFrame(rows).astype({"seed": "Int64"})
    manifest = {
        "name": "synthetic",
        "question": "Filter or smooth?",
        "description": DESCRIPTION,
        "created": "2026-01-02T03:04:05Z",
        "command": "slamcmp run synthetic.yaml",
        "versions": {"slamcmp": "0.1.0", "numpy": "2.3.4"},
        "commit": "abc1234",
        "cpu": "Test CPU",
        "python": "3.11.7",
        "platform": "Linux",
        "config": {"sweep": {}},
        "seeds": [1],
        "wall_s": 12.5,
        "jobs": 2,
    }
    return Results(
        tmp,
        manifest,
        table,
        pd.concat(frames, ignore_index=True),
        pd.concat(landmarks, ignore_index=True),
    )


@pytest.fixture
def one_trial(tmp_path: Any) -> Results:
    """An EKF and a smoother against the truth, one seed."""
    truth = circle()
    return tabulate(
        [({}, truth, "truth", [make_run(name, truth, 1, 1.0) for name in ("ekf", "isam2")])], tmp_path
    )


@pytest.fixture
def swept(tmp_path: Any) -> Results:
    """Three noise levels by six seeds; at the highest level two runs of the EKF fail."""
    truth = circle()
    trials = []
    for noise in (0.5, 1.0, 2.0):
        for seed in range(6):
            changes: dict[str, Any] = {}
            if noise == 2.0 and seed == 4:
                changes = {"status": "diverged", "message": "covariance is not finite", "finished": 60}
            if noise == 2.0 and seed == 5:
                changes = {"status": "crashed", "message": "<script>alert(1)</script>", "finished": 0}
            runs = [
                make_run("ekf", truth, seed, noise, **changes),
                make_run("isam2", truth, seed, noise),
                make_run("batch", truth, seed, noise),
            ]
            trials.append(({"source.range_sigma_m": noise}, truth, "truth", runs))
    return tabulate(trials, tmp_path)


@pytest.fixture
def recorded(tmp_path: Any) -> Results:
    """A log without truth: the batch solution is the reference, the EKF is far off with a healthy NIS."""
    truth = circle()
    runs = [make_run("ekf", truth, 1, 1.0), make_run("batch", truth, 1, 1.0)]
    return tabulate([({}, reference_truth(runs[1]), "batch (final)", runs)], tmp_path)


@pytest.fixture
def gated(tmp_path: Any) -> Results:
    """Six seeds; ``ekf`` and ``isam2`` gate for themselves, ``batch`` takes everything.

    Of five observations a frame the last is an outlier that both gates catch; from frame 60 on the EKF loses
    one of the four correct ones.
    """
    truth = replace(circle(), outliers=(np.array([False] * 4 + [True]),) * FRAMES)
    kept = {
        label: tuple(np.array([k < loses, True, True, True, False]) for k in range(FRAMES))
        for label, loses in (("ekf", 60), ("isam2", FRAMES))
    } | {"batch": None}
    trials = [
        (
            {},
            truth,
            "truth",
            [make_run(each, truth, seed, 1.0, kept_observations=kept[each]) for each in kept],
        )
        for seed in range(6)
    ]
    results = tabulate(trials, tmp_path)
    gates = results.trials["label"].map({"ekf": 0.999, "isam2": 0.99})
    return replace(results, trials=results.trials.assign(own_gate=gates))


@pytest.fixture
def nothing_known(tmp_path: Any) -> Results:
    """A log without truth and without a reference, from back ends that report no diagnostics."""
    truth = circle()
    return tabulate([({}, None, "none", [make_run("ekf", truth, 1, 1.0, diagnostics={})])], tmp_path)


@pytest.fixture
def tabulated(tmp_path: Any) -> Callable[..., Results]:
    """:func:`tabulate` into this test's folder."""
    return lambda trials: tabulate(trials, tmp_path)
