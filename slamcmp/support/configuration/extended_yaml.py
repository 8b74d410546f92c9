"""``extends: other.yaml``: one file over another, each value with the place where it stands.

Mappings are joined key by key, the file's own values over those of the one it extends; lists and single
values are replaced whole, and so is a plug-in by one of another name. The experiment's own ``name`` is not
taken over: two of one name would share a results folder. A relative path starts in the folder of its file.
``sweep: null`` takes an inherited key at the top away.
Keys at the top that begin with ``x-`` are for anchors and mean nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.support.configuration.yaml_source import KeyPath, YamlSource, load_yaml
from slamcmp.support.files.paths import is_file

EXTENDS = "extends"
NOT_INHERITED = frozenset({"name", EXTENDS})
PRIVATE = "x-"
DEEPEST = 20
"""Files over one another."""
WITH_PATHS = frozenset({"source", "front_end", "back_ends"})
"""Sections in which a value may be the path of a file or folder."""


class ExtendedSource:
    """A file and those that it extends, as one configuration."""

    def __init__(self, layers: Sequence[YamlSource], data: dict[str, Any]) -> None:
        self._layers = layers
        """The file itself first."""
        self.data = data

    def existing(self, path: Sequence[str | int]) -> KeyPath:
        """``path`` without the steps that lead nowhere."""
        return self._layer(path).existing(path)

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, ...]:
        """Sorts mistakes by file, then by place."""
        layer = self._layer(path)
        return self._layers.index(layer), *layer.position(path, key=key)

    def where(self, path: Sequence[str | int], *, key: bool = False) -> str:
        """The place in the file in which the value stands."""
        return self._layer(path).where(path, key=key)

    def _layer(self, path: Sequence[str | int]) -> YamlSource:
        """The first file that has the most of the path: what stands there is what counts."""

        def depth(layer: YamlSource) -> int:
            node: Any = layer.data
            for count, step in enumerate(path):
                if isinstance(node, Mapping) and step in node:
                    node = node[str(step)]
                elif isinstance(node, list) and isinstance(step, int) and step < len(node):
                    node = node[step]
                else:
                    return count
            return len(path)

        return max(self._layers, key=depth)


def load_extended(path: Path) -> YamlSource | ExtendedSource:
    """Read a file and all that it extends.

    Raises:
        MissingDataError: the file itself is not there.
        UsageError: a file is no YAML, or ``extends`` names none, goes round in a circle or too deep; with its
            place.
    """
    layers, folders = [load_yaml(path)], [path.resolve().parent]
    seen = [path.resolve()]
    while EXTENDS in layers[-1].data:
        named = layers[-1].data[EXTENDS]
        where = layers[-1].where((EXTENDS,))
        if not isinstance(named, str) or not named:
            raise UsageError(f"{where}: extends: the path of another file is needed, not {named!r}")
        try:
            other = (folders[-1] / Path(named).expanduser()).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise UsageError(f"{where}: extends: {named!r} is no path: {error}") from error
        if other in seen:
            circle = " → ".join(each.name for each in [*seen[seen.index(other) :], other])
            raise UsageError(f"{where}: extends: goes round in a circle: {circle}")
        if not is_file(other):
            raise UsageError(f"{where}: extends: there is no file {other}")
        if len(layers) == DEEPEST:
            raise UsageError(f"{where}: extends: more than {DEEPEST} files over one another")
        try:
            layers.append(load_yaml(other))
        except MissingDataError as error:
            raise UsageError(f"{where}: extends: {error}") from error
        seen.append(other)
        folders.append(other.parent)
    data: dict[str, Any] = {}
    for layer, folder in reversed(list(zip(layers, folders, strict=True))):
        own = {
            key: _rebased(value, folder, folders[0]) if key in WITH_PATHS else value
            for key, value in layer.data.items()
            if key != EXTENDS
            and not key.startswith(PRIVATE)
            and (layer is layers[0] or key not in NOT_INHERITED)
        }
        gone = {key for key, value in own.items() if value is None and key in data}
        data = {key: value for key, value in _joined(data, own).items() if key not in gone}
    if len(layers) == 1 and data == layers[0].data:
        return layers[0]
    return ExtendedSource(layers, data)


def _joined(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of both; another ``name`` is another plug-in, to which the old one's parameters mean nothing."""
    found = dict(below)
    for key, value in above.items():
        old = found.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        if both and value.get("name", old.get("name")) == old.get("name"):  # type: ignore[union-attr]
            found[key] = _joined(old, value)  # type: ignore[arg-type]
        else:
            found[key] = value
    return found


def _rebased(value: Any, folder: Path, base: Path) -> Any:
    """Relative paths that lead somewhere from ``folder``, written as from ``base``."""
    if folder == base:
        return value
    if isinstance(value, Mapping):
        return {key: each if key == "label" else _rebased(each, folder, base) for key, each in value.items()}
    if isinstance(value, list):
        return [_rebased(each, folder, base) for each in value]
    if not isinstance(value, str) or not value or os.path.isabs(value):
        return value
    file, mark, attribute = value.partition(".py:")
    path = Path(f"{file}.py") if mark else Path(value)
    try:
        there = (folder / path).exists()
    except (OSError, ValueError):
        return value
    if not there:
        return value
    moved = os.path.relpath(folder / path, base)
    return f"{moved}:{attribute}" if mark else moved
