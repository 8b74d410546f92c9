"""The shipped anchors, run in this process on a few seeds or on all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.judgements.verdict import PublishedVerdict, judge
from tests.anchors.reference import assert_reproduces, read


def verdict_of(
    name: str,
    folder: Path,
    *,
    runs: int | None = None,
    labels: Sequence[str] | None = None,
    source: dict[str, Any] | None = None,
) -> PublishedVerdict:
    """What comes out of ``experiments/anchors/NAME.yaml``: on its first seeds, with some of its back ends.

    Without any choice: on the seeds that ``results/reference/`` has, and it has to give what stands there.
    """
    experiment = load_experiment(find_experiment(f"anchors/{name}"))
    for parameter, value in (source or {}).items():
        experiment = replace(experiment, source=experiment.source.with_parameter(parameter, value))
    if labels is not None:
        kept = tuple(choice for choice in experiment.back_ends if choice.label in labels)
        assert len(kept) == len(labels)
        published = experiment.published
        assert published is not None
        fewer = published.model_copy(
            update={
                "rows": [row for row in published.rows if row.label in labels],
                "order": [order for order in published.order if {*order.labels} <= {*labels}],
            }
        )
        experiment = replace(experiment, back_ends=kept, published=fewer)
    if runs is not None:
        experiment = experiment.with_seeds(range(runs))
    reference = None
    if runs is None and labels is None and source is None:
        reference = read(f"anchors_{name}")
        if reference["seeds"]:
            experiment = experiment.with_seeds(range(reference["seeds"]))
    results = run_experiment(experiment, folder=folder, executor="serial")
    assert (results.trials["status"] == "ok").all()
    verdict = judge(results)
    assert verdict is not None
    print(verdict.sentence())
    if reference is not None:
        assert_reproduces(results, reference)
    return verdict


def measured(verdict: PublishedVerdict) -> dict[str, dict[str, float]]:
    """By metric and label."""
    found: dict[str, dict[str, float]] = {}
    for value in verdict.values:
        found.setdefault(value.metric, {})[value.label] = value.measured
    return found
