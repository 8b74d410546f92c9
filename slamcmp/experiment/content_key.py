"""Names for results by what they were computed from: equal key, equal result.

A key covers the normalised configuration of one job, the source text of every module that computes it
(followed through imports, so that changing one back end leaves the others' results valid), the data files
it reads and the versions of the libraries that compute.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slamcmp.errors import MissingDataError, SlamcmpError, UsageError
from slamcmp.experiment.config.component import Component
from slamcmp.registry import SESSION, Plugin
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.support.files.paths import is_file
from slamcmp.support.messages import describe
from slamcmp.support.provenance.code_version import (
    PACKAGE,
    code_digests,
    file_digest,
    other_libraries,
    stamp,
    version_of,
    versions,
)

KEY_LENGTH = 24


class Snapshot:
    """Code and data as one planning sees them: each file is read once, whatever happens to it meanwhile."""

    def __init__(self) -> None:
        self._code: dict[frozenset[Path], Mapping[str, str]] = {}
        self._named: dict[frozenset[Path], Mapping[str, Any]] = {}
        self._data: dict[str, DataFiles] = {}

    def named(self, files: Iterable[Path]) -> Mapping[str, Any]:
        """The fields of a key that stand for code."""
        asked = frozenset(files)
        if asked not in self._named:
            known = {**versions(), **other_libraries(asked)}
            self._named[asked] = {"code": version_of(self.code(asked)), "versions": known}
        return self._named[asked]

    def code(self, files: Iterable[Path]) -> Mapping[str, str]:
        """sha256 of the text of ``files`` and of all that they import, by path."""
        asked = frozenset(files)
        if asked not in self._code:
            self._code[asked] = code_digests(asked)
        return self._code[asked]

    def data(self, component: Component) -> DataFiles:
        """The data files that a plug-in says it reads."""
        asked = json.dumps(
            [component.kind, component.spec, component.arguments()], sort_keys=True, default=str
        )
        if asked not in self._data:
            self._data[asked] = data_files(component)
        return self._data[asked]


@dataclass(frozen=True)
class DataFiles:
    """The data files that a plug-in says it reads."""

    digests: Mapping[str, str]
    """sha256 by file name, or by path where names are alike."""
    stamps: Mapping[str, tuple[int, ...]]
    """What each looked like when it was hashed, by absolute path."""


def stream_key(
    source: Component, front_end: Component, seed: int | None, snapshot: Snapshot | None = None
) -> str:
    """Of the stream that a source and a front end make from a seed."""
    return stream_keys(source, front_end, snapshot)(seed)


def stream_keys(
    source: Component, front_end: Component, snapshot: Snapshot | None = None
) -> Callable[[int | None], str]:
    """The keys of the streams that a source and a front end make, by their seeds."""
    snapshot = snapshot or Snapshot()
    of_front_end = snapshot.data(front_end).digests
    return _hashes(
        {
            "source": [source.name, dict(source.parameters)],
            "front_end": [front_end.name, dict(front_end.parameters)],
            "seed": _OPEN,
            "data": snapshot.data(source).digests,
            **({"front_end_data": of_front_end} if of_front_end else {}),
            **snapshot.named(stream_code(source, front_end)),
        }
    )


def run_key(
    stream: str,
    back_end: Component,
    time_limit_s: float,
    memory_limit_mb: float | None,
    recording: Mapping[str, Any] | None = None,
    snapshot: Snapshot | None = None,
) -> str:
    """Of a back end's run, with its scores, on the stream of that key."""
    return run_keys(back_end, time_limit_s, memory_limit_mb, recording, snapshot)(stream)


def run_keys(
    back_end: Component,
    time_limit_s: float,
    memory_limit_mb: float | None,
    recording: Mapping[str, Any] | None = None,
    snapshot: Snapshot | None = None,
) -> Callable[[str], str]:
    """The keys of a back end's runs, by those of their streams."""
    snapshot = snapshot or Snapshot()
    data = snapshot.data(back_end).digests
    key_on = _hashes(
        {
            "stream": _OPEN,
            "back_end": [back_end.name, dict(back_end.parameters), back_end.own_gate],
            "limits": [time_limit_s, memory_limit_mb],
            "recording": recording,
            **({"data": data} if data else {}),
            **snapshot.named(run_code(back_end)),
        }
    )
    session = back_end.plugin().traits.get(SESSION)
    # The text of what a notebook defined is not known for sure: no other session may take its result over.
    return key_on if session is None else lambda stream: f"{SESSION}-{session}-{key_on(stream)}"


