"""``record:`` in an experiment file: what is recorded beyond estimates, at the cost of the times."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Record(BaseModel):
    """What is recorded beyond estimates; a run that records tells no times."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    observability: bool = Field(
        False, description="Nullity, spurious information and drift of the linearisation points"
    )
    divergence_from: str | None = Field(
        None,
        description="Label of the batch solution that every posterior is compared with at the same frame",
    )
    every: int = Field(10, ge=1, description="Frames from one look to the next; the last frame is always one")

    def recording(self) -> dict[str, Any]:
        """What a run depends on; whom its posteriors are compared with, it does not know."""
        return {
            "observability": self.observability,
            "posteriors": self.divergence_from is not None,
            "every": self.every,
        }

    def describe(self) -> str:
        """For the tables."""
        parts = ["observability"] if self.observability else []
        parts += [] if self.divergence_from is None else [f"divergence from {self.divergence_from}"]
        return ", ".join(parts)
