"""How far an answer is from the reference's: every entry against its own scale, and what rounding explains.

An entry's scale is the size that it usually has: a heading [rad] is not judged by the metres beside it, nor
a landmark near by by one far off. A covariance's entry ij belongs to the two standard deviations, σᵢ σⱼ: by
the inequality of Cauchy and Schwarz it is never larger.

How much rounding explains is found by asking the reference once more, in single precision: with arguments
rounded and, where its own code lets them, in single precision all through. Where the equations are
ill-conditioned or lose digits its answer moves, and an honest computation is not bound to be nearer: the
forward error is about the condition times the backward error (Higham 2002, *Accuracy and Stability of
Numerical Algorithms*, sec. 1.6).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from slamcmp.grading.results.scoring import leaves, log_linear
from slamcmp.grading.run.implementations import TrustedImplementation
from slamcmp.grading.run.trial import Implementation
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.grading.sandbox.pipes.answers import Answer
from slamcmp.types import FloatArray, Frame, Problem

STEPS = 500
"""So many times what the reference shifts in single precision counts as rounding. Honest solutions in it
(tests/grading/honest_solutions, 20 seeds) need up to 260, where S is inverted and not solved with."""
SINGLE = float(np.finfo(np.float32).eps) / 2
"""Relative size of one rounding to single precision."""
_OF_ZERO = 0.1
"""Rounding explains no more than this share of the error from which nothing is given."""
_STRUCTURAL = 1e-9
"""Share of the largest entry below which an entry is meant to be zero …"""
_FLOOR = 1e-2
"""… and its scale is this share of the largest."""
_ALIKE = 3
"""Arrays of one shape from which the size of each of their entries can be told."""


def entry_scales(expected: FloatArray, alike: Sequence[FloatArray] = ()) -> FloatArray:
    """The size that each entry is judged by, positive.

    Args:
        expected: the reference's answer, or a stack of answers.
        alike: its answers to other questions of the same kind.
    """
    size = np.abs(expected)
    if expected.ndim >= 2 and expected.shape[-1] == expected.shape[-2]:
        if _are_poses(expected):
            return _pose_scales(expected)
        if _are_covariances(expected):
            deviations = np.sqrt(np.diagonal(size, axis1=-2, axis2=-1))
            products: FloatArray = deviations[..., :, None] * deviations[..., None, :]
            return products
    return _without_zeros(np.maximum(size, _typical(expected, alike)))


def entry_errors(answer: FloatArray, expected: FloatArray, scales: FloatArray) -> FloatArray:
    """Of each entry, relative to its scale; infinite where it is not finite and should be."""
    with np.errstate(invalid="ignore", over="ignore"):
        errors: FloatArray = np.abs(answer - expected) / scales
    same = (answer == expected) | (np.isnan(answer) & np.isnan(expected))
    return np.where(same, 0.0, np.where(np.isfinite(answer), errors, np.inf))


def largest_error(answer: FloatArray, expected: FloatArray, alike: Sequence[FloatArray] = ()) -> float:
    """The largest of :func:`entry_errors`; 0 where there are no entries."""
    errors = entry_errors(answer, expected, entry_scales(expected, alike))
    return float(errors.max(initial=0.0))


@dataclasses.dataclass(frozen=True)
class Closeness:
    """The worst entry of one output."""

    share: float
    """Credit, 0 to 1."""
    error: float
    """Relative to the entry's scale."""
    index: tuple[int, ...]


def judge_entries(
    answer: FloatArray,
    expected: FloatArray,
    *,
    alike: Sequence[FloatArray],
    shifted: Callable[[], Sequence[FloatArray]],
    full: float,
    zero: float,
) -> Closeness:
    """Credit for an output, by its worst entry.

    Args:
        answer: of the shape of ``expected``.
        expected: the reference's.
        alike: the reference's answers to other questions.
        shifted: what the reference answers when its arguments are rounded to single precision; asked for only
            if the answer is not within ``full``.
        full: error relative to the entry's scale up to which all is given, or what rounding explains if more.
        zero: error from which nothing is given.
    """
    if not expected.size:
        return Closeness(1.0, 0.0, ())
    scales = entry_scales(expected, alike)
    errors = entry_errors(answer, expected, scales)
    enough = full
    # Rounding explains less than what earns nothing.
    if full < errors.max() < zero:
        enough = least_rounding(expected, shifted(), scales, full, zero)
    worst = int(np.argmax(errors))
    index = np.unravel_index(worst, errors.shape)
    share = log_linear(float(errors[index]), enough, zero)
    return Closeness(share, float(errors[index]), tuple(int(each) for each in index))


def least_rounding(
    expected: FloatArray, shifted: Sequence[FloatArray], scales: FloatArray, full: float, zero: float
) -> float:
    """The error up to which an entry is right: ``full``, or what rounding to single precision explains.

    That is one number for all entries: the equations that move one of them move what it is computed from.
    """
    shifts = [np.abs(other - expected) / scales for other in shifted if other.shape == expected.shape]
    return rounding_explains([float(shift.max(initial=0.0)) for shift in shifts], full, zero)


def rounding_explains(shifts: Sequence[float], full: float, zero: float) -> float:
    """The same for sizes that are relative already, or residuals that should vanish."""
    finite = [shift for shift in shifts if np.isfinite(shift)]
    return min(max(full, STEPS * max([SINGLE, *finite])), max(full, _OF_ZERO * zero))


