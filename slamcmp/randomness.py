"""One seed, independent children: changing one source of noise leaves the others as they were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RandomStreams:
    """The generators of one trial, each for one purpose only."""

    world: np.random.Generator
    odometry: np.random.Generator
    sensor: np.random.Generator
    outliers: np.random.Generator
    front_end: np.random.Generator


def random_streams(seed: int) -> RandomStreams:
    """Spawn the five generators of a trial from its seed (a non-negative integer)."""
    children = np.random.SeedSequence(seed).spawn(5)
    return RandomStreams(*(np.random.Generator(np.random.PCG64(child)) for child in children))
