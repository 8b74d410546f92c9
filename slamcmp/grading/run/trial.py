"""What a kind of test works with, and what it answers.

An assignment's ``cases.py`` imports :class:`Case` and :class:`Track` from here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Literal, Protocol

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.grading.results.outcome import Plot
from slamcmp.grading.sandbox.pipes.answers import Answer
from slamcmp.types import FloatArray, Frame, Problem


class Implementation(Protocol):
    """Somebody's functions and classes, wherever they run."""

    def call(self, name: str, *arguments: Any) -> Any:
        """A plain function's answer."""

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        """A handle of a new object."""

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        """``update`` of the object, then ``estimate`` and what else is wanted."""

    def cpu_s(self) -> float:
        """Processor time used up to now [s]."""


@dataclass(frozen=True)
class Case:
    """One call with given arguments; what it should answer is the reference's answer."""

    arguments: tuple[Any, ...]
    label: str = ""
    """Where it comes from, for messages: "step 12"."""


@dataclass(frozen=True)
class Track:
    """One run of an estimator against the truth; K steps, errors of dimension p."""

    t: FloatArray
    """(K,) [s]."""
    errors: FloatArray
    """(K, p), in the tangent that the covariances are in."""
    covariances: FloatArray | None = None
    """(K, p, p), as the estimator told them; None: it tells none."""
    path: FloatArray | None = None
    """Where the estimator takes the robot to be, (K, 2) [m]; None: there is nothing to draw in the plane."""
    true_path: FloatArray | None = None
    """Where it was, (K, 2) [m]."""


@dataclass(frozen=True)
class Verdict:
    """What a kind of test answers."""

    credit: float
    """Share of the points, 0 to 1."""
    message: str
    """For the student: what was right and what was not, with numbers."""
    detail: str = ""
    """For the staff."""
    plots: tuple[Plot, ...] = ()
    leaderboard: tuple[tuple[str, float, Literal["asc", "desc"]], ...] = ()


@dataclass(frozen=True)
class Trial:
    """One test of one submission."""

    student: Implementation
    reference: Implementation
    """The solution in the grader's own process."""
    cases: ModuleType
    """The assignment's ``cases.py``."""
    seeded: Callable[[], np.random.Generator]
    """A generator, from its start again at every call."""
    sandboxed_reference: Callable[[], Implementation] | None = None
    """The solution in a sandbox like the student's own, for what depends on the surroundings."""
    missing: tuple[str, ...] = ()
    """Functions of the assignment that the submission does not define."""
    short: bool = field(default=False)
    """Only the first of several runs is wanted: the answers are compared with a known mistake's."""

    def procedure(self, name: str) -> Callable[..., Any]:
        """The function ``name`` of the assignment's ``cases.py``.

        Raises:
            UsageError: there is none.
        """
        found = getattr(self.cases, name, None)
        if not callable(found):
            raise UsageError(f"{self.cases.__file__}: there is no function {name!r}")
        return found  # type: ignore[no-any-return]

    def run_generators(self, count: int) -> list[np.random.Generator]:
        """Generators of ``count`` independent runs (of the first only, where the trial is short)."""
        return self.seeded().spawn(count)[: 1 if self.short else count]
