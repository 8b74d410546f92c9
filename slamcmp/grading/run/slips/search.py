"""Which slip of the solution explains a function's answers, if one does."""

from __future__ import annotations

import contextlib
import functools
import time
import warnings
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.diagnosis import answered_alike, differs_in_numbers
from slamcmp.grading.run.implementations import Drive, Remembered, TrustedImplementation, told
from slamcmp.grading.run.slips.kinds import HALF, HALF_OR_TWICE, TWICE, VAGUE
from slamcmp.grading.run.slips.making import TICK, Slip, counted, functions_called, slips
from slamcmp.grading.sandbox.errors import StudentError

CALLS = 60
"""Calls that a slip has to explain, the wrong ones before the others."""
_DRIVES, _FRAMES, _FRAMES_MORE = 4, 12, 6
"""Of objects, the drives looked at, and so many frames of each; or so many after the first wrong answer."""
_STEPS_MORE = 3, 50
"""A loop ends where it has taken so many times the steps of the solution, and so many more."""
_STEPS_MAX = 1_000_000
_STEPS_ALL, _STEPS_OF_CALL = 500_000, 20
_SEARCH_S = 5.0
"""A search ends with so many steps of loops, a call counting as some, or so much processor time, where a
function is slow without a loop. Slips that say little come last."""


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
        # An error or an empty answer tells nothing, but beside others it has to be explained as they are.
        numbers = [(each, expected) for each, expected in wrong if not _is_silent(each.answer)]
        if not numbers or not all(_tells(each.answer, expected) for each, expected in numbers):
            return ""
        if all(_is_yes_or_no(each.answer, expected) for each, expected in numbers):
            return ""
        fine = [pair for pair in right if answered_alike(pair[0].answer, pair[1])]
        looked_at = [each for each, _ in (*wrong, *fine)][:CALLS]
        self._left[function] = self._still(function, lambda slip: self._explains(slip, looked_at))
        return _agreed(self._left[function], choices_only=all(_is_choice(each.answer) for each, _ in wrong))

    def said_of(self, name: str, drives: Sequence[Drive]) -> str:
        """The same of a class, by what its objects answered to the frames of drives."""
        self._steps_taken, self._steps_max = 0, _STEPS_MAX
        looked_at: list[Drive] = []
        show = False
        for drive in [each for each in drives if each.name == name][:_DRIVES]:
            pairs = list(zip(drive.steps, self._driven(drive), strict=False))
            wrong = [k for k, (step, right) in enumerate(pairs) if not answered_alike(step.answer, right)]
            end = max(_FRAMES, wrong[0] + _FRAMES_MORE) if wrong else _FRAMES
            if wrong and not all(_tells(pairs[k][0].answer, pairs[k][1]) for k in wrong if k < end):
                return ""
            show = show or bool(wrong)
            looked_at.append(replace(drive, steps=drive.steps[:end]))
        if not show:
            return ""
        times, more = _STEPS_MORE
        self._steps_max = times * self._steps_taken + more
        self._left[name] = self._still(name, lambda slip: self._explains_drives(slip, looked_at))
        return _agreed(self._left[name], choices_only=False)

    def _driven(self, drive: Drive) -> Iterator[Any]:
        """What an object of the solution's answers to each frame, up to the first that it cannot answer."""
        self._steps = 0
        asked = TrustedImplementation(self._module)
        try:
            with warnings.catch_warnings(action="ignore"):
                handle = asked.construct(drive.name, drive.problem, drive.parameters)
                for step in drive.steps:
                    self._steps_spent += _STEPS_OF_CALL
                    yield told(
                        asked.step(
                            handle,
                            step.frame,
                            landmarks=step.landmarks,
                            joint_covariance=step.joint_covariance,
                        )
                    )
        except StudentError as error:
            yield f"{error.type_name}: {error.message}"

    def _explains_drives(self, slip: Slip, drives: Sequence[Drive]) -> bool:
        with self._made(slip):
            for drive in drives:
                answers = self._driven(drive)
                for step in drive.steps:
                    if not answered_alike(step.answer, next(answers, "")):
                        return False
        return True

    @contextlib.contextmanager
    def _made(self, slip: Slip) -> Iterator[None]:
        """The solution with a slip in it, for as long as the context lasts."""
        namespace = self._module.__dict__
        owner: ModuleType | type = getattr(self._module, slip.changed) if slip.method else self._module
        name = slip.method or slip.changed
        # As where it was defined: decorators and defaults may speak of what the class has.
        scope = dict(vars(owner))
        before = scope[name]
        # A default may be spoilt so that there is no definition: then the solution stays as it is.
        with contextlib.suppress(Exception):
            exec(slip.code, namespace, scope)
        setattr(owner, name, scope[name])
        try:
            yield
        finally:
            setattr(owner, name, before)

    def _still(self, function: str, explains: Callable[[Slip], bool]) -> list[Slip]:
        """The slips left of a function that explain what is looked at now."""
        left = self._left.get(function)
        candidates = _slips(self._source, function, self._asked) if left is None else left
        self._steps_spent, began = 0, time.process_time()
        # What a call has spoken against, no later call speaks for.
        return [
            slip
            for slip in candidates
            if self._steps_spent < _STEPS_ALL and time.process_time() - began < _SEARCH_S and explains(slip)
        ]

    def _is_wrong(self, call: Remembered) -> bool:
        return not answered_alike(call.answer, self.answer(call))

    def _explains(self, slip: Slip, calls: Sequence[Remembered]) -> bool:
        with self._made(slip):
            return all(answered_alike(each.answer, self.answer(each)) for each in calls)

    def _tick(self) -> None:
        self._steps += 1
        self._steps_spent += 1
        self._steps_taken = max(self._steps_taken, self._steps)
        if self._steps > self._steps_max:
            raise StudentError("RuntimeError", "a loop without end")


