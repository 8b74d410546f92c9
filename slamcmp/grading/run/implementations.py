"""Implementations in the grader's own process, and one that remembers what another answered."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.trial import Implementation
from slamcmp.grading.sandbox.errors import StudentError, StudentTimeout
from slamcmp.grading.sandbox.pipes.answers import Answer, read_answer
from slamcmp.grading.sandbox.pipes.protocol import PREFIX, NotTransferable, decode, encode, parse_prefix
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.types import Frame, Problem

REMEMBERED = 4000
"""Answers kept for a diagnosis."""
REMEMBERED_BYTES = 32 << 20
"""Of their arrays, unless said otherwise."""

DRIVES, DRIVE_STEPS = 4, 60
"""Objects of which the frames are kept too, and so many of each."""

PARTS_MAX = 5000
"""Arrays, numbers and texts that an answer may hold."""
_LONG = 50
"""Items of a list that is no list of outputs."""


class TrustedImplementation:
    """A module in this process: the solution, or the solution with a known mistake.

    Arguments are copied and answers restricted as on the way to a sandbox and back, and what the module
    raises becomes a :class:`StudentError`, so that nothing tells it from a submission.
    """

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def call(self, name: str, *arguments: Any) -> Any:
        try:
            copied = _transferred(list(arguments))
        except Exception as error:
            raise _described(error) from error
        return self.call_as_given(name, *copied)

    def call_as_given(self, name: str, *arguments: Any) -> Any:
        """The same with arguments that are neither copied nor made double precision."""
        try:
            return compact(name, _transferred(getattr(self._module, name)(*arguments)))
        except Exception as error:
            raise _described(error) from error

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        arguments = [] if problem is None else [problem]
        try:
            return getattr(self._module, name)(*arguments, **(parameters or {}))
        except Exception as error:
            raise _described(error) from error

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        fields: dict[str, Any] = {}
        try:
            if frame is not None:
                handle.update(frame)
            estimate = handle.estimate()
            fields["estimate"] = {"T_world_body": estimate.T_world_body, "P": estimate.P}
            if landmarks:
                told = handle.landmarks()
                names = ("ids", "positions", "covariances")
                fields["landmarks"] = {name: getattr(told, name) for name in names}
            if joint_covariance:
                fields["joint_covariance"] = handle.joint_covariance()
        except Exception as error:
            raise _described(error) from error
        return read_answer(_transferred(fields), list(fields))

    def cpu_s(self) -> float:
        return time.process_time()


class SandboxedImplementation:
    """A submission in its sandbox, with a time limit over all its requests."""

    def __init__(self, session: SandboxSession, time_limit_s: float) -> None:
        self._session = session
        self._limit_s = time_limit_s
        self._ends = time.monotonic() + time_limit_s

    def call(self, name: str, *arguments: Any) -> Any:
        return compact(name, self._session.call(name, *arguments, deadline_s=self._left_s()))

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        self._left_s()
        return self._session.construct(name, problem, parameters)

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        return self._session.step(
            handle,
            frame,
            landmarks=landmarks,
            joint_covariance=joint_covariance,
            deadline_s=self._left_s(),
        )

    def cpu_s(self) -> float:
        return self._session.cpu_s()

    def _left_s(self) -> float:
        left = self._ends - time.monotonic()
        if left <= 0:
            raise StudentTimeout(f"the test as a whole took more than {self._limit_s:g} s")
        return min(left, self._session.policy.request_s)


@dataclass(frozen=True)
class Remembered:
    """One request and what came of it."""

    name: str
    arguments: tuple[Any, ...]
    answer: Any
    """For an exception its description, a text."""


@dataclass(frozen=True)
class DriveStep:
    """One frame handed to an object, and what it told then."""

    frame: Frame | None
    landmarks: bool
    joint_covariance: bool
    answer: Any
    """As of :class:`Remembered`."""


@dataclass(frozen=True)
class Drive:
    """One object with the frames handed to it, in their order."""

    name: str
    """Of its class."""
    problem: Problem | None
    parameters: Mapping[str, Any] | None
    handle: Any
    steps: list[DriveStep]


class Remembering:
    """Passes everything on and keeps the answers in their order."""

    def __init__(
        self, inner: Implementation, limit: int = REMEMBERED, bytes_max: int = REMEMBERED_BYTES
    ) -> None:
        self._inner = inner
        self._limit = limit
        self._bytes_max = bytes_max
        self._bytes = 0
        self.answers: list[Remembered] = []
        self.drives: list[Drive] = []

    def call(self, name: str, *arguments: Any) -> Any:
        try:
            answer = self._inner.call(name, *arguments)
        except StudentError as error:
            self._keep(name, arguments, f"{error.type_name}: {error.message}")
            raise
        self._keep(name, arguments, answer)
        return answer

    def construct(
        self, name: str, problem: Problem | None = None, parameters: Mapping[str, Any] | None = None
    ) -> Any:
        handle = self._inner.construct(name, problem, parameters)
        if len(self.drives) < DRIVES:
            self.drives.append(Drive(name, problem, parameters, handle, []))
        return handle

    def step(
        self, handle: Any, frame: Frame | None, *, landmarks: bool = False, joint_covariance: bool = False
    ) -> Answer:
        def keep(answered: Any) -> None:
            self._keep("update", (), answered)
            if self._bytes > self._bytes_max:
                # Large answers are kept here no more than there.
                return
            for drive in self.drives:
                if drive.handle is handle and len(drive.steps) < DRIVE_STEPS:
                    drive.steps.append(DriveStep(frame, landmarks, joint_covariance, answered))

        try:
            answer = self._inner.step(handle, frame, landmarks=landmarks, joint_covariance=joint_covariance)
        except StudentError as error:
            keep(f"{error.type_name}: {error.message}")
            raise
        keep(told(answer))
        return answer

    def cpu_s(self) -> float:
        return self._inner.cpu_s()

    @property
    def bytes_kept(self) -> int:
        """Of the arrays that are kept."""
        return min(self._bytes, self._bytes_max)

    def _keep(self, name: str, arguments: Sequence[Any], answer: Any) -> None:
        self._bytes += sum(np.asarray(leaf).nbytes for _, leaf in leaves([list(arguments), answer]))
        # Calls are known by their number: nothing is kept behind one that was too large.
        if len(self.answers) < self._limit and self._bytes <= self._bytes_max:
            self.answers.append(Remembered(name, tuple(arguments), answer))


def told(answer: Answer) -> tuple[Any, ...]:
    """The arrays of what an object told after a frame."""
    kept: list[Any] = []
    if answer.estimate is not None:
        kept += [answer.estimate.T_world_body, answer.estimate.P]
    if answer.landmarks is not None:
        kept += [answer.landmarks.positions, answer.landmarks.covariances]
    if answer.joint_covariance is not None:
        kept.append(answer.joint_covariance)
    return tuple(kept)


def compact(name: str, answer: Any) -> Any:
    """An answer with its long lists of numbers as arrays, which take a tenth of the memory and of the time.

    Raises:
        StudentError: it has too many parts even so.
    """
    compacted = _compacted(answer)
    if sum(1 for _ in itertools.islice(leaves(compacted), PARTS_MAX + 1)) > PARTS_MAX:
        raise StudentError("ValueError", f"{name} answers with more than {PARTS_MAX} parts outside of arrays")
    return compacted


def _compacted(answer: Any) -> Any:
    if isinstance(answer, list) and len(answer) >= _LONG:
        with contextlib.suppress(ValueError, OverflowError):
            array = np.asarray(answer)
            if array.dtype.kind in "fiub":
                return array
    if isinstance(answer, list | tuple):
        return type(answer)(_compacted(each) for each in answer)
    return answer


def _transferred(value: Any) -> Any:
    """A copy, as it would come out of the sandbox's pipe."""
    buffers = [bytes(buffer) for buffer in encode({"value": value})]
    content = b"".join(buffers)
    header, _ = parse_prefix(content[: PREFIX.size], body_max=1 << 31)
    split = PREFIX.size + header
    return decode(content[PREFIX.size : split], bytearray(content[split:]))["value"]


def _described(error: Exception) -> StudentError:
    if isinstance(error, StudentError):
        return error
    kind = "TypeError" if isinstance(error, NotTransferable) else type(error).__name__
    return StudentError(kind, str(error))
