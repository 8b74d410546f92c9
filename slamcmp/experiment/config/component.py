"""One plug-in of an experiment with its parameters, and how a sweep names one of them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from slamcmp.registry import Plugin, Registry, back_ends, front_ends, sources

OWN_GATE = "own_gate"
"""The key beside a back end's parameters; a sweep may change it like one of them."""


@dataclass(frozen=True)
class Component:
    """A plug-in with all its parameters."""

    kind: str
    """``source``, ``front end`` or ``back end``."""
    name: str
    """As the tables show it: the registered name or ``file.py:Name``."""
    spec: str
    """As the registry finds it: the registered name or ``/absolute/file.py:Name``."""
    parameters: Mapping[str, Any]
    """Every parameter, defaults filled in, as plain JSON values."""
    label: str = ""
    """Of a back end, unique within its experiment."""
    folder: Path | None = None
    """Of the experiment file: its relative paths start there."""
    own_gate: float | None = None
    """Of a back end, the probability of a gate by its own covariance; None: it gets the stream as it is."""

    def plugin(self) -> Plugin:
        """The registered class or function."""
        return REGISTRIES[self.kind].get(self.spec)

    def arguments(self) -> dict[str, Any]:
        """The parameters, with the path of each file or folder that lies beside the experiment file absolute.

        :attr:`parameters` keep it as it was written: results say what the user said.
        """
        values = dict(self.parameters)
        for name in self.plugin().traits.get("paths", ()):
            if self.folder is not None and isinstance(values.get(name), str):
                # What is no path at all is for the source to say.
                with contextlib.suppress(OSError, ValueError, RuntimeError):
                    beside = self.folder / Path(values[name]).expanduser()
                    if beside.exists():
                        values[name] = str(beside.resolve())
        return values

    def with_parameter(self, name: str, value: Any) -> Component:
        """The same with one parameter, or the gate of its own, changed."""
        if name == OWN_GATE and self.kind == "back end":
            return replace(self, own_gate=value)
        return replace(self, parameters={**self.parameters, name: value})


REGISTRIES: dict[str, Registry] = {registry.kind: registry for registry in (sources, front_ends, back_ends)}


def swept_target(path: str) -> tuple[str, str, str]:
    """``source.x`` → (source, "", x); ``back_ends.LABEL.x`` → (back_ends, LABEL, x)."""
    section, _, rest = path.partition(".")
    label, _, parameter = rest.rpartition(".")
    return section, label, parameter