@functools.lru_cache(maxsize=64)
def _slips(source: str, function: str, asked: frozenset[str]) -> tuple[Slip, ...]:
    made = slips(source, function, asked)
    # Those that say little come last: time may end before them.
    vagueness = {kind: len(VAGUE) - number for number, kind in enumerate(VAGUE)}
    return tuple(sorted(made, key=lambda slip: vagueness.get(slip.kind, 0)))


def _is_silent(answer: Any) -> bool:
    return isinstance(answer, str) or next(iter(leaves(answer)), None) is None


def _tells(answer: Any, expected: Any) -> bool:
    """Whether a wrong answer says how it came about: nothing does that is not finite, or zero all through."""
    other_count = sum(1 for _ in leaves(answer)) != sum(1 for _ in leaves(expected))
    if isinstance(answer, str) or not (other_count or differs_in_numbers(answer, expected)):
        return False
    try:
        numbers = [np.asarray(leaf, dtype=np.float64) for _, leaf in leaves(answer) if leaf is not None]
    except (TypeError, ValueError, OverflowError):
        return False
    return all(np.isfinite(each).all() for each in numbers) and any(each.any() for each in numbers)


def _is_yes_or_no(answer: Any, expected: Any) -> bool:
    """Whether an answer is wrong in truth values only: of those many a mistake turns the same few."""
    wanted = dict(leaves(expected))
    wrong = [
        leaf for path, leaf in leaves(answer) if path not in wanted or not answered_alike(leaf, wanted[path])
    ]
    return bool(wrong) and all(np.asarray(leaf).dtype.kind == "b" for leaf in wrong)


def _is_choice(answer: Any) -> bool:
    """Whether an answer chooses among few (indices, yes or no), as many a mistake does by chance."""
    return all(np.asarray(leaf).dtype.kind in "biu" for _, leaf in leaves(answer))


def _agreed(found: Sequence[Slip], *, choices_only: bool) -> str:
    """What all of them say: changes of one kind are one mistake, looked at in several places."""
    kinds = {slip.kind for slip in found}
    for vague in () if choices_only else VAGUE:
        if len(kinds) > 1:
            kinds.discard(vague)
    if kinds == {TWICE, HALF}:
        # Half a factor is twice the divisor.
        kinds, found = {HALF_OR_TWICE}, [replace(slip, kind=HALF_OR_TWICE, named="") for slip in found]
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
