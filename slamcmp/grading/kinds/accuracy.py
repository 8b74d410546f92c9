"""Kind "accuracy": the error of whole runs against the reference's on the same data."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.results.outcome import Plot, Series
from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.trial import Track, Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds
from slamcmp.types import FloatArray


@test_kinds.register("accuracy")
def accuracy(
    trial: Trial,
    *,
    procedure: str,
    runs: Annotated[int, Ge(1)] = 5,
    components: Annotated[int, Ge(1)] = 2,
    unit: str = "m",
    along: str = "time [s]",
    full: Annotated[float, Gt(0)] = 1.05,
    zero: Annotated[float, Gt(0)] = 2.0,
) -> Verdict:
    """RMSE over all steps of all runs, divided by the reference's.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator) -> Track`` of ``cases.py``.
        runs: how many worlds.
        components: the error's first ones that count (a position's).
        unit: of the error.
        along: what the runs' ``t`` is, with its unit.
        full: ratio up to which all points are given.
        zero: ratio from which none are given.
    """
    drive, student = trial.procedure(procedure), Watched(trial.student, trial.reference)
    own: list[Track] = [drive(student, generator) for generator in trial.run_generators(runs)]
    best: list[Track] = [drive(trial.reference, generator) for generator in trial.run_generators(runs)]
    rmse, rmse_reference = (_rmse(tracks, components) for tracks in (own, best))
    ratio = rmse / rmse_reference
    credit = log_linear(ratio, full, zero)
    worst = max(range(len(own)), key=lambda index: _rmse([own[index]], components))
    plot, caption = _error_plot(own[worst], best[worst], components, unit, along)
    message = (
        f"Your error over {len(own)} runs is {_number(rmse)} {unit}, {_number(ratio)} times the "
        f"reference's {rmse_reference:.3g} {unit} on the same data (all points up to {full:g}). {caption}"
    ).strip()
    rank = (("error / reference", round(ratio, 4), "asc"),) if math.isfinite(ratio) else ()
    return Verdict(credit, message, plots=(*_path_plot(own[worst], best[worst]), plot), leaderboard=rank)  # type: ignore[arg-type]


def _rmse(tracks: list[Track], components: int) -> float:
    squares = [np.sum(track.errors[:, :components] ** 2, axis=1) for track in tracks]
    size = float(np.sqrt(np.mean(np.concatenate(squares))))
    return size if math.isfinite(size) else math.inf


def _path_plot(own: Track, best: Track) -> tuple[Plot, ...]:
    """The worst run in the plane, if the assignment tells its paths."""
    if own.path is None or best.path is None or own.true_path is None:
        return ()
    paths: tuple[tuple[str, FloatArray, Literal["truth", "reference", "yours"]], ...] = (
        ("truth", own.true_path, "truth"),
        ("reference", best.path, "reference"),
        ("yours", own.path, "yours"),
    )
    series = tuple(
        Series(name, _finite(path[:, 1]), role, x=_finite(path[:, 0])) for name, path, role in paths
    )
    caption = "Where the robot was, and where the two estimates put it."
    return (Plot("Path of the worst run", "x [m]", "y [m]", (), series, caption, equal_scales=True),)


def _error_plot(own: Track, best: Track, components: int, unit: str, along: str) -> tuple[Plot, str]:
    error, reference = (np.linalg.norm(track.errors[:, :components], axis=1) for track in (own, best))
    series = [Series("yours", _finite(error), "yours"), Series("reference", _finite(reference), "reference")]
    caption = ""
    if own.covariances is not None:
        blocks = own.covariances[:, :components, :components]
        with np.errstate(invalid="ignore"):
            band = 3 * np.sqrt(np.trace(blocks, axis1=1, axis2=2))
        series.append(Series("your 3σ", _finite(band), "band"))
        outside = np.flatnonzero(~(error <= band))
        caption = (
            "Your error never leaves its own 3σ band."
            if outside.size == 0
            else f"In the worst run your error first leaves its own 3σ band at {own.t[outside[0]]:g} s."
        )
    t = tuple(float(value) for value in own.t)
    return Plot("Error of the worst run", along, f"error [{unit}]", t, tuple(series), caption), caption


def _finite(values: FloatArray) -> tuple[float, ...]:
    """Without what JSON cannot hold; curves end at 1e9."""
    return tuple(np.nan_to_num(values, nan=1e9, posinf=1e9, neginf=-1e9).clip(-1e9, 1e9).tolist())


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "not a finite number"