class Rounded:
    """An implementation asked with every argument in single precision, rounded at random up or down.

    Args:
        inner: who is asked.
        generator: of the roundings.
    """

    def __init__(self, inner: Implementation, generator: np.random.Generator) -> None:
        self._inner, self._generator = inner, generator

    def call(self, name: str, *arguments: Any) -> Any:
        """As the inner one's."""
        rounded = [self._rounded(argument) for argument in arguments]
        if isinstance(self._inner, TrustedImplementation):
            return self._inner.call_as_given(name, *map(_single, rounded))
        return self._inner.call(name, *rounded)

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        """As the inner one's, the prior exact."""
        return self._inner.construct(name, problem, parameters)

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        """As the inner one's, with the frame's observations and their covariances rounded."""
        if frame is not None:
            frame = dataclasses.replace(frame, z=self._rounded(frame.z), R=self._rounded(frame.R))
        return self._inner.step(handle, frame, landmarks=landmarks, joint_covariance=joint_covariance)

    def cpu_s(self) -> float:
        """As the inner one's."""
        return self._inner.cpu_s()

    def _rounded(self, value: Any) -> Any:
        if isinstance(value, dict):
            return {key: self._rounded(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self._rounded(item) for item in value)
        if isinstance(value, float):
            return value * (1 + SINGLE * float(self._generator.choice([-1.0, 1.0])))
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            signs = self._generator.choice([-1.0, 1.0], size=value.shape)
            if value.ndim >= 2 and _symmetric(value):
                signs = np.sign(signs + np.swapaxes(signs, -1, -2) + 0.5)
            return value * (1 + SINGLE * signs)
        return value


def rounded_answers(
    ask: Callable[[Implementation], Any], reference: Implementation, times: int = 3
) -> list[dict[tuple[int | str, ...], FloatArray]]:
    """What comes out of ``ask`` with the reference in single precision, by the place of each output."""
    found = []
    for seed in range(times):
        try:
            answer = ask(Rounded(reference, np.random.default_rng(seed)))
        except (StudentError, ArithmeticError, np.linalg.LinAlgError):
            # At the edge of what can be computed: nothing is known about rounding.
            continue
        numbers = {
            path: np.asarray(leaf, dtype=np.float64)
            for path, leaf in leaves(answer)
            if leaf is not None and not isinstance(leaf, str)
        }
        found.append(numbers)
    return found


def _single(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _single(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_single(item) for item in value)
    return value.astype(np.float32) if isinstance(value, np.ndarray) and value.dtype.kind == "f" else value


def _typical(expected: FloatArray, alike: Sequence[FloatArray]) -> FloatArray | Literal[0]:
    """The median size of each entry where enough answers have its shape, else over rows as well."""
    same = [np.abs(other) for other in alike if other.shape == expected.shape]
    if len(same) >= _ALIKE:
        return _median(np.stack(same))
    if expected.ndim == 0:
        return _median(np.stack(same)) if same else 0
    width = expected.shape[-1]
    rows = [
        np.abs(other).reshape(-1, width)
        for other in (*alike, expected)
        if other.ndim == expected.ndim and other.ndim >= 2 and other.shape[-1] == width and other.size
    ]
    return _median(np.concatenate(rows)) if rows else 0


def _median(sizes: FloatArray) -> FloatArray:
    finite = np.where(np.isfinite(sizes), sizes, 0.0)
    # Of an even number the smaller one: of two points one may be far off.
    median: FloatArray = np.sort(finite, axis=0)[(len(finite) - 1) // 2]
    return median


def _without_zeros(scales: FloatArray) -> FloatArray:
    scales = np.where(np.isfinite(scales), scales, 0.0)
    largest = float(scales.max(initial=0.0)) or 1.0
    return np.where(scales > _STRUCTURAL * largest, scales, _FLOOR * largest)


def _are_poses(stack: FloatArray) -> bool:
    size = stack.shape[-1]
    last = np.r_[np.zeros(size - 1), 1.0]
    return size in (3, 4) and bool(np.all(stack[..., -1, :] == last))


def _pose_scales(poses: FloatArray) -> FloatArray:
    """1 for what turns; for the position its distance from the origin, a metre at least."""
    scales = np.ones_like(poses)
    far = np.linalg.norm(poses[..., :-1, -1], axis=-1)
    scales[..., :-1, -1] = np.maximum(far, 1.0)[..., None]
    return scales


def _are_covariances(stack: FloatArray) -> bool:
    """Symmetric, with no entry above the product of its two deviations."""
    diagonal = np.diagonal(stack, axis1=-2, axis2=-1)
    if not np.isfinite(stack).all() or not stack.size or np.any(diagonal <= 0) or not _symmetric(stack):
        return False
    deviations = np.sqrt(diagonal)
    return bool(np.all(np.abs(stack) <= (1 + 1e-6) * deviations[..., :, None] * deviations[..., None, :]))


def _symmetric(stack: FloatArray) -> bool:
    if stack.shape[-1] != stack.shape[-2]:
        return False
    largest = np.abs(stack).max(initial=0.0)
    return bool(np.all(np.abs(stack - np.swapaxes(stack, -1, -2)) <= 1e-9 * largest))
