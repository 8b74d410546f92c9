"""Turn what a worker says into typed values, trusting none of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.grading.sandbox.errors import SourceLine, StudentError
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
        except (DataError, ValueError, TypeError, KeyError, IndexError) as error:
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
            frames.append(SourceLine(_clean(file, 200), line, _clean(function, 100), _clean(code, 200)))
    return StudentError(
        _clean(told.get("type", "Error"), 200), _clean(told.get("message", ""), 2000), tuple(frames[:16])
    )


def _clean(text: Any, limit: int) -> str:
    """Text without control characters, which could rewrite a terminal."""
    return "".join(letter if letter.isprintable() or letter == "\n" else "�" for letter in str(text)[:limit])
