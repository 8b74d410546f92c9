"""Series that several metrics of one run are made of, computed once.

Seven metrics of a trajectory ask for the same NEES. What was asked of the last few trajectories is kept, for
as long as these are; arrays of a trajectory and of a truth cannot be written to, so an answer stays right.
"""

from __future__ import annotations

import functools
import weakref
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from slamcmp.types import FloatArray, GroundTruth, Trajectory

KEPT = 8
"""Answers: online and final, whole, position and heading, and two to spare."""
How = TypeVar("How")
Answer = TypeVar("Answer", bound=FloatArray | tuple[FloatArray, FloatArray])


def remembered(
    function: Callable[[Trajectory, GroundTruth, How], Answer],
) -> Callable[[Trajectory, GroundTruth, How], Answer]:
    """The function, which answers the same question about the same two objects from memory.

    Its third argument says how it is asked; its answers cannot be written to.
    """
    kept: deque[tuple[weakref.ref[Trajectory], weakref.ref[GroundTruth], How, Answer]] = deque(maxlen=KEPT)

    @functools.wraps(function)
    def asked(trajectory: Trajectory, truth: GroundTruth, how: How) -> Answer:
        for of_trajectory, of_truth, before, answer in kept:
            if of_trajectory() is trajectory and of_truth() is truth and before == how:
                return answer
        answer = function(trajectory, truth, how)
        arrays = answer if isinstance(answer, tuple) else (answer,)
        for array in arrays:
            array.setflags(write=False)
        kept.append((weakref.ref(trajectory), weakref.ref(truth), how, answer))
        return answer

    return asked
