"""``until:`` in an experiment file: when enough seeds have run."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

SEEDS_MAX = 100_000
"""More runs of one question than anybody waits for: a slip of the hand."""


class StopRule(BaseModel):
    """When enough seeds have run.

    An interval that ends a search covers a little less than ``confidence``: the report says how much.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    metric: str = Field(description="Column of the trials table, e.g. online_ate")
    half_width: float = Field(gt=0, allow_inf_nan=False, description="Of the interval, in the metric's unit")
    relative: bool = Field(False, description="half_width is a share: of the median, or of the median ratio")
    of: Literal["each", "difference"] = Field(
        "each",
        description="Median of every back end, or median paired difference (ratio) to the first back end",
    )
    confidence: float = Field(0.95, gt=0.5, lt=1.0)
    max_seeds: int = Field(200, ge=1, le=SEEDS_MAX, description="Stop here, precise or not")
    batch: int = Field(
        10,
        ge=2,
        le=SEEDS_MAX,
        description=(
            "Seeds added between two looks; also the first ones. Of 95 % intervals that end a search 92 to "
            "97 % hold the median with batches of two to five, 94 to 97 % with twenty"
        ),
    )
