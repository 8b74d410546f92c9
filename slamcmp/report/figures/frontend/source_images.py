"""The images of an experiment's typical trial, which its source delivers again: a results folder has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from slamcmp.errors import SlamcmpError
from slamcmp.registry import front_ends, sources
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.results.grid import swept_columns, trial_name
from slamcmp.results.store import Results
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.types import Log


@dataclass(frozen=True)
class TrialSource:
    """What made a trial's log."""

    name: str
    parameters: Mapping[str, Any]
    seed: int
    digest: str
    """Of the trial's stream."""
    title: str
    """The trial's name."""


def source_of_typical_trial(results: Results) -> TrialSource:
    """The source of the typical trial, as :func:`source_of_trial` has it."""
    return source_of_trial(results, None)


def source_of_trial(results: Results, trial: int | None) -> TrialSource:
    """The source of a trial (None: the typical one), with that trial's values of what is swept.

    Raises:
        NotDrawable: the experiment's front end takes no images.
    """
    config = results.manifest.get("config", {})
    source, front_end = config.get("source"), config.get("front_end")
    if not isinstance(source, Mapping) or not isinstance(front_end, Mapping):
        raise NotDrawable("the results do not tell source and front end")
    try:
        of_images = front_ends.get(str(front_end.get("name"))).traits.get("images", False)
    except SlamcmpError:
        of_images = False
    if not of_images:
        raise NotDrawable("the front end takes no images")
    trial = typical_trial(results) if trial is None else trial
    row = results.trials[results.trials["trial"] == trial].iloc[0]
    parameters = {name: value for name, value in source.items() if name != "name"}
    for path in swept_columns(results.trials):
        if path.startswith("source.") and path.count(".") == 1:
            value = row[path]
            parameters[path.removeprefix("source.")] = value.item() if hasattr(value, "item") else value
    seed = 0 if pd.isna(row["seed"]) else int(row["seed"])
    return TrialSource(str(source["name"]), parameters, seed, str(row["digest"]), trial_name(results, trial))


def log_with_images(found: TrialSource) -> Log:
    """The trial's log again.

    Raises:
        NotDrawable: the source has no images, or they are not there any more.
    """
    try:
        plugin = sources.get(found.name)
        log: Log = plugin.target(found.seed, **bind_parameters(plugin, dict(found.parameters)))
    except Exception as error:
        # Whatever a source raises: without its images the page is as good as with them, but for these.
        raise NotDrawable(f"the images are not there any more: {error}") from error
    if log.images is None:
        raise NotDrawable("the source delivers no images")
    return log
