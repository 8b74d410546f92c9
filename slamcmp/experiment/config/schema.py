"""The JSON Schema of experiment files, with every registered plug-in's parameters."""

from __future__ import annotations

from typing import Any

from slamcmp.experiment.config.component import OWN_GATE
from slamcmp.experiment.config.experiment import ExperimentFields
from slamcmp.metrics import metric_columns
from slamcmp.registry import Plugin, Registry, back_ends, figures, front_ends, sources
from slamcmp.support.configuration.extended_yaml import EXTENDS, PRIVATE
from slamcmp.support.configuration.plugin_models import parameter_model

PROBABILITY_SCHEMA = {
    "type": ["number", "null"],
    "exclusiveMinimum": 0,
    "exclusiveMaximum": 1,
    "description": "Gate this back end's own copy of the stream by its own covariance, with this probability",
}


def experiment_schema() -> dict[str, Any]:
    """A schema (draft 2020-12) with which an editor completes and checks experiment files."""
    schema = ExperimentFields.model_json_schema()
    definitions = schema.setdefault("$defs", {})
    properties = schema["properties"]
    front_end_default = properties["front_end"].get("default")
    properties["source"] = _choices(sources, definitions)
    properties["front_end"] = {**_choices(front_ends, definitions), "default": front_end_default}
    properties["back_ends"]["items"] = _choices(back_ends, definitions, back_end=True)
    properties["figures"] = {"type": ["array", "null"], "items": {"enum": figures.names()}}
    properties["columns"] = {
        "type": ["array", "null"],
        "minItems": 1,
        "uniqueItems": True,
        "items": {"enum": list(metric_columns())},
        "description": properties["columns"]["description"],
    }
    # What a file leaves out, the one that it extends may have.
    needed = [{"required": schema.pop("required")}, {"required": [EXTENDS]}]
    properties[EXTENDS] = {"type": "string", "description": "Another file, over which this one is laid"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "anyOf": needed,
        "patternProperties": {f"^{PRIVATE}": {"description": "For anchors"}},
        "title": "slamcmp experiment",
        "description": "One question, one source, one front end, several back ends.",
    }


def _choices(registry: Registry, definitions: dict[str, Any], *, back_end: bool = False) -> dict[str, Any]:
    """Any registered plug-in with its own parameters, or one from the user's file with any."""
    own_file = {
        "type": "object",
        "required": ["name"],
        "properties": {"name": {"type": "string", "pattern": r"\.py:\w+$"}},
    }
    options = [_plugin_schema(plugin, definitions, back_end) for plugin in registry]
    return {"anyOf": [*options, own_file], "description": f"A {registry.kind}: name and parameters"}


def _plugin_schema(plugin: Plugin, definitions: dict[str, Any], back_end: bool) -> dict[str, Any]:
    schema = parameter_model(plugin).model_json_schema()
    definitions.update(schema.pop("$defs", {}))
    extra = {"label": {"type": "string", "minLength": 1}, OWN_GATE: PROBABILITY_SCHEMA} if back_end else {}
    properties = {"name": {"const": plugin.name}, **extra, **schema.get("properties", {})}
    for name in set(plugin.traits.get("paths", ())) & properties.keys():
        several = {"type": "array", "items": {"type": "string"}, "minItems": 1, "uniqueItems": True}
        properties[name] = {"anyOf": [properties[name], several]}
    return {
        **schema,
        "title": plugin.name,
        "description": plugin.summary,
        "required": ["name", *schema.get("required", [])],
        "properties": properties,
    }
