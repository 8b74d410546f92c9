"""Whether values go together: what no single parameter's type tells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from slamcmp.errors import UsageError
from slamcmp.experiment.config.component import Component
from slamcmp.registry import Plugin
from slamcmp.support.configuration.config_errors import ConfigErrors
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.support.configuration.yaml_source import KeyPath
from slamcmp.support.messages import describe

IMAGES = "images"
"""The trait of a source whose log has images in place of detections, and of a front end that needs them."""
CONTRADICTIONS = "contradictions"
"""The trait of a plug-in with a function of its parameters that raises UsageError where two contradict."""


def check_values(
    errors: ConfigErrors,
    plugin: Plugin,
    parameters: Mapping[str, Any],
    given: Mapping[str, Any],
    path: KeyPath,
) -> None:
    """Note values that are not finite, and those that contradict each other, at those that were written."""
    for name, value in given.items():
        what = _not_finite(plugin, name, value)
        if what:
            errors.add((*path, name), what)
    told = _contradiction(plugin, parameters)
    if told:
        named = [name for name in given if name in told]
        errors.add((*path, *named[:1]), told)


def check_swept_value(
    errors: ConfigErrors,
    plugin: Plugin,
    parameters: Mapping[str, Any],
    name: str,
    value: Any,
    swept: str,
    index: int,
    *,
    alone: bool,
) -> None:
    """Note what is wrong with one swept value beside the parameters as they stand in the file.

    Where others of the plug-in are swept with it (not ``alone``), it may go with those: what then is
    impossible are points of the grid, and rows say so.
    """
    what = _not_finite(plugin, name, value)
    if alone and not what and not _contradiction(plugin, parameters):
        what = _contradiction(plugin, {**parameters, name: value})
    if what:
        errors.add(("sweep", swept, index), what)


def check_source_and_front_end(errors: ConfigErrors, source: Component, front_end: Component) -> None:
    """Note a front end that cannot use what the source gives, as far as both say it."""
    ours = [plugin for plugin in (source.plugin(), front_end.plugin()) if "user_file" not in plugin.traits]
    if len(ours) < 2:
        return
    gives, needs = (bool(plugin.traits.get(IMAGES, False)) for plugin in ours)
    if gives and not needs:
        what = (
            f"name: front end {front_end.name!r} needs detections, and source {source.name!r} gives images; "
            "take front_end: {name: tracked_features}"
        )
        errors.add(("front_end", "name"), what)
    if needs and not gives:
        what = (
            f"name: front end {front_end.name!r} needs images, and source {source.name!r} gives detections; "
            "take front_end: {name: labelled}"
        )
        errors.add(("front_end", "name"), what)


def _not_finite(plugin: Plugin, name: str, value: Any) -> str:
    """What is wrong with a number that is infinite or none; a default that is infinite means no limit."""
    parameter = plugin.parameters().get(name)
    default = None if parameter is None else parameter.default
    if isinstance(default, float) and math.isinf(default) and value == default:
        return ""
    of_user = "user_file" in plugin.traits and "sigma" not in name
    return "" if of_user or _is_finite(value) else f"{name}: a finite number, not {value}"


def _is_finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _contradiction(plugin: Plugin, parameters: Mapping[str, Any]) -> str:
    for name, value in parameters.items():
        other = name.replace("_min", "_max")
        if other != name and other in parameters and _is_above(value, parameters[other], other):
            return (
                f"{name} is {value:g} and {other} {parameters[other]:g}: "
                "the largest must be above the smallest"
            )
    check = plugin.traits.get(CONTRADICTIONS)
    if check is None:
        return ""
    try:
        check(**bind_parameters(plugin, dict(parameters)))
    except UsageError as error:
        return str(error)
    except Exception as error:
        # An author's own check may have faults of its own.
        return f"{plugin.name}: its check of contradictions fails: {describe(error)}"
    return ""


def _is_above(smallest: Any, largest: Any, name: str) -> bool:
    """Whether a smallest value lies above the largest; nothing has a range without any width."""
    if not (isinstance(smallest, int | float) and isinstance(largest, int | float)):
        return False
    return smallest > largest or (smallest == largest and name.startswith("range_"))
