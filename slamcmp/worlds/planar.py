"""The planar landmark worlds: seeded, with known truth, for controlled experiments.

Each function below decides only where the robot drives and where landmarks stand; every other parameter is
a field of :class:`~slamcmp.worlds.settings.Settings`, shared by all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, MultipleOf

from slamcmp.errors import UsageError
from slamcmp.models.sensors import make_sensor
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.support.configuration.shared_settings import SharedSettings
from slamcmp.types import BoolArray, FloatArray, Log
from slamcmp.worlds import paths
from slamcmp.worlds.in_view import landmarks_for
from slamcmp.worlds.settings import NotNegative, Positive, Settings, field_docs
from slamcmp.worlds.simulate import World, simulate

Builder = Callable[..., World]
Source = Callable[..., Log]


def planar_world(name: str, **defaults: Any) -> Callable[[Builder], Source]:
    """Turn ``build(settings, path_generator, map_generator, *, own…) -> World`` into a registered source.

    The source is called as ``source(seed, **parameters)``; its parameters are the shared settings (with
    ``defaults`` in place of theirs) and the builder's own.
    """

    def decorate(build: Builder) -> Source:
        shared = SharedSettings(name, build, Settings, defaults)

        def source(seed: int, **parameters: Any) -> Log:
            settings, own = shared.split(parameters)
            streams = random_streams(seed)
            path_generator, map_generator = streams.world.spawn(2)
            if settings.map_seed is not None:
                map_generator = np.random.default_rng(settings.map_seed)
            world = build(settings, path_generator, map_generator, **own)
            return simulate(name, world, settings, streams)

        register = sources.register(
            name, seeded=True, parameter_docs=field_docs, contradictions=lambda **given: shared.split(given)
        )
        return register(shared.signed(source))

    return decorate


@planar_world("circle")
def circle(
    settings: Settings,
    path_generator: np.random.Generator,  # noqa: ARG001
    map_generator: np.random.Generator,
    *,
    layout: Literal["ring", "annulus"] = "annulus",
    ring_offset_m: float = 3.0,
    annulus_min_m: NotNegative = 0.5,
    annulus_max_m: Positive = 5.0,
    in_view: Positive | None = None,
) -> World:
    """Round and round on a circle, landmarks evenly on a ring or at random on both sides of the path.

    ``ring`` stands ``ring_offset_m`` outside the path; ``annulus`` draws a distance between
    ``annulus_min_m`` and ``annulus_max_m`` from the path, outside or inside with equal chance; on a path
    of a smaller radius than that, inside goes on beyond the centre. With ``in_view`` there are so many
    landmarks, in place of ``landmarks``, that on average this number is in sight: laps of another length, or
    another range, then leave the density as it was.
    """
    if annulus_min_m > annulus_max_m:
        raise UsageError(
            f"annulus_min_m is {annulus_min_m:g} and annulus_max_m {annulus_max_m:g}: "
            "the largest distance must not be below the smallest"
        )
    turn = math.radians(settings.turn_deg_s)
    radius = settings.speed_m_s / turn
    controls = np.tile([settings.speed_m_s, turn], (settings.steps - 1, 1))
    count = settings.landmarks
    if in_view is not None:
        gaps = np.linspace(annulus_min_m, annulus_max_m, 101)
        where = np.array([ring_offset_m]) if layout == "ring" else np.concatenate([gaps, -gaps])
        count = landmarks_for(in_view, _seen_from_a_circle(settings, radius, radius + where))
    if layout == "ring":
        angles = np.arange(count) * 2 * math.pi / count
        distances = np.full(count, radius + ring_offset_m)
    else:
        draws = map_generator.random((count, 3))
        angles = 2 * math.pi * draws[:, 0]
        gaps = annulus_min_m + (annulus_max_m - annulus_min_m) * draws[:, 1]
        distances = np.where(draws[:, 2] < 0.5, radius + gaps, radius - gaps)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return World(controls, np.array([0.0, radius]) + distances[:, None] * directions)


def _seen_from_a_circle(settings: Settings, radius: float, distances: FloatArray) -> BoolArray:
    """Which points all round, at these distances from the centre, are seen on the path, (distances, 720)."""
    angles = np.linspace(0.0, 2 * math.pi, 720, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.array([0.0, radius]) + distances[:, None, None] * directions
    away, bearing = np.moveaxis(make_sensor("range_bearing", {}).predict(np.eye(3), points), -1, 0)
    seen: BoolArray = (settings.range_min_m <= away) & (away <= settings.range_max_m)
    seen &= np.abs(bearing) <= math.radians(settings.field_of_view_deg) / 2
    return seen


@planar_world("random", steps=400, turn_deg_s=20.0)
def random(
    settings: Settings,
    path_generator: np.random.Generator,
    map_generator: np.random.Generator,
    *,
    half_size_m: Positive = 20.0,
) -> World:
    """A walk between random waypoints in a square with uniformly spread landmarks."""
    controls = paths.wander(
        path_generator,
        settings.steps,
        settings.speed_m_s,
        math.radians(settings.turn_deg_s),
        half_size_m,
        settings.time_step_s,
    )
    return World(controls, map_generator.uniform(-half_size_m, half_size_m, (settings.landmarks, 2)))


@planar_world("corridor", turn_deg_s=45.0, range_max_m=6.0)
def corridor(
    settings: Settings,
    path_generator: np.random.Generator,  # noqa: ARG001
    map_generator: np.random.Generator,
    *,
    length_m: Positive = 60.0,
    wall_gap_m: NotNegative = 1.0,
) -> World:
    """Up and down a long corridor with landmarks on both walls: drift grows, the way back closes it.

    The walls stand ``wall_gap_m`` outside the two lanes; landmarks take turns between them at even spacing,
    moved by up to half of it.
    """
    radius = _bend_radius(settings)
    spacing = length_m / settings.landmarks
    jitter = map_generator.uniform(-0.5, 0.5, settings.landmarks)
    along = (np.arange(settings.landmarks) + 0.5 + jitter) * spacing
    left = np.arange(settings.landmarks) % 2 == 1
    across = np.where(left, 2 * radius + wall_gap_m, -wall_gap_m)
    return World(_drive(paths.stadium(length_m, radius), settings), np.stack([along, across], axis=-1))


@planar_world("figure_eight")
def figure_eight(
    settings: Settings,
    path_generator: np.random.Generator,  # noqa: ARG001
    map_generator: np.random.Generator,
    *,
    margin_m: NotNegative = 4.0,
) -> World:
    """A circle to the left and one to the right, landmarks uniform in the box around them."""
    radius = _bend_radius(settings)
    reach = np.array([radius + margin_m, 2 * radius + margin_m])
    landmarks = map_generator.uniform(-reach, reach, (settings.landmarks, 2))
    return World(_drive(paths.figure_eight(radius), settings), landmarks)


@planar_world("lawnmower", steps=400, turn_deg_s=30.0, landmarks=60)
def lawnmower(
    settings: Settings,
    path_generator: np.random.Generator,  # noqa: ARG001
    map_generator: np.random.Generator,
    *,
    length_m: Positive = 25.0,
    rows: Annotated[int, Ge(2), MultipleOf(2)] = 6,
    margin_m: NotNegative = 2.0,
) -> World:
    """Parallel lanes over a field and back to the start, landmarks uniform over the field."""
    if rows < 2 or rows % 2:
        raise UsageError(f"lawnmower: rows is {rows}; an even number is needed, so that the course closes")
    radius = _bend_radius(settings)
    low = np.array([-radius - margin_m, -margin_m])
    high = np.array([length_m + radius + margin_m, 2 * radius * (rows - 1) + margin_m])
    landmarks = map_generator.uniform(low, high, (settings.landmarks, 2))
    return World(_drive(paths.lawnmower(length_m, radius, rows), settings), landmarks)


def _bend_radius(settings: Settings) -> float:
    return settings.speed_m_s / math.radians(settings.turn_deg_s)


def _drive(legs: list[paths.Leg], settings: Settings) -> FloatArray:
    return paths.drive(legs, settings.steps, settings.speed_m_s, settings.time_step_s)
