"""Results tables made by hand, every number different from every other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from slamcmp.results.store import Results

FRAMES = 3


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
