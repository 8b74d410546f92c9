"""Whether the final column compares like with like: a filter's hindsight is its RTS smoother's."""

from __future__ import annotations

from slamcmp.results.grid import has_values, labels
from slamcmp.results.store import Results

SMOOTHED = (
    "ekf_slam",
    "ekf_world",
    "ekf_fej",
    "ekf_oc",
    "ekf_right_invariant",
    "ekf_robocentric",
    "ekf_ideal",
    "iterated_ekf",
    "ukf_slam",
)
"""Filters that ``smooth: true`` gives an RTS smoother; ``ekf_slam``'s is that of ``ekf_world``."""


def filters_without_hindsight(results: Results) -> list[str]:
    """Labels of the filters that stand beside final columns of others while no filter has one of its own."""
    if results.frames.empty or not has_values(results.frames, ["final_x"]):
        return []
    back_ends = results.manifest.get("config", {}).get("back_ends", [])
    if any(each.get("smooth") for each in back_ends):
        return []
    filters = [str(each.get("label", each.get("name"))) for each in back_ends if each.get("name") in SMOOTHED]
    return [label for label in labels(results) if label in filters]
