"""Results tables made by hand, every number different from every other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.results.store import Results

FRAMES = 3
SEEDS = 12
NOISE = np.exp(0.01 * np.random.default_rng(16).normal(size=(5, SEEDS)))
"""What one back end's errors have apart from the others': one in a hundred."""
WORLD = np.exp(0.5 * np.random.default_rng(17).normal(size=SEEDS))
"""What a seed does to all."""


def results_of(rows: list[dict[str, Any]], frames: pd.DataFrame | None = None) -> Results:
    """Results whose trials are ``rows``, with what every table has filled in."""
    defaults = {
        "trial": 0,
        "seed": 0,
        "label": "A",
        "status": "ok",
        "reference": "truth",
        "digest": "d",
        "frames": FRAMES,
        "completion": 1.0,
        "own_gate": None,
    }
    trials = pd.DataFrame([defaults | {"trial": row.get("seed", 0)} | row for row in rows])
    empty = pd.DataFrame({"trial": [], "label": [], "k": []})
    return Results(
        Path("made"), {}, trials.astype({"seed": "Int64"}), empty if frames is None else frames, empty
    )


def runs(label: str, errors: list[float], failed: tuple[int, ...] = (), **more: Any) -> list[dict[str, Any]]:
    """One run a seed with this online ATE; half of it with hindsight."""
    return [
        {
            "label": label,
            "seed": seed,
            "status": "diverged" if seed in failed else "ok",
            "online_ate": error,
            "final_ate": error / 2,
            **more,
        }
        for seed, error in enumerate(errors)
    ]


def back_end(label, ratio, ms, *, noise=None, nees=3.0, seeds=SEEDS, failed=(), **more):
    """Runs whose error is ``ratio`` times the seed's own."""
    index = sum(map(ord, label)) % len(NOISE)
    errors = ratio * WORLD * (NOISE[index] if noise is None else noise)
    scatter = np.random.default_rng(index).uniform(0.8, 1.2, SEEDS)
    rows = runs(label, errors[:seeds].tolist(), failed, estimate_s=0.0, update_p95_ms=2 * ms)
    times = {"update_s": 3 * ms / 1e3, "estimate_p95_ms": 0.0, "final_s": 0.003, "peak_memory_mb": 10.0}
    message = {"message": "not positive definite"}
    return [
        {**row, **times, **more, **(message if row["status"] != "ok" else {}), "online_pose_nees": nees * s}
        for row, s in zip(rows, scatter, strict=False)
    ]


def table(*groups):
    return results_of([row for group in groups for row in group])
