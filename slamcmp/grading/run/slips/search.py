"""Which slip of the solution explains a function's answers, if one does."""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Sequence, Set
from types import ModuleType
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.diagnosis import answered_alike, differs_in_numbers
from slamcmp.grading.run.implementations import Remembered, TrustedImplementation
from slamcmp.grading.run.slips.kinds import VAGUE
from slamcmp.grading.run.slips.making import TICK, Slip, counted, functions_called, slips
from slamcmp.grading.sandbox.errors import StudentError

CALLS = 60
"""Calls that a slip has to explain, the wrong ones before the others."""
_STEPS_MORE = 3, 50
"""A loop ends where it has taken so many times the steps of the solution, and so many more."""
_STEPS_MAX = 1_000_000
_STEPS_ALL, _STEPS_OF_CALL = 500_000, 20
_SEARCH_S = 5.0
"""A search ends with so many steps of loops, a call counting as some, or so much processor time, where a
function is slow without a loop. Slips of helpers come last."""


class SlipSearch:
    """The solution in a module of its own, in which functions are exchanged and no loop is endless.

    Args:
        source: the solution.
        asked: functions that students write themselves.
    """

    def __init__(self, source: str, asked: Set[str]) -> None:
        self._source, self._asked = source, frozenset(asked)
        self._module = ModuleType("slamcmp_slips")
        self._left: dict[str, Sequence[Slip]] = {}
        """Of each function looked at, the slips that explain it."""
        self._steps, self._steps_taken, self._steps_max = 0, 0, _STEPS_MAX
        self._steps_spent = 0
        exec(compile(counted(source), "solution", "exec"), self._module.__dict__)
        setattr(self._module, TICK, self._tick)

    def answer(self, asked: Remembered) -> Any:
        """What the solution answers to the same question."""
        self._steps = 0
        self._steps_spent += _STEPS_OF_CALL
        try:
            with warnings.catch_warnings(action="ignore"):
                return TrustedImplementation(self._module).call(asked.name, *asked.arguments)
        except StudentError as error:
            return f"{error.type_name}: {error.message}"

    def others_to_blame(self, function: str, calls: Sequence[Remembered]) -> bool:
        """Whether a function that it calls has given a wrong answer by itself; an object may call any."""
        of_object = any(each.name == function and not each.arguments for each in calls)
        called = self._asked if of_object else functions_called(self._source, function) & self._asked
        return any(each.name in called and each.arguments and self._is_wrong(each) for each in calls)

    def said(self, function: str, calls: Sequence[Remembered]) -> str:
        """What the slip does otherwise whose answers are those of all calls of a function, or nothing.

        Args:
            function: whose answers are wrong.
            calls: what was asked up to now, of all functions, and what was answered.
        """
        own = [each for each in calls if each.name == function and each.arguments]
        self._steps_taken, self._steps_max = 0, _STEPS_MAX
        right = [(each, self.answer(each)) for each in own]
        times, more = _STEPS_MORE
        self._steps_max = times * self._steps_taken + more
        wrong = [(each, expected) for each, expected in right if not answered_alike(each.answer, expected)]
        if not wrong or not all(_tells(each.answer, expected) for each, expected in wrong):
            return ""
        fine = [pair for pair in right if answered_alike(pair[0].answer, pair[1])]
        looked_at = [each for each, _ in (*wrong, *fine)][:CALLS]
        left = self._left.get(function)
        candidates = _slips(self._source, function, self._asked) if left is None else left
        self._steps_spent, began = 0, time.process_time()
        # What a call has spoken against, no later call speaks for.
        self._left[function] = [
            slip
            for slip in candidates
            if self._steps_spent < _STEPS_ALL
            and time.process_time() - began < _SEARCH_S
            and self._explains(slip, looked_at)
        ]
        return _agreed(self._left[function], choices_only=all(_is_choice(each.answer) for each, _ in wrong))

    def _is_wrong(self, call: Remembered) -> bool:
        return not answered_alike(call.answer, self.answer(call))

    def _explains(self, slip: Slip, calls: Sequence[Remembered]) -> bool:
        before = getattr(self._module, slip.changed)
        exec(slip.code, self._module.__dict__)
        try:
            return all(answered_alike(each.answer, self.answer(each)) for each in calls)
        finally:
            setattr(self._module, slip.changed, before)

    def _tick(self) -> None:
        self._steps += 1
        self._steps_spent += 1
        self._steps_taken = max(self._steps_taken, self._steps)
        if self._steps > self._steps_max:
            raise StudentError("RuntimeError", "a loop without end")


@functools.lru_cache(maxsize=64)
def _slips(source: str, function: str, asked: frozenset[str]) -> tuple[Slip, ...]:
    return tuple(slips(source, function, asked))


def _tells(answer: Any, expected: Any) -> bool:
    """Whether a wrong answer says how it came about: nothing does that is not finite, or zero all through."""
    if isinstance(answer, str) or not differs_in_numbers(answer, expected):
        return False
    try:
        numbers = [np.asarray(leaf, dtype=np.float64) for _, leaf in leaves(answer) if leaf is not None]
    except (TypeError, ValueError, OverflowError):
        return False
    return all(np.isfinite(each).all() for each in numbers) and any(each.any() for each in numbers)


def _is_choice(answer: Any) -> bool:
    """Whether an answer chooses among few (indices, yes or no), as many a mistake does by chance."""
    return all(np.asarray(leaf).dtype.kind in "biu" for _, leaf in leaves(answer))


def _agreed(found: Sequence[Slip], *, choices_only: bool) -> str:
    """What all of them say: changes of one kind are one mistake, looked at in several places."""
    kinds = {slip.kind for slip in found}
    for vague in () if choices_only else VAGUE:
        if len(kinds) > 1:
            kinds.discard(vague)
    found = [slip for slip in found if slip.kind in kinds]
    if len(kinds) != 1:
        return ""
    named = {slip.named for slip in found if slip.named}
    if len(named) == 1:
        return named.pop()
    widest = max(found, key=lambda slip: len(slip.part))
    return widest.kind + (f", in the part with {_listed(widest.part)}" if widest.part else "")


def _listed(names: Sequence[str]) -> str:
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), names[-1]])
