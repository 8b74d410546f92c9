"""At 20 % outliers in the planar world robust back ends stay within twice their error without outliers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.frontend.labelled import labelled
from slamcmp.registry import back_ends
from slamcmp.types import Trajectory
from slamcmp.worlds.planar import circle

FEW: list[tuple[str, dict[str, Any]]] = [
    ("ekf_slam", {"robust": "huber"}),
    ("ekf_slam", {"robust": "gnc"}),
    ("isam2", {"robust": "huber", "relinearize_skip": 1}),
    ("batch", {"robust": "geman_mcclure"}),
]
ALL = [
    (name, {"robust": kernel, **({"relinearize_skip": 1} if name == "isam2" else {})})
    for name in ("ekf_slam", "ekf_right_invariant", "iterated_ekf", "sliding_window", "isam2", "batch")
    for kernel in ("huber", "cauchy", "geman_mcclure", "dcs", "gnc")
]


def errors(
    cases: list[tuple[str, dict[str, Any]]], seeds: range, share: float, steps: int
) -> list[dict[str, float]]:
    """Root mean square over the seeds of the position error of each case, online and final."""
    squares: list[dict[str, list[float]]] = [{} for _ in cases]
    for seed in seeds:
        log = circle(seed, steps=steps, outlier_fraction=share)
        stream = labelled(log, seed, gate_probability=None)
        for (name, parameters), found in zip(cases, squares, strict=True):
            make = back_ends.get(name).target
            run = run_back_end(
                lambda problem, make=make, parameters=parameters: make(problem, **parameters),
                stream,
                label=name,
                parameters=parameters,
            )
            assert run.status == "ok", run.message
            told: dict[str, Trajectory | None] = {"online": run.online, "final": run.final}
            for column, trajectory in told.items():
                if trajectory is not None:
                    off = trajectory.T_world_body[:, :2, 2] - log.truth.T_world_body[:, :2, 2]
                    found.setdefault(column, []).append(float((off**2).sum(axis=1).mean()))
    return [{column: float(np.sqrt(np.mean(each))) for column, each in found.items()} for found in squares]


def test_both_families_stay_within_twice_their_clean_error() -> None:
    """Three seeds; over the twenty of the slow test no ratio is above 1.4."""
    clean, spoilt = (errors(FEW, range(3), share, 70) for share in (0.0, 0.2))
    for case, before, after in zip(FEW, clean, spoilt, strict=True):
        for column, error in after.items():
            assert error < 2.0 * before[column], (case, column)
    (least_squares,) = errors([("ekf_slam", {})], range(1), 0.2, 70)
    assert least_squares["online"] > 10.0 * spoilt[0]["online"]


@pytest.mark.slow
@pytest.mark.parametrize("case", ALL, ids=lambda case: f"{case[0]}-{case[1]['robust']}")
def test_every_kernel_in_both_families_over_twenty_seeds(case: tuple[str, dict[str, Any]]) -> None:
    (clean,), (spoilt,) = (errors([case], range(20), share, 120) for share in (0.0, 0.2))
    for column, error in spoilt.items():
        assert error < 2.0 * clean[column], column
