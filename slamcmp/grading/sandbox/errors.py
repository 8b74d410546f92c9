"""What can go wrong with code in the sandbox: the submission's fault unless it says otherwise."""

from __future__ import annotations

from dataclasses import dataclass

from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.support.messages import printable


class SandboxUnavailable(UsageError):
    """This machine cannot give the protection that was asked for: not the submission's fault."""


class SandboxError(SlamcmpError):
    """An experiment in the sandbox gave no answer; the message may be shown to the student."""


@dataclass(frozen=True)
class SourceLine:
    """One line of the student's own code in a traceback."""

    file: str
    """Relative to the submission."""
    line: int
    function: str
    code: str


class StudentError(SandboxError):
    """The submission raised an exception, lacks a name, or answered with what the task does not allow.

    The session lives on: other requests may still succeed.
    """

    def __init__(self, type_name: str, message: str, frames: tuple[SourceLine, ...] = ()) -> None:
        self.type_name = type_name
        self.message = printable(message)
        self.frames = frames
        """Outermost call first, lines of the submission only."""
        super().__init__(self.text)

    @property
    def text(self) -> str:
        """What happened and where, on one line for each of the student's own lines."""
        lines = [f"{self.type_name}: {self.message}"]
        lines += [f"  {at.file}, line {at.line}, in {at.function}: {at.code}" for at in self.frames]
        return "\n".join(lines)


class StudentTimeout(SandboxError):
    """A request was not answered within its time; the process was killed."""


class StudentCrashed(SandboxError):
    """The process ended by itself: a signal, ``os._exit``, or out of memory."""

    def __init__(self, message: str, *, signal_name: str | None, status: int | None) -> None:
        self.signal_name = signal_name
        self.status = status
        """The exit code, where it ended without a signal."""
        super().__init__(message)


class ProtocolViolation(SandboxError):
    """The process wrote something to the reply pipe that is no answer to the request; it was killed."""
