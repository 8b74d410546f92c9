"""Imported once by the server that workers are forked from: everything a job may need."""

from __future__ import annotations

import gc

import slamcmp.experiment.job.worker  # noqa: F401
from slamcmp.backends.filters.loops import is_kept, kernels
from slamcmp.registry import back_ends, front_ends, metrics, sources
from slamcmp.support.configuration.plugin_models import parameter_model
from slamcmp.support.provenance.code_version import versions

metrics.names()
# Made here once instead of in every job: half of what a job cost beside its back end.
for _registry in (sources, front_ends, back_ends):
    for _plugin in _registry:
        parameter_model(_plugin)
versions()
# Half a second from the cache; what is not there is compiled by the first who needs it, and in sight.
if is_kept():
    kernels()
# What a collection in a worker would touch, it would have to copy.
gc.freeze()
