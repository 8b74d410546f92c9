"""Plug-in functions that take their own parameters and those of a dataclass that many of them share.

A reader of a recording or the builder of a planar world says only what is its own; the source that is
registered for it has the shared settings among its parameters, with defaults of its own where it names them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from slamcmp.errors import UsageError
from slamcmp.registry import keyword_only

Settings = TypeVar("Settings")
Function = TypeVar("Function", bound=Callable[..., Any])


class SharedSettings(Generic[Settings]):
    """The parameters of a source: the function's own keyword-only ones, then those of the settings."""

    def __init__(
        self,
        name: str,
        function: Callable[..., Any],
        settings: type[Settings],
        defaults: Mapping[str, Any],
    ) -> None:
        """``defaults`` stand in place of the settings' own; ``name`` is the source's, for messages."""
        self._name, self._function, self._settings = name, function, settings
        self._own = keyword_only(function)
        self._shared = {
            key: parameter.replace(default=defaults.get(key, parameter.default))
            for key, parameter in keyword_only(settings).items()
        }

    def split(self, parameters: Mapping[str, Any]) -> tuple[Settings, dict[str, Any]]:
        """The settings, and what is left for the function itself.

        Raises:
            UsageError: there is no such parameter, or two settings contradict each other.
        """
        unknown = parameters.keys() - self._own.keys() - self._shared.keys()
        if unknown:
            raise UsageError(f"source {self._name!r} has no parameter {sorted(unknown)[0]!r}")
        settings = self._settings(
            **{key: parameters.get(key, parameter.default) for key, parameter in self._shared.items()}
        )
        return settings, {key: value for key, value in parameters.items() if key in self._own}

    def signed(self, source: Function) -> Function:
        """``source(seed, **parameters)`` with the name, text, module and signature that a reader expects."""
        source.__name__ = source.__qualname__ = self._function.__name__
        source.__doc__, source.__module__ = self._function.__doc__, self._function.__module__
        seed = inspect.Parameter("seed", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=int)
        signature = inspect.Signature([seed, *self._own.values(), *self._shared.values()])
        source.__signature__ = signature  # type: ignore[attr-defined]
        return source
