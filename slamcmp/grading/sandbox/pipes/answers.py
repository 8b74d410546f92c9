"""Turn what a worker says into typed values, trusting none of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.grading.sandbox.errors import SourceLine, StudentError
from slamcmp.support.messages import printable
from slamcmp.types import Estimate, Landmarks, Trajectory


@dataclass(frozen=True)
class Answer:
    """What a back end in the worker answered after a frame; None where it was not asked."""

    estimate: Estimate | None = None
    landmarks: Landmarks | None = None
    joint_covariance: NDArray[np.float64] | None = None
    trajectory: Trajectory | None = None


def read_answer(fields: Any, want: list[str]) -> Answer:
    """The worker's answer to a step, checked for shapes; its numbers may still be anything.

    Raises:
        StudentError: an entry has the wrong type or shape.
    """
    kinds = {"estimate": Estimate, "landmarks": Landmarks, "trajectory": Trajectory}
    made: dict[str, Any] = {}
    for name in want:
        try:
            if name == "joint_covariance":
                joint = np.asarray(fields[name], dtype=np.float64)
                if joint.ndim != 2 or joint.shape[0] != joint.shape[1]:
                    raise DataError(f"joint_covariance(): shape {joint.shape}; a square matrix is needed")
                made[name] = joint
            else:
                made[name] = kinds[name](**fields[name])
        except (DataError, ValueError, TypeError, KeyError, IndexError, OverflowError) as error:
            raise StudentError(
                type(error).__name__, f"{name}() returned what cannot be used: {error}"
            ) from error
    return Answer(**made)


def student_error(told: Any) -> StudentError:
    """The error as the worker told it; every part of it may be made up."""
    told = told if isinstance(told, dict) else {}
    frames = []
    for frame in told["frames"] if isinstance(told.get("frames"), list) else []:
        if isinstance(frame, list) and len(frame) == 4 and type(frame[1]) is int:
            file, line, function, code = frame
            frames.append(SourceLine(_word(file), line, _word(function), _word(code)))
    message = printable(str(told.get("message", ""))[:2000])
    return StudentError(_word(told.get("type", "Error")), message, tuple(frames[:16]))


def _word(text: Any) -> str:
    """On one line: made-up lines could be taken for the grader's own."""
    return printable(str(text)[:200]).replace("\n", " ")
