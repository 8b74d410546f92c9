"""What came of asking for advice: the answer in sentences, the table behind them, and where it all lies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from slamcmp.results.answers.candidates import Candidate, Which
from slamcmp.results.answers.recommendation import Choice, Recommendation
from slamcmp.results.grid import reference_name
from slamcmp.results.numbers import interval_text, number_text
from slamcmp.results.store import Results
from slamcmp.types.html import rows_html


@dataclass(frozen=True)
class Asked:
    """What was asked for."""

    which: Which
    budget_ms: float | None
    memory_mb: float | None
    seeds: int
    time_limit_s: float


@dataclass(frozen=True)
class Sentence:
    """One statement, with what it is about."""

    kind: str
    """``answer``, ``odometry``, ``others``, ``hindsight``, ``change``, ``failed`` or ``limits``."""
    text: str


@dataclass(frozen=True)
class WhatIf:
    """The answer for the same problem a little otherwise."""

    name: str
    parameters: dict[str, Any]
    """Of the source."""
    results: Results = field(repr=False)
    recommendation: Recommendation


@dataclass(frozen=True)
class Advice:
    """What :func:`slamcmp.advise` returns; ``print`` shows the sentences, a notebook the table too."""

    name: str
    folder: Path
    asked: Asked
    jobs: int
    results: Results = field(repr=False)
    recommendation: Recommendation
    dropped: Mapping[str, str]
    """Labels that the first trial was enough for, and why."""
    what_ifs: tuple[WhatIf, ...]
    untried: tuple[str, ...]
    """Variations that there was no time for."""
    varied: bool
    """Whether the source has anything to vary."""
    notes: tuple[str, ...] = ()
    sentences: tuple[Sentence, ...] = ()

    @property
    def runs(self) -> int:
        """Paired trials."""
        return int(self.results.trials["trial"].nunique())

    @property
    def table(self) -> pd.DataFrame:
        """One row per back end that was looked at, from the cheapest on, as text."""
        rows = [_row(each, self.recommendation) for each in self.recommendation.choices]
        return pd.DataFrame(rows)

    def as_dict(self) -> dict[str, Any]:
        """For JSON; the keys stay."""
        found = self.recommendation
        return {
            "name": self.name,
            "folder": str(self.folder),
            "mode": "hindsight" if self.asked.which == "final" else "online",
            "verdict": found.verdict,
            "recommended": found.label,
            "best": found.best,
            "undecided": list(found.undecided),
            "reason": found.reason,
            "within": found.within,
            "budget_ms": self.asked.budget_ms,
            "memory_mb": self.asked.memory_mb,
            "time_limit_s": self.asked.time_limit_s,
            "runs": self.runs,
            "reference": reference_name(self.results),
            "sentences": [{"kind": each.kind, "text": each.text} for each in self.sentences],
            "back_ends": [_facts(each) for each in found.choices],
            "not_tried_further": dict(self.dropped),
            "what_if": [
                {
                    "name": each.name,
                    "source": each.parameters,
                    "runs": int(each.results.trials["trial"].nunique()),
                    "verdict": each.recommendation.verdict,
                    "recommended": each.recommendation.label,
                    "changes": changes(found, each.recommendation),
                }
                for each in self.what_ifs
            ],
            "not_varied": list(self.untried),
            "machine": {"cpu": self.results.manifest.get("cpu"), "jobs": self.jobs},
        }

    def __str__(self) -> str:
        return "\n".join(each.text for each in self.sentences)

    def __repr__(self) -> str:
        found = self.recommendation
        return (
            f"<Advice for {self.name!r}: {found.label or found.verdict}, {self.runs} runs; in {self.folder}>"
        )

    def _repr_html_(self) -> str:
        from html import escape

        said = "".join(f"<p>{escape(each.text)}</p>" for each in self.sentences)
        table = self.table
        return said + rows_html([str(name) for name in table.columns], table.to_numpy().tolist())


def changes(now: Recommendation, then: Recommendation) -> bool | None:
    """Whether another back end would be recommended; None where the runs do not say."""
    settled = ("recommended", "none")
    if now.verdict not in settled or then.verdict not in settled:
        return None
    return now.label != then.label


def known(value: float, unit: str = "") -> str:
    """A number with its unit, or a dash."""
    return f"{number_text(value)}{unit}" if math.isfinite(value) else "–"


def _row(choice: Choice, found: Recommendation) -> dict[str, str]:
    each = choice.candidate
    bounds = interval_text(choice.ratio)
    verdict = {"out": choice.reason, "undecided": "not enough runs"}.get(choice.distance, choice.distance)
    if choice.label == found.label:
        verdict = "recommended" if found.verdict == "recommended" else "safe choice"
    elif each.consistency.verdict == "overconfident":
        verdict = f"{verdict}, overconfident"
    return {
        "back end": choice.label,
        "trajectory": each.which,
        "runs": str(each.runs),
        "failed": str(len(each.failures)),
        "error [m]": known(each.error),
        "error / best [95 %]": known(choice.ratio.estimate) + (f" [{bounds}]" if bounds else ""),
        "covariance": each.consistency.verdict,
        "ms a frame": known(each.cost_ms),
        "95 % of frames [ms]": known(each.p95_ms),
        "memory [MB]": known(each.memory_mb),
        "verdict": verdict,
    }


def _facts(choice: Choice) -> dict[str, Any]:
    each: Candidate = choice.candidate
    return {
        "label": choice.label,
        "trajectory": each.which,
        "runs": each.runs,
        "failures": list(each.failures),
        "error_m": _finite(each.error),
        "ratio": _finite(choice.ratio.estimate),
        "ratio_low": _finite(choice.ratio.low),
        "ratio_high": _finite(choice.ratio.high),
        "distance": choice.distance,
        "decided_against": choice.against,
        "decided_low": _finite(choice.nearest.low),
        "decided_high": _finite(choice.nearest.high),
        "reason": choice.reason,
        "consistency": each.consistency.verdict,
        "consistency_text": each.consistency.text,
        "ms_per_frame": _finite(each.cost_ms),
        "p95_ms": _finite(each.p95_ms),
        "memory_mb": _finite(each.memory_mb),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
