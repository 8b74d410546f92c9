"""Shipped experiments with first estimates: none of them is far from the present ones (far_points.py).

Seed 0 of each, and P2's seed 33, on which a first estimate lies as far off as on no other of its fifty.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

import slamcmp
from slamcmp.backends.filters.variants import FirstEstimatesEkf, ObservabilityConstrainedEkf
from slamcmp.backends.window.sliding_window import SlidingWindow
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.protocols import BackEnd
from slamcmp.types import Problem

KINDS: dict[str, Callable[[Problem], BackEnd]] = {
    "FEJ": lambda problem: FirstEstimatesEkf(problem, new_landmarks="update_first"),
    "OC": lambda problem: ObservabilityConstrainedEkf(problem, new_landmarks="update_first"),
    "FEJ window": lambda problem: SlidingWindow(problem, window=5, linearisation="fej", tolerance=1e-4),
}


@pytest.mark.parametrize(
    ("name", "seed", "kinds"),
    [
        ("quickstart", 0, ["FEJ", "OC"]),
        ("observability", 0, ["FEJ", "OC"]),
        ("dial", 0, ["FEJ", "OC", "FEJ window"]),
        # Of windows the dial's is enough: 2500 frames would take ten seconds.
        ("anchors/p2", 0, ["FEJ", "OC"]),
        ("anchors/p2", 33, ["FEJ", "OC"]),
    ],
)
def test_shipped_experiments_keep_near_their_first_estimates(name: str, seed: int, kinds: list[str]) -> None:
    experiment = load_experiment(find_experiment(name))
    source, front_end = experiment.source, experiment.front_end
    stream = slamcmp.make_stream(
        source.name, seed, front_end={"name": front_end.name, **front_end.parameters}, **source.parameters
    )
    for kind in kinds:
        back_end = KINDS[kind](stream.problem)
        for frame in stream.frames:
            back_end.update(frame)
