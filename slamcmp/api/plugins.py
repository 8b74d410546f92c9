"""Back ends as a program names them: by registered name, by ``file.py:Class``, or as the class itself."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from slamcmp.errors import UsageError
from slamcmp.registry import Plugin, Registry, back_ends
from slamcmp.support.configuration.code_source import CodeSource, plain_data
from slamcmp.support.configuration.config_errors import ConfigErrors
from slamcmp.support.configuration.plugin_models import bind_parameters, parameter_model

BackEndLike = str | Callable[..., Any]
"""A registered name, ``file.py:Class``, or a class (or a function that makes a back end from a problem)."""


def find_back_end(back_end: BackEndLike) -> Plugin:
    """The plug-in meant; a class that is registered keeps its name and its traits.

    Raises:
        UsageError: there is none of that name, or the object is nothing that makes a back end.
    """
    if isinstance(back_end, str):
        return back_ends.get(back_end)
    given: Any = back_end
    is_instance = not inspect.isclass(given) and hasattr(given, "update")
    if is_instance or not callable(given):
        raise UsageError(
            f"a back end is a class or its name, not {_short(back_end)}"
            + ("; hand over the class, each run makes a new one" if is_instance else "")
        )
    for plugin in back_ends:
        if plugin.target is back_end:
            return plugin
    name = getattr(back_end, "__name__", type(back_end).__name__)
    return Plugin(name.replace("<lambda>", "lambda"), back_end)


def known_elsewhere(plugin: Plugin) -> bool:
    """Whether a worker process finds it by its name: it comes with slamcmp, or from a user's file."""
    module = getattr(plugin.target, "__module__", "") or ""
    return "user_file" in plugin.traits or module.partition(".")[0] == "slamcmp"


def bound(plugin: Plugin, given: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments for the plug-in, checked as an experiment file's are.

    Raises:
        UsageError: a parameter is unknown or has a wrong value; the message says which would be right.
    """
    source = CodeSource(plugin.name, given)
    try:
        return bind_parameters(plugin, source.data)
    except ValidationError as error:
        errors = ConfigErrors(source)
        errors.add_pydantic(error.errors(), (), {(): parameter_model(plugin).model_fields})
        errors.raise_if_any()
        raise


def chosen(registry: Registry, given: str | Mapping[str, Any], what: str) -> tuple[Plugin, dict[str, Any]]:
    """Plug-in and checked parameters of a name, or of ``{"name": …, parameter: …}`` as in an experiment file.

    Raises:
        UsageError: there is no such plug-in, or a parameter is wrong.
    """
    parameters = {"name": given} if isinstance(given, str) else dict(given)
    name = parameters.pop("name", None)
    if not isinstance(name, str):
        raise UsageError(f"{what}: a name, or a mapping with 'name' and parameters, not {_short(given)}")
    plugin = registry.get(name)
    bound(plugin, parameters)
    return plugin, plain_data(parameters)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
