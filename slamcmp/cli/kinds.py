"""The kinds of things that experiments are made of, as the command line calls them."""

from __future__ import annotations

from slamcmp.registry import back_ends, executors, figures, front_ends, metrics, sensors, sources

FILES = ("experiments", "assignments")
"""What is shipped as files and not registered."""
KINDS = {
    "sources": sources,
    "front-ends": front_ends,
    "back-ends": back_ends,
    "sensors": sensors,
    "metrics": metrics,
    "figures": figures,
    "executors": executors,
}
