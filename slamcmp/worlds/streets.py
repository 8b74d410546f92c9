"""A town of square blocks, driven at random, with trees that are seen from the crossings.

Made after the public data set cityTrees10000 (its first thousand poses are in gtsam's wheel as
``cityTrees_reduced_1k.g2o``), which has 10 000 poses, 100 trees within 50 m of the start, streets every 5 m
that go on for a block, steps of 1 m, looks at the crossings only, and the noise that is the default here.
Nothing but odometry carries the heading from crossing to crossing: what makes a filter overconfident there.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval, MultipleOf

from slamcmp.errors import UsageError
from slamcmp.geometry import dead_reckoning
from slamcmp.models.sensors import make_sensor
from slamcmp.randomness import random_streams
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem

Positive = Annotated[float, Gt(0)]


@sources.register("streets", seeded=True)
def streets(
    seed: int,
    *,
    steps: Annotated[int, Ge(2)] = 10_000,
    blocks: Annotated[int, Ge(2), MultipleOf(2)] = 20,
    outskirts: Annotated[int, Ge(0)] = 1,
    block_steps: Annotated[int, Ge(1)] = 5,
    step_m: Positive = 1.0,
    time_step_s: Positive = 1.0,
    turn_probability: Annotated[float, Interval(ge=0, le=1)] = 0.25,
    landmarks: Annotated[int, Ge(1)] = 100,
    map_seed: Annotated[int, Ge(0)] | None = None,
    range_max_m: Positive = 8.0,
    translation_sigma_m: Positive = 0.02,
    heading_sigma_rad: Positive = 0.01,
    position_sigma_m: Positive = 0.1,
    prior_position_sigma_m: Positive = 1e-6,
    prior_heading_sigma_rad: Positive = 1e-6,
    resolution: Annotated[float, Ge(0)] = 1e-9,
) -> Log:
    """At random through a square town, trees in the middle of some of its blocks; relative positions.

    From the crossing in the middle the robot drives from one crossing to the next and turns there, in place,
    before it drives on; it never leaves the town.

    Args:
        seed: of the route, the map (but for ``map_seed``), the odometry noise and the sensor noise.
        steps: frames, the first one included.
        blocks: along each side of the square that has trees.
        outskirts: blocks on every side of it that have none.
        block_steps: steps from one crossing to the next.
        step_m: length of a step.
        time_step_s: between frames.
        turn_probability: of a turn at a crossing, to either side alike; where the way on ends, it is certain.
        landmarks: trees, each in a block of its own.
        map_seed: one map for all trials; None: a map a seed.
        range_max_m: farther trees are not seen.
        translation_sigma_m: of the odometry, each axis, a step.
        heading_sigma_rad: of the odometry, a step.
        position_sigma_m: of the sensor, each axis.
        prior_position_sigma_m: of the start, which is known to so much.
        prior_heading_sigma_rad: of the start.
        resolution: what odometry and detections are rounded to, so that two machines' last bits agree;
            0 keeps all bits.

    Raises:
        UsageError: there are more landmarks than blocks.
    """
    if landmarks > blocks**2:
        raise UsageError(f"streets: {landmarks} landmarks in {blocks**2} blocks; one a block is most")
    streams = random_streams(seed)
    route_generator, map_generator = streams.world.spawn(2)
    if map_seed is not None:
        map_generator = np.random.default_rng(map_seed)

    motion = np.tile([step_m, 0.0, 0.0], (steps - 1, 1))
    reach = blocks // 2 + outskirts
    quarters = _corners(route_generator, (steps - 2) // block_steps, reach, turn_probability)
    for step, quarter in zip(range(block_steps, steps - 1, block_steps), quarters, strict=True):
        if quarter:
            # Turned first, the step leads sideways.
            motion[step] = 0.0, quarter * step_m, quarter * math.pi / 2
    prior_noise, step_noise = streams.odometry.spawn(2)
    sigmas: FloatArray = np.array([translation_sigma_m, translation_sigma_m, heading_sigma_rad])
    measured: FloatArray = _rounded(motion + sigmas * step_noise.standard_normal(motion.shape), resolution)
    T_world_body = dead_reckoning(np.eye(3), _increments(motion))

    tree_blocks = map_generator.choice(blocks**2, landmarks, replace=False)
    places = np.stack([tree_blocks % blocks, tree_blocks // blocks], axis=-1).astype(np.float64)
    positions: FloatArray = (places + 0.5 * (1 - blocks)) * (block_steps * step_m)
    sensor = make_sensor("relative_position", {"space_dim": 2})
    detections = []
    for k, T in enumerate(T_world_body):
        # Drawn for every tree, seen or not: another range leaves the other numbers as they are.
        noise = streams.sensor.standard_normal(positions.shape)
        true = sensor.predict(T, positions)
        at_crossing = k > 0 and k % block_steps == 0
        ids = np.flatnonzero(np.linalg.norm(true, axis=1) < range_max_m) if at_crossing else np.arange(0)
        readings = _rounded((true + position_sigma_m * noise)[ids], resolution)
        detections.append(
            Detections(readings, np.tile(position_sigma_m**2 * np.eye(2), (ids.size, 1, 1)), ids)
        )

    prior_sigmas = np.array([prior_position_sigma_m, prior_position_sigma_m, prior_heading_sigma_rad])
    Q = np.tile(np.diag(sigmas**2), (steps, 1, 1))
    Q[0] = 0.0
    t: FloatArray = np.arange(steps, dtype=np.float64) * time_step_s
    return Log(
        name="streets",
        problem=Problem(
            _increments(-prior_sigmas * prior_noise.standard_normal((1, 3)))[1],
            np.diag(prior_sigmas**2),
            sensor,
        ),
        t=t,
        T_prev_body=_increments(measured),
        Q=Q,
        detections=tuple(detections),
        truth=GroundTruth(t, T_world_body, np.arange(landmarks), positions),
    )


def _corners(
    generator: np.random.Generator, crossings: int, reach: int, turn_probability: float
) -> list[int]:
    """Quarters of a turn to the left, -1, 0 or 1, at each of the crossings that come.

    No street leads farther than ``reach`` blocks from the start.
    """
    quarters = []
    x, y, along_x, along_y = 0, 0, 1, 0
    for luck, side in generator.random((crossings, 2)):
        x, y = x + along_x, y + along_y
        ways = {0: (along_x, along_y), 1: (-along_y, along_x), -1: (along_y, -along_x)}
        turn = 1 if side < 0.5 else -1
        # A wish that leads out of town gives way to a turn that does not.
        wishes = (turn if luck < turn_probability else 0, turn, -turn)
        quarter = next(
            wish for wish in wishes if max(abs(x + ways[wish][0]), abs(y + ways[wish][1])) <= reach
        )
        quarters.append(quarter)
        along_x, along_y = ways[quarter]
    return quarters


def _increments(motion: FloatArray) -> FloatArray:
    """Poses (K, 3, 3) for steps (K-1, 3) of x, y and angle; the first is the identity."""
    increments = np.tile(np.eye(3), (len(motion) + 1, 1, 1))
    for increment, (x, y, theta) in zip(increments[1:], motion, strict=True):
        # math.cos comes from the platform's libm; numpy's own depends on the processor's vector width.
        cos, sin = math.cos(theta), math.sin(theta)
        increment[:2] = [[cos, -sin, x], [sin, cos, y]]
    return increments


def _rounded(values: FloatArray, resolution: float) -> FloatArray:
    return values if resolution == 0 else np.round(values / resolution) * resolution
