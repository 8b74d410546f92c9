"""Advice over tables made by hand: no experiment runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from slamcmp.advice.advice import Advice, Asked, WhatIf
from slamcmp.advice.sentences import write_sentences
from slamcmp.results.answers.recommendation import recommend
from tests.results.hand_made import table

BACK_ENDS = [{"name": "batch", "label": "batch"}]


def results(*groups):
    """With a configuration that knows batch for what it is."""
    return replace(table(*groups), manifest={"config": {"back_ends": BACK_ENDS}, "cpu": "a processor"})


def advice(*groups, which="online", what_ifs=(), untried=(), varied=True, dropped=None, **budget):
    """Over these back ends; ``what_ifs`` are pairs of a name and the back ends there."""

    def found(each):
        return recommend(each, which=which, names=names, **budget)

    here = results(*groups)
    names = None if which == "final" else [x for x in here.trials["label"].unique() if "RTS" not in x]
    asked = Asked(which, budget.get("budget_ms"), budget.get("memory_mb"), 12, 300.0)
    others = [(name, results(*there)) for name, there in what_ifs]
    made = Advice(
        name="made",
        folder=Path("results/made-advice"),
        asked=asked,
        jobs=1,
        results=here,
        recommendation=found(here),
        dropped=dropped or {},
        what_ifs=tuple(WhatIf(name, {"x": 1.0}, there, found(there)) for name, there in others),
        untried=tuple(untried),
        varied=varied,
    )
    return replace(made, sentences=tuple(write_sentences(made)))


def said(made, kind):
    """The sentences about one thing, as one text."""
    return " ".join(each.text for each in made.sentences if each.kind == kind)
