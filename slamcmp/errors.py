"""Every error a user can meet, each with the exit code the command line gives it."""

from __future__ import annotations


class SlamcmpError(Exception):
    """An error whose message says what was wrong, where, and what would be right."""

    exit_code = 1


class UsageError(SlamcmpError):
    """The call or the configuration cannot be used as written."""

    exit_code = 2


class NoSampleError(UsageError):
    """Two samples of an experiment are one and the same stream; what ran is kept, and marked.

    Args:
        message: what is wrong and what would be right.
        reason: what the rows of the second one say.
    """

    exit_code = 1

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class MissingDataError(SlamcmpError):
    """A file that the experiment needs is not on this machine."""

    exit_code = 3


class DataError(UsageError):
    """A file or an array does not hold what its format promises."""


class DivergedError(SlamcmpError):
    """A back end's own result is not usable: non-finite, indefinite, or in a wrong basin."""


class StorageError(SlamcmpError):
    """A result could not be written; what was written before is intact."""
