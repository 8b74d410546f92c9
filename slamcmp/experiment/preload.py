"""Imported once by the server that workers are forked from: everything a job may need."""

from __future__ import annotations

import slamcmp.experiment.worker  # noqa: F401
from slamcmp.registry import back_ends, front_ends, metrics, sources

for _registry in (sources, front_ends, back_ends, metrics):
    _registry.names()
