"""From an experiment's file to what the program of an ensemble is told; what it cannot run is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slamcmp.backends.far_points import FARTHEST as FARTHEST_POINT
from slamcmp.ensembles.kernels import settings as at
from slamcmp.errors import UsageError
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.config.experiment import Experiment
from slamcmp.types import FloatArray, GroundTruth, IntArray, Log
from slamcmp.worlds.outliers import OutlierRates
from slamcmp.worlds.settings import Settings

FILTERS: Mapping[str, tuple[int, int]] = {
    "ekf_slam": (at.WORLD, at.LATEST),
    "ekf_world": (at.WORLD, at.LATEST),
    "ekf_right_invariant": (at.RIGHT, at.LATEST),
    "ekf_fej": (at.WORLD, at.FIRST),
    "ekf_oc": (at.WORLD, at.CONSTRAINED),
    "ekf_ideal": (at.WORLD, at.TRUTH),
}
"""Chart and policy of each back end that has a program."""
_DECIDED = {"new_landmarks", "new_landmark_jacobian"}
"""Their parameters that the program knows; others have to be at their defaults."""


@dataclass(frozen=True)
class EnsembleFilter:
    """A back end of the experiment, as the program knows it."""

    component: Component
    options: IntArray
    """See kernels/settings.py."""

    @property
    def label(self) -> str:
        """The experiment's."""
        return self.component.label


@dataclass(frozen=True)
class EnsembleProblem:
    """A world and the filters that run in it."""

    name: str
    numbers: FloatArray
    """See kernels/settings.py."""
    path: FloatArray
    """True poses: cosine, sine, x, y, (K, 4)."""
    controls: FloatArray
    """True speed [m/s] and turn rate [rad/s] of each step, (K - 1, 2)."""
    landmarks: FloatArray
    """(L, 2) [m]; of one map where each run has its own."""
    most: int
    """Landmarks that can be in sight at once."""
    filters: tuple[EnsembleFilter, ...]
    left_out: tuple[str, ...]
    """Back ends of the experiment without a program, and why."""

    @property
    def own_maps(self) -> bool:
        """Whether each run draws its own landmarks."""
        return bool(self.filters[0].options[at.OWN_MAP])

    @property
    def polar(self) -> bool:
        """Whether the sensor measures range and bearing, not relative positions."""
        return bool(self.filters[0].options[at.POLAR])


def ensemble_problem(experiment: Experiment) -> EnsembleProblem:
    """What the program is told of an experiment.

    Raises:
        UsageError: its world, its front end or all of its back ends are not among those that have a program.
    """
    settings, own = _settings(experiment)
    _check_front_end(experiment.front_end)
    if experiment.sweep:
        raise UsageError(
            f"{experiment.name}: an ensemble is one world, and this experiment sweeps "
            f"{', '.join(experiment.sweep)}; give each value an experiment of its own (extends: …)"
        )
    log: Log = experiment.source.plugin().target(0, **experiment.source.arguments())
    assert log.truth is not None
    path = _path(log.truth)
    own_maps = own.get("layout") == "annulus" and settings.map_seed is None
    landmarks = np.array(log.truth.positions, dtype=np.float64)
    base = np.zeros(at.OPTIONS, dtype=np.int64)
    base[at.POLAR] = settings.sensor == "range_bearing"
    base[at.FIRST_LOOK], base[at.PARTS] = settings.first_look, settings.process_substeps
    base[at.OWN_MAP] = own_maps
    filters, left_out = _filters(experiment, base)
    turn = math.radians(settings.turn_deg_s)
    return EnsembleProblem(
        experiment.name,
        _numbers(settings, own),
        path,
        np.tile([settings.speed_m_s, turn], (settings.steps - 1, 1)),
        landmarks,
        len(landmarks) if own_maps else _most_in_sight(path, landmarks, settings),
        filters,
        left_out,
    )


def _settings(experiment: Experiment) -> tuple[Settings, dict[str, Any]]:
    source = experiment.source
    if source.name != "circle":
        raise UsageError(
            f"{experiment.name}: ensembles run in the world 'circle', and the source is {source.name!r}"
        )
    settings, own = source.plugin().traits["contradictions"](**source.parameters)
    if settings.odometry != "straight_then_turn":
        raise UsageError(
            f"{experiment.name}: source.odometry is {settings.odometry!r}; "
            "ensembles have 'straight_then_turn' alone"
        )
    clean = OutlierRates(burst_frames=settings.burst_frames, slip_share=settings.slip_share)
    if settings.outlier_fraction or settings.outlier_rates() != clean:
        raise UsageError(f"{experiment.name}: ensembles have no outliers, and the source has")
    return settings, own


