"""Trials by all that their rows are made of: equal key, equal rows, but for the trial's number."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence

from slamcmp.experiment.planning.trials import Trial
from slamcmp.support.provenance.code_version import PACKAGE, code_version


def settled_keys(trials: Sequence[Trial], reference: str | None) -> Callable[[Trial], str]:
    """The key of each trial of an experiment: its jobs, labels and swept values, and what gathers them."""
    code = code_version([PACKAGE / "experiment" / "gathering" / "tables.py"])
    of_all = hashlib.sha256(json.dumps([code, reference, kinds(trials)], sort_keys=True).encode())

    def key(trial: Trial) -> str:
        runs = [(job.key, job.back_end.label, job.back_end.name, job.back_end.own_gate) for job in trial.runs]
        known = [trial.stream.key, trial.seed, trial.recording, dict(trial.swept), runs]
        hasher = of_all.copy()
        hasher.update(json.dumps(known, default=str).encode())
        return hasher.hexdigest()[:32]

    return key


def kinds(trials: Sequence[Trial]) -> Mapping[str, str]:
    """What each swept path's column holds: ``bool``, ``number``, or ``text`` where kinds are mixed."""
    found: dict[str, set[str]] = {}
    for trial in trials:
        for path, value in trial.swept.items():
            known = found.setdefault(path, set())
            if isinstance(value, bool):
                known.add("bool")
            elif isinstance(value, int | float):
                known.add("number")
            elif value is not None:
                known.add("text")
    return {path: next(iter(known)) if len(known) == 1 else "text" for path, known in found.items()}