def stream_code(source: Component, front_end: Component) -> set[Path]:
    """The files whose code, with all that they import, makes a stream."""
    maker = PACKAGE / "experiment" / "job" / "make_stream.py"
    return plugin_files(source.plugin()) | plugin_files(front_end.plugin()) | _package("models") | {maker}


def run_code(back_end: Component) -> set[Path]:
    """The files whose code, with all that they import, runs and scores a back end."""
    worker = PACKAGE / "experiment" / "job" / "worker.py"
    return plugin_files(back_end.plugin()) | _package("models") | _package("metrics") | {worker}


def data_files(component: Component) -> DataFiles:
    """What a plug-in says it reads, and the files' content.

    Raises:
        MissingDataError: one of them is not there.
        UsageError: a user's own list of files cannot be made.
    """
    plugin = component.plugin()
    paths = _declared(component, plugin)
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        # The left and the right image of an instant are often called alike.
        absolute = [path.absolute() for path in paths]
        root = os.path.commonpath([path.parent for path in absolute])
        names = [path.relative_to(root).as_posix() for path in absolute]
    digests: dict[str, str] = {}
    stamps: dict[str, tuple[int, ...]] = {}
    for name, path in zip(names, paths, strict=True):
        if not is_file(path):
            raise MissingDataError(f"{component.kind} {component.name!r}: there is no data file {path}")
        try:
            # The stamp first: what changes while it is hashed is noticed later.
            stamps[str(path.absolute())] = stamp(path)
            digests[name] = file_digest(path)
        except OSError as error:
            raise MissingDataError(
                f"{component.kind} {component.name!r}: {path} cannot be read ({error.strerror})"
            ) from error
    return DataFiles(digests, stamps)


def _declared(component: Component, plugin: Plugin) -> list[Path]:
    files = plugin.traits.get("files")
    if files is None:
        return []
    own = plugin.traits.get("user_file")
    try:
        named = files(**bind_parameters(plugin, component.arguments())) if callable(files) else files
        paths = [Path(each) for each in ([named] if isinstance(named, str | Path) else named)]
    except MissingDataError as error:
        if component.folder is None or not plugin.traits.get("paths"):
            raise
        folder = component.folder.resolve()
        raise MissingDataError(f"{error}; looked beside the experiment file first, in {folder}") from error
    except SlamcmpError:
        raise
    except Exception as error:
        if own is None:
            raise
        raise UsageError(
            f"{component.kind} {component.name!r}: its 'files' cannot be listed: {describe(error)}"
        ) from error
    if own is not None:
        # Beside the file that names them, as its own code mostly finds them, unless they are only here.
        paths = [beside if (beside := own.parent / path).exists() else path for path in paths]
    return paths


def plugin_files(plugin: Plugin) -> set[Path]:
    """Where the target is defined, and the user's file that names it (it may only pass it on)."""
    target: Any = plugin.target
    while isinstance(target, functools.partial):
        target = target.func
    file = getattr(sys.modules.get(target.__module__), "__file__", None)
    own = plugin.traits.get("user_file")
    return {Path(each) for each in (file, own) if each is not None}


def _package(name: str) -> set[Path]:
    """Every module of a package of ours: its registry loads them all, which no import statement tells."""
    return set((PACKAGE / name).rglob("*.py"))


_OPEN = "open: 5c1f3ad0-1a4b-4f0e-9a53-6a0a4f2f7d1c"
"""Stands for the one field in which the keys of many jobs differ."""


def _hashes(content: dict[str, Any]) -> Callable[[Any], str]:
    """The hash of ``content`` by what stands in its open field: all else is written and hashed once."""
    before, after = (
        json.dumps(content, sort_keys=True, default=str).encode().split(json.dumps(_OPEN).encode())
    )
    begun = hashlib.sha256(before)

    def with_value(value: Any) -> str:
        hasher = begun.copy()
        hasher.update(json.dumps(value).encode() + after)
        return hasher.hexdigest()[:KEY_LENGTH]

    return with_value