def _check_front_end(front_end: Component) -> None:
    wanted = {"gate_probability": None, "min_sightings": 1}
    parameters = front_end.parameters
    wrong = [name for name, value in wanted.items() if parameters.get(name, value) != value]
    if front_end.name != "labelled" or "gate_probability" not in parameters or wrong:
        raise UsageError(
            "an ensemble has no front end of its own: it takes every measurement by its label; needed is "
            "front_end: {name: labelled, gate_probability: null}"
        )
    view = math.radians(parameters["field_of_view_deg"])
    if parameters["range_min_m"] > 0 or math.isfinite(parameters["range_max_m"]) or view < 2 * math.pi:
        raise UsageError("an ensemble has the sensor's limits alone: set them in source, not in front_end")


def _filters(experiment: Experiment, base: IntArray) -> tuple[tuple[EnsembleFilter, ...], tuple[str, ...]]:
    filters, left_out = [], []
    for each in experiment.back_ends:
        known = FILTERS.get(each.name)
        defaults = {name: value.default for name, value in each.plugin().parameters().items()}
        others = [
            f"{name}: {value}"
            for name, value in each.parameters.items()
            if name not in _DECIDED and value != defaults.get(name)
        ]
        if known is None or others or each.own_gate is not None:
            why = (
                f"{each.name} has no program"
                if known is None
                else f"not with {', '.join(others) or 'a gate'}"
            )
            left_out.append(f"{each.label}: {why}")
            continue
        options = base.copy()
        options[at.CHART], options[at.POLICY] = known
        if each.parameters.get("new_landmark_jacobian") == "updated":
            options[at.POLICY] = at.FIRST_BUT_NEW
        options[at.JOIN_FIRST] = each.parameters.get("new_landmarks") == "join_first"
        filters.append(EnsembleFilter(each, options))
    if not filters:
        raise UsageError(
            f"{experiment.name}: none of its back ends has a program for ensembles ({'; '.join(left_out)}); "
            f"those that have: {', '.join(FILTERS)}"
        )
    return tuple(filters), tuple(left_out)


def _numbers(settings: Settings, own: Mapping[str, Any]) -> FloatArray:
    numbers = np.zeros(at.NUMBERS)
    noise = settings.noise_scale
    wheels = noise * settings.odometry_scale
    numbers[at.TIME_STEP] = settings.time_step_s
    # A rate's noise acts for a part of the step alone: see worlds/simulate.py.
    share = math.sqrt(settings.process_substeps)
    numbers[at.SPEED_SIGMA] = wheels * share * settings.speed_sigma_m_s
    numbers[at.TURN_SIGMA] = wheels * share * math.radians(settings.turn_sigma_deg_s)
    numbers[at.LATERAL_SIGMA] = wheels * settings.lateral_sigma_m
    first = second = settings.position_sigma_m
    if settings.sensor == "range_bearing":
        first, second = settings.range_sigma_m, math.radians(settings.bearing_sigma_deg)
    numbers[at.FIRST_SIGMA], numbers[at.SECOND_SIGMA] = noise * first, noise * second
    numbers[at.NEAREST], numbers[at.FARTHEST] = settings.range_min_m, settings.range_max_m
    numbers[at.HALF_VIEW] = math.radians(settings.field_of_view_deg) / 2
    numbers[at.PRIOR_POSITION] = noise * settings.prior_position_sigma_m
    numbers[at.PRIOR_HEADING] = noise * settings.prior_heading_sigma_rad
    numbers[at.TOO_FAR] = FARTHEST_POINT
    numbers[at.RADIUS] = settings.speed_m_s / math.radians(settings.turn_deg_s)
    numbers[at.GAP_MIN], numbers[at.GAP_MAX] = own.get("annulus_min_m", 0.5), own.get("annulus_max_m", 5.0)
    return numbers


def _path(truth: GroundTruth) -> FloatArray:
    T = truth.T_world_body
    return np.ascontiguousarray(np.stack([T[:, 0, 0], T[:, 1, 0], T[:, 0, 2], T[:, 1, 2]], axis=-1))


def _most_in_sight(path: FloatArray, landmarks: FloatArray, settings: Settings) -> int:
    """One more than are seen at once from the true path: last bits may see another at the border."""
    away = np.linalg.norm(path[:, None, 2:] - landmarks, axis=-1)
    near = (settings.range_min_m <= away) & (away <= settings.range_max_m)
    return min(len(landmarks), 1 + int(near.sum(axis=1).max()))
