"""Published and measured values side by side, as tables for the terminal and the report."""

from __future__ import annotations

from typing import Any

import pandas as pd

from slamcmp.results.judgements.verdict import PublishedVerdict
from slamcmp.results.numbers import interval_text, number_text


def value_rows(verdict: PublishedVerdict) -> pd.DataFrame:
    """One row a published value; empty where the publication gives only an order."""
    rows: list[dict[str, Any]] = []
    for each in verdict.values:
        known = each.measured == each.measured
        rows.append(
            {
                "metric": each.metric,
                "back end": each.label,
                **each.at,
                "published": number_text(each.published),
                "measured": number_text(each.measured) if known else "",
                "deviation": f"{100 * each.deviation:+.1f} %" if each.deviation == each.deviation else "",
                "tolerance": "" if each.tolerance is None else f"±{100 * each.tolerance:g} %",
                "verdict": each.verdict,
                "from runs": each.runs,
            }
        )
    table = pd.DataFrame(rows)
    return table.sort_values("metric", kind="stable", ignore_index=True) if rows else table


def order_rows(verdict: PublishedVerdict) -> pd.DataFrame:
    """One row a pair of neighbours in a published order."""
    rows: list[dict[str, Any]] = []
    for order in verdict.orders:
        for pair in order.pairs:
            last = pair is order.pairs[-1] and order.worst_factor is not None
            needed = f", {order.worst_factor:g} needed" if last else ""
            rows.append(
                {
                    "order of": order.metric,
                    **order.at,
                    "better": pair.better,
                    "worse": pair.worse,
                    "worse / better": number_text(pair.ratio.estimate) if pair.ratio.runs else "",
                    "95 % of it": interval_text(pair.ratio),
                    "pairs": pair.ratio.runs,
                    "verdict": pair.verdict,
                    "last / one before": f"{order.factor:.2f}{needed}" if pair is order.pairs[-1] else "",
                    "order": order.verdict if pair is order.pairs[-1] else "",
                }
            )
    return pd.DataFrame(rows)
