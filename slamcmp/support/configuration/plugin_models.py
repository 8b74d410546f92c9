"""The parameters of a plug-in as a pydantic model, made from its signature."""

from __future__ import annotations

import inspect
import json
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from slamcmp.errors import UsageError
from slamcmp.registry import Plugin

INFINITIES = frozenset({"inf", "-inf", "infinity", "-infinity"})
"""As text, in small letters."""


def parameter_model(plugin: Plugin) -> type[BaseModel]:
    """A model with one field for each keyword-only parameter; other keys are refused.

    Raises:
        UsageError: the signature has annotations that cannot be resolved or used.
    """
    return _model(plugin.target, plugin.name)


def check_parameters(plugin: Plugin, given: dict[str, Any]) -> dict[str, Any]:
    """``given`` (as from YAML or JSON) checked, with defaults filled in, as plain JSON values.

    Raises:
        pydantic.ValidationError: a value or key is not allowed.
        UsageError: a default that its author chose is no value that a file could hold.
    """
    model = _validate(plugin, given)
    try:
        dumped: dict[str, Any] = model.model_dump(mode="json")
    except Exception as error:
        raise UsageError(
            f"{plugin.name}: its parameters must be numbers, texts, lists or mappings, and their "
            f"defaults too: {error}"
        ) from error
    return dumped


def bind_parameters(plugin: Plugin, given: dict[str, Any]) -> dict[str, Any]:
    """The keyword arguments to call the plug-in with, in the types its annotations name."""
    model = _validate(plugin, given)
    return {name: getattr(model, name) for name in type(model).model_fields}


def _validate(plugin: Plugin, given: dict[str, Any]) -> BaseModel:
    # JSON mode: strict about numbers and strings, yet a list may become the tuple that is asked for.
    model = parameter_model(plugin)
    try:
        return model.model_validate_json(json.dumps(given, default=str), strict=True)
    except ValidationError as error:
        # The printed configuration has infinity as text, as JSON must: only where a number is asked for.
        known = _with_infinities(given, error)
        if known == given:
            raise
        return model.model_validate_json(json.dumps(known, default=str), strict=True)


def _with_infinities(given: dict[str, Any], error: ValidationError) -> dict[str, Any]:
    """``given`` with numbers in place of ``"inf"`` and the like wherever a number was missed."""
    found = json.loads(json.dumps(given, default=str))
    for details in error.errors():
        value, place = details["input"], details["loc"]
        if details["type"] not in ("float_type", "float_parsing") or not isinstance(value, str):
            continue
        if value.lower() not in INFINITIES:
            continue
        # Behind a parameter of several types stands the name of the type.
        node, steps = found, [step for step in place if step != "float"]
        for step in steps[:-1]:
            node = node[step]
        node[steps[-1]] = float(value)
    return dict(found)


@cache
def _model(target: Any, name: str) -> type[BaseModel]:
    try:
        parameters = Plugin(name, target).parameters()
        fields: dict[str, Any] = {
            key: (
                Any if parameter.annotation is inspect.Parameter.empty else parameter.annotation,
                ... if parameter.default is inspect.Parameter.empty else parameter.default,
            )
            for key, parameter in parameters.items()
        }
        # Their names are the plug-in author's: "model_" prefixes are no business of ours.
        config = ConfigDict(extra="forbid", protected_namespaces=(), arbitrary_types_allowed=True)
        return create_model(f"{name} parameters", __config__=config, **fields)
    except Exception as error:
        # Reading a signature evaluates what the author wrote there, and pydantic has errors of its own.
        raise UsageError(f"{name}: its parameters cannot be read: {type(error).__name__}: {error}") from error
