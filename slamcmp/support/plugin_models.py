"""The parameters of a plug-in as a pydantic model, made from its signature."""

from __future__ import annotations

import inspect
import json
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, create_model

from slamcmp.errors import UsageError
from slamcmp.registry import Plugin


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
    return parameter_model(plugin).model_validate_json(json.dumps(given, default=str), strict=True)


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
