"""Small worlds that ensembles run in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from slamcmp.ensembles.problem import EnsembleProblem, ensemble_problem
from slamcmp.experiment.config.experiment import Experiment, load_experiment

ALL = ("ekf_slam", "ekf_world", "ekf_right_invariant", "ekf_fej", "ekf_oc", "ekf_ideal")
SOURCE: dict[str, Any] = {
    "name": "circle",
    "steps": 40,
    "landmarks": 8,
    "map_seed": 3,
    "speed_m_s": 0.5,
    "turn_deg_s": 20.0,
    "sensor": "relative_position",
    "odometry": "straight_then_turn",
}


def experiment(
    folder: Path, source: dict[str, Any] | None = None, back_ends: list[Any] | None = None, **keys: Any
) -> Experiment:
    """One with these parameters of the source and these back ends (names, or with parameters)."""
    chosen = [{"name": each} if isinstance(each, str) else each for each in back_ends or ALL]
    whole = {
        "source": SOURCE | (source or {}),
        "front_end": {"name": "labelled", "gate_probability": None},
        "back_ends": chosen,
    } | keys
    path = folder / "small.yaml"
    # JSON is YAML.
    path.write_text(json.dumps(whole), encoding="utf-8")
    return load_experiment(path)


def problem(
    folder: Path, source: dict[str, Any] | None = None, back_ends: list[Any] | None = None
) -> EnsembleProblem:
    """The same as an ensemble's problem."""
    return ensemble_problem(experiment(folder, source, back_ends))
