"""Why a job has no result."""

from __future__ import annotations

from dataclasses import dataclass

from slamcmp.types import Status

OUTSIDE: frozenset[Status] = frozenset({"killed", "missing"})
"""Statuses that a back end has no part in: such a run is done again by the same command."""


@dataclass(frozen=True)
class Fault:
    """Why a job has no result, as its row says it."""

    status: Status
    message: str
