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
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slamcmp.errors import MissingDataError
from slamcmp.experiment.config.component import Component
from slamcmp.registry import SESSION, Plugin
from slamcmp.support.code_version import PACKAGE, code_version, file_digest, other_libraries, versions
from slamcmp.support.plugin_models import bind_parameters

KEY_LENGTH = 24


def stream_key(source: Component, front_end: Component, seed: int | None) -> str:
    """Of the stream that a source and a front end make from a seed."""
    return _hash(
        {
            "source": [source.name, dict(source.parameters)],
            "front_end": [front_end.name, dict(front_end.parameters)],
            "seed": seed,
            "data": data_digests(source),
            "code": code_version(stream_code(source, front_end)),
            "versions": {**versions(), **other_libraries(stream_code(source, front_end))},
        }
    )


def run_key(
    stream: str,
    back_end: Component,
    time_limit_s: float,
    memory_limit_mb: float | None,
    recording: Mapping[str, Any] | None = None,
) -> str:
    """Of a back end's run, with its scores, on the stream of that key."""
    key = _hash(
        {
            "stream": stream,
            "back_end": [back_end.name, dict(back_end.parameters), back_end.own_gate],
            "limits": [time_limit_s, memory_limit_mb],
            "recording": recording,
            "code": code_version(run_code(back_end)),
            "versions": {**versions(), **other_libraries(run_code(back_end))},
        }
    )
    session = back_end.plugin().traits.get(SESSION)
    # The text of what a notebook defined is not known for sure: no other session may take its result over.
    return key if session is None else f"{SESSION}-{session}-{key}"


def stream_code(source: Component, front_end: Component) -> set[Path]:
    """The files whose code, with all that they import, makes a stream."""
    maker = PACKAGE / "experiment" / "job" / "make_stream.py"
    return plugin_files(source.plugin()) | plugin_files(front_end.plugin()) | _package("models") | {maker}


def run_code(back_end: Component) -> set[Path]:
    """The files whose code, with all that they import, runs and scores a back end."""
    worker = PACKAGE / "experiment" / "job" / "worker.py"
    return plugin_files(back_end.plugin()) | _package("models") | _package("metrics") | {worker}


def data_digests(source: Component) -> dict[str, str]:
    """sha256 of each data file the source says it reads, by file name, or by path where names are alike.

    Raises:
        MissingDataError: one of them is not there.
    """
    plugin = source.plugin()
    files = plugin.traits.get("files")
    if files is None:
        return {}
    try:
        paths = [Path(path) for path in files(**bind_parameters(plugin, source.arguments()))]
    except MissingDataError as error:
        if source.folder is None or not plugin.traits.get("paths"):
            raise
        folder = source.folder.resolve()
        raise MissingDataError(f"{error}; looked beside the experiment file first, in {folder}") from error
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        # The left and the right image of an instant are often called alike.
        absolute = [path.absolute() for path in paths]
        root = os.path.commonpath([path.parent for path in absolute])
        names = [path.relative_to(root).as_posix() for path in absolute]
    digests = {}
    for name, path in zip(names, paths, strict=True):
        if not path.is_file():
            raise MissingDataError(f"source {source.name!r}: there is no data file {path}")
        digests[name] = file_digest(path)
    return digests


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
    return set((PACKAGE / name).glob("*.py"))


def _hash(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]
