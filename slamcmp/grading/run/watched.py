"""A submission's functions, looked at before anybody computes with what they answer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves, relative_error
from slamcmp.grading.run.trial import Implementation
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.grading.sandbox.pipes.answers import Answer
from slamcmp.types import FloatArray, Frame, Problem

ROWS_MORE = 10_000
"""Entries that an answer may have beyond fifty times the reference's: lists of points differ in length."""
_SAME = 1e-9


class Watched:
    """Passes requests on to ``student`` and holds every answer against the reference's to the same question.

    An answer has to be built like the reference's (as many outputs, numbers where numbers are, as many axes,
    all but the first of the same length), so that no arithmetic behind it broadcasts or runs out of memory.

    Args:
        student: the submission.
        reference: the solution, asked with the arguments that the submission got.
    """

    def __init__(self, student: Implementation, reference: Implementation) -> None:
        self._student = student
        self._reference = reference
        self.asked: set[str] = set()
        """Functions called up to now."""
        self.idle: set[str] = set()
        """Those that once gave back their arguments, or zeros, where the reference does not."""
        self.not_finite: set[str] = set()
        """Those that once answered with NaN or infinity, where the reference does not."""

    def call(self, name: str, *arguments: Any) -> Any:
        answer = self._student.call(name, *arguments)
        self.asked.add(name)
        try:
            expected = self._reference.call(name, *arguments)
        except StudentError:
            # Arguments that a wrong answer led to may be none that the solution can take.
            _bounded(name, answer)
            return answer
        own, right = numbers_of(name, answer, expected)
        if any(np.isfinite(b).all() and not np.isfinite(a).all() for a, b in zip(own, right, strict=True)):
            self.not_finite.add(name)
        elif _idle(own, right, arguments):
            self.idle.add(name)
        return _like(answer, expected)

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        return self._student.construct(name, problem, parameters)

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        return self._student.step(handle, frame, landmarks=landmarks, joint_covariance=joint_covariance)

    def cpu_s(self) -> float:
        return self._student.cpu_s()


def numbers_of(name: str, answer: Any, expected: Any) -> tuple[list[FloatArray], list[FloatArray]]:
    """The outputs that are numbers, of both.

    Raises:
        StudentError: the answer is built in another way.
    """
    given, wanted = dict(leaves(answer)), dict(leaves(expected))
    if given.keys() != wanted.keys():
        # A list where an array was asked for is as good, if its numbers are.
        given = {path: _at(answer, path, name, len(wanted)) for path in wanted}
    own, right = [], []
    for path, leaf in wanted.items():
        if leaf is None or isinstance(leaf, str):
            continue
        b = np.asarray(leaf, dtype=np.float64)
        what = f"output {int(path[0]) + 1} of {name}" if path and isinstance(path[0], int) else name
        a = _numbers(given[path], what, b.shape)
        if a.ndim != b.ndim or a.shape[1:] != b.shape[1:] or a.size > 50 * b.size + ROWS_MORE:
            raise StudentError("ValueError", f"{what} has shape {a.shape}; {b.shape} is needed")
        own.append(a)
        right.append(b)
    return own, right


def _like(answer: Any, expected: Any) -> Any:
    """The answer built as the reference's: lists where it has arrays become arrays."""
    if isinstance(expected, np.ndarray):
        return np.asarray(answer, dtype=np.float64 if expected.dtype.kind == "f" else None)
    if isinstance(expected, list | tuple):
        return type(expected)(_like(answer[number], each) for number, each in enumerate(expected))
    if isinstance(expected, dict):
        return {key: _like(answer[key], each) for key, each in expected.items()}
    return answer


def _at(answer: Any, path: tuple[int | str, ...], name: str, outputs: int) -> Any:
    try:
        for step in path:
            answer = answer[step]
    except (TypeError, KeyError, IndexError) as error:
        raise StudentError("ValueError", f"{name} does not return the {outputs} outputs asked for") from error
    return answer


def _numbers(value: Any, what: str, shape: tuple[int, ...]) -> FloatArray:
    if value is None:
        raise StudentError("TypeError", f"{what} is None; is a return statement missing?")
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        kind = type(value).__name__
        raise StudentError("TypeError", f"{what} is {kind}; an array of shape {shape} is needed") from error


def _bounded(name: str, answer: Any) -> None:
    size = sum(math.prod(np.shape(leaf)) for _, leaf in leaves(answer) if not isinstance(leaf, str))
    if size > 50 * ROWS_MORE:
        raise StudentError("ValueError", f"{name} answers with {size} numbers")


def _idle(own: list[FloatArray], right: list[FloatArray], arguments: tuple[Any, ...]) -> bool:
    """Whether nothing was done: every output is an argument, grown by constants or not, or a constant.

    Where the reference gives the same, it is right to.
    """
    pairs = [(a, b) for a, b in zip(own, right, strict=True) if a.shape == b.shape]
    if not own or all(relative_error(a, b) <= _SAME for a, b in pairs):
        return False
    inputs = [np.asarray(leaf, dtype=np.float64) for _, leaf in leaves(list(arguments)) if _is_numeric(leaf)]
    return all(not a.any() or any(_grown(a, given) for given in inputs) for a in own)


def _grown(answer: FloatArray, given: FloatArray) -> bool:
    """Whether an answer is what was given, with zeros and a diagonal behind it."""
    if answer.ndim != given.ndim or any(a < b for a, b in zip(answer.shape, given.shape, strict=True)):
        return False
    rest = answer.copy()
    old = tuple(slice(0, size) for size in given.shape)
    rest[old] = 0.0
    if rest.ndim == 2 and rest.shape[0] == rest.shape[1]:
        np.fill_diagonal(rest, 0.0)
    return bool(np.array_equal(answer[old], given) and not rest.any())


def _is_numeric(leaf: Any) -> bool:
    return isinstance(leaf, int | float | np.ndarray)
