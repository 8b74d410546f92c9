"""Names for results by what they were computed from: equal key, equal result.

A key covers the normalised configuration of one job, the source text of every module that computes it
(followed through imports, so that changing one back end leaves the others' results valid), the data files
it reads and the versions of the libraries below.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from slamcmp.errors import MissingDataError
from slamcmp.experiment.config.component import Component
from slamcmp.registry import Plugin
from slamcmp.support.plugin_models import bind_parameters

PACKAGE = Path(__file__).resolve().parent.parent
LIBRARIES = ("numpy", "scipy", "gtsam", "opencv-python-headless")
KEY_LENGTH = 24


def stream_key(source: Component, front_end: Component, seed: int | None) -> str:
    """Of the stream that a source and a front end make from a seed."""
    source_plugin, front_end_plugin = source.plugin(), front_end.plugin()
    return _hash(
        {
            "source": [source.name, dict(source.parameters)],
            "front_end": [front_end.name, dict(front_end.parameters)],
            "seed": seed,
            "data": data_digests(source),
            "code": code_version(
                _files(source_plugin) | _files(front_end_plugin) | {PACKAGE / "types" / "__init__.py"}
            ),
            "versions": versions(),
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
    runner = PACKAGE / "experiment" / "job" / "worker.py"
    computing = {
        runner,
        *sorted((PACKAGE / "metrics").glob("*.py")),
        *sorted((PACKAGE / "models").glob("*.py")),
    }
    return _hash(
        {
            "stream": stream,
            "back_end": [back_end.name, dict(back_end.parameters), back_end.own_gate],
            "limits": [time_limit_s, memory_limit_mb],
            "recording": recording,
            "code": code_version(_files(back_end.plugin()) | computing),
            "versions": versions(),
        }
    )


@cache
def versions() -> Mapping[str, str]:
    """Of Python (major.minor) and of the libraries that compute."""
    found = {"python": ".".join(map(str, sys.version_info[:2]))}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


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
        digests[name] = _file_digest(str(path), *_stamp(path))
    return digests


def code_version(files: Iterable[Path]) -> str:
    """sha256 over the text of ``files`` and of every module of ours that they import."""
    hasher = hashlib.sha256()
    for path in sorted(import_closure(files)):
        hasher.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return hasher.hexdigest()


def import_closure(files: Iterable[Path]) -> set[Path]:
    """``files`` and what they import from this package or from their own folder, and so on."""
    reached: set[Path] = set()
    waiting = [path.resolve() for path in files]
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting.extend(_imported(str(path), *_stamp(path)))
    return reached


@cache
def _imported(path_text: str, _modified: int, _size: int) -> tuple[Path, ...]:
    path = Path(path_text)
    found: set[Path] = set()
    for module in _module_names(ast.parse(path.read_bytes()), path):
        parts = module.split(".")
        root = PACKAGE.parent if parts[0] == PACKAGE.name else path.parent
        for length in range(1, len(parts) + 1):
            stem = root.joinpath(*parts[:length])
            found.update(file for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file())
    return tuple(sorted(file.resolve() for file in found))


def _module_names(tree: ast.AST, path: Path) -> Iterator[str]:
    """Every dotted name that might be a module: of ``from a import b`` both a and a.b."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level and path.is_relative_to(PACKAGE):
                package = path.relative_to(PACKAGE.parent).with_suffix("").parts[: -node.level]
                base = ".".join([*package, base]).rstrip(".")
            yield from (f"{base}.{alias.name}".lstrip(".") for alias in node.names if alias.name != "*")
            if base:
                yield base


def _files(plugin: Plugin) -> set[Path]:
    """Where the target is defined, and the user's file that names it (it may only pass it on)."""
    target: Any = plugin.target
    while isinstance(target, functools.partial):
        target = target.func
    file = getattr(sys.modules.get(target.__module__), "__file__", None)
    own = plugin.traits.get("user_file")
    return {Path(each) for each in (file, own) if each is not None}


def _stamp(path: Path) -> tuple[int, int]:
    status = os.stat(path)
    return status.st_mtime_ns, status.st_size


@cache
def _file_digest(path: str, _modified: int, _size: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _hash(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]
