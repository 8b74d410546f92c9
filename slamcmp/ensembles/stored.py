"""An ensemble's runs as a file, to be gone on with: ``ensemble.npz``; and for reading: ``ensemble.json``."""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import slamcmp
from slamcmp.ensembles.outcome import Ensemble, FilterRuns
from slamcmp.ensembles.problem import EnsembleProblem
from slamcmp.support.files.atomic import write_atomically

RUNS, TABLE = "ensemble.npz", "ensemble.json"


def ensemble_key(problem: EnsembleProblem) -> str:
    """What the runs depend on: the world, the filters and the text of the program."""
    parts: list[NDArray[Any]] = [problem.numbers, problem.path, problem.controls, problem.landmarks]
    parts += [each.options for each in problem.filters]
    digest = hashlib.sha256(repr([each.label for each in problem.filters]).encode())
    for part in parts:
        digest.update(repr(part.shape).encode() + part.tobytes())
    for path in sorted((Path(__file__).parent / "kernels").glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def save_ensemble(found: Ensemble, folder: Path, about: dict[str, Any]) -> None:
    """Write both files, each whole or not at all.

    Raises:
        StorageError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {"key": np.array(ensemble_key(found.problem))}
    for number, each in enumerate(found.runs):
        arrays[f"scores_{number}"], arrays[f"curves_{number}"] = each.scores, each.curves
        arrays[f"counts_{number}"], arrays[f"failed_{number}"] = each.runs_of_batch, each.failed
    write_atomically(folder / RUNS, lambda file: np.savez_compressed(file, **arrays))
    text = json.dumps(as_dict(found) | about, indent=2, allow_nan=False) + "\n"
    write_atomically(folder / TABLE, lambda file: file.write(text.encode()))


def load_ensemble(problem: EnsembleProblem, folder: Path) -> Ensemble | None:
    """The runs of that folder; None where there are none, or none of this problem and this program."""
    try:
        with np.load(folder / RUNS, allow_pickle=False) as stored:
            if str(stored["key"]) != ensemble_key(problem):
                return None
            runs = tuple(
                FilterRuns(
                    each.label,
                    *(stored[f"{name}_{number}"] for name in ("scores", "curves", "counts", "failed")),
                )
                for number, each in enumerate(problem.filters)
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        # Not there, or damaged: the runs are made again.
        return None
    return Ensemble(problem, runs)


def as_dict(found: Ensemble) -> dict[str, Any]:
    """Plain values for JSON; what is not known is null."""
    ratios = found.ratios()
    rows = []
    for each in found.runs:
        row: dict[str, Any] = {"label": each.label, "runs": len(each.scores), "failures": each.failures}
        for name, number in each.metrics().items():
            row[name], row[f"{name}_standard_error"] = _told(number.value), _told(number.standard_error)
        if each.label in ratios:
            ratio = ratios[each.label]
            row["position_rmse_ratio"] = [_told(ratio.value), _told(ratio.low), _told(ratio.high)]
        row["deviation_from_back_end"] = found.deviations.get(each.label)
        rows.append(row)
    return {
        "experiment": found.problem.name,
        "seeds": found.seeds,
        "slamcmp": slamcmp.__version__,
        "key": ensemble_key(found.problem),
        "left_out": list(found.problem.left_out),
        "filters": rows,
    }


def _told(number: float) -> float | None:
    return number if math.isfinite(number) else None
