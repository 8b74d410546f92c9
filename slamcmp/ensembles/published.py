"""A publication's numbers and orders held against an ensemble, as results/judgements/verdict.py does it.

Values are inside where they differ by at most the metric's tolerance. A pair of an order is held where the
95 % interval of the paired ratio, worse over better, lies above 1, violated where it lies below, and a tie
where it contains 1. Back ends that the ensemble left out are left out here; a metric that it does not have is
not measured.
"""

from __future__ import annotations

import math
from itertools import pairwise

from slamcmp.ensembles.outcome import METRICS, Ensemble
from slamcmp.metrics.statistics import Interval
from slamcmp.results.judgements.published import Published, PublishedOrder
from slamcmp.results.judgements.verdict import OrderVerdict, PairVerdict, PublishedVerdict, ValueVerdict


def judge_ensemble(found: Ensemble, published: Published) -> PublishedVerdict:
    """The verdict on everything that the section names and the ensemble has."""
    metrics = {each.label: each.metrics() for each in found.runs}
    runs = {each.label: len(each.scores) - each.failures for each in found.runs}
    values = []
    for row in published.rows:
        if row.label not in metrics:
            continue
        for metric, value in row.values.items():
            measured = metrics[row.label][metric].value if metric in METRICS else math.nan
            tolerance = published.tolerance.get(metric)
            verdict = "not judged" if tolerance is None else "outside"
            if not math.isfinite(measured):
                verdict = "not measured"
            elif tolerance is not None and abs(measured - value) <= tolerance * abs(value):
                verdict = "inside"
            values.append(
                ValueVerdict(row.label, {}, metric, value, measured, tolerance, runs[row.label], verdict)
            )
    orders = [
        _order(found, order)
        for order in published.order
        if len([label for label in order.labels if _has(found, label, order.metric)]) > 1
    ]
    return PublishedVerdict(published.source, tuple(values), tuple(orders))


def _order(found: Ensemble, order: PublishedOrder) -> OrderVerdict:
    labels = [label for label in order.labels if _has(found, label, order.metric)]
    pairs = []
    for better, worse in pairwise(labels):
        ratio = found.ratio(order.metric, worse, better)
        verdict = "held" if ratio.low > 1 else "violated" if ratio.high < 1 else "tie"
        count = min(len(each.scores) - each.failures for each in found.runs if each.label in (better, worse))
        pairs.append(PairVerdict(better, worse, Interval(ratio.value, ratio.low, ratio.high, count), verdict))
    # Of the last back end that the publication names; where it was left out, there is nothing to ask.
    wanted = order.worst_factor if labels[-1] == order.labels[-1] else None
    factor = pairs[-1].ratio.estimate
    verdicts = {each.verdict for each in pairs}
    if "violated" in verdicts or (wanted is not None and not factor >= wanted):
        whole = "violated"
    else:
        whole = "held" if verdicts == {"held"} else "tie"
    return OrderVerdict(order.metric, {}, tuple(pairs), factor, wanted, whole)


def _has(found: Ensemble, label: str, metric: str) -> bool:
    return metric in METRICS and any(each.label == label for each in found.runs)
