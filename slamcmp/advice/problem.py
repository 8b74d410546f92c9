"""The user's own problem: an experiment file, or the files of a recording, as a checked experiment."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.experiment.config.experiment import Experiment, parse_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.support.configuration.code_source import CodeSource
from slamcmp.support.configuration.extended_yaml import load_extended
from slamcmp.support.files.paths import is_dir, is_file

TABLES = (".csv", ".parquet")
PARTS = ("detections", "truth", "landmarks")
"""Files of a recording beside its odometry."""
SECTIONS = ("source", "front_end")
"""Of a configuration, in which settings may be changed."""


def load_problem(config: str | Path, settings: Sequence[str] = ()) -> Experiment:
    """The experiment that ``config`` names, or one over the recording that lies there.

    Args:
        config: an experiment's file or shipped name; a recording's folder (with ``odometry.csv``, and
            ``detections``, ``truth``, ``landmarks``, as CSV or Parquet) or its odometry file; a folder of
            several such folders, which are then the paired samples.
        settings: ``source.range_sigma_m=0.1``: in place of what the file or the default says.

    Raises:
        MissingDataError: neither an experiment nor a recording is there.
        UsageError: the configuration cannot be used; every mistake is told.
    """
    changes = [_parsed(text) for text in settings]
    path = Path(config)
    if is_dir(path) or path.suffix in TABLES:
        return _parse(_recording(path), None, changes)
    found = find_experiment(str(config))
    source = load_extended(found)
    if not changes:
        return parse_experiment(source, found)
    return _parse(source.data, found, changes)


def _parse(data: Mapping[str, Any], path: Path | None, changes: Sequence[tuple[str, str, Any]]) -> Experiment:
    """Checked, with the changes made; mistakes are told by their keys."""
    changed: dict[str, Any] = dict(data)
    for section, name, value in changes:
        given = changed.get(section, {"name": "labelled"} if section == "front_end" else {})
        changed[section] = {**given, name: value} if isinstance(given, Mapping) else given
    return parse_experiment(CodeSource("experiment", changed), path)


def _parsed(text: str) -> tuple[str, str, Any]:
    """Section, parameter and value of ``source.range_sigma_m=0.1``; the value is JSON, or else a text."""
    key, sign, written = text.partition("=")
    section, dot, name = key.strip().partition(".")
    if not (sign and dot and name and section in SECTIONS):
        raise UsageError(
            f"--set {text!r}: expected source.PARAMETER=VALUE or front_end.PARAMETER=VALUE, "
            "e.g. source.range_sigma_m=0.1"
        )
    try:
        value = json.loads(written)
    except ValueError:
        value = written.strip()
    return section, name.strip(), value


def _recording(path: Path) -> dict[str, Any]:
    """The configuration of one recording, or of all in a folder."""
    if not is_dir(path):
        if not is_file(path):
            raise MissingDataError(f"there is no file {path}")
        files = {"odometry": path, **_beside(path.parent)}
        return _experiment(path.resolve().parent.name, {part: str(each) for part, each in files.items()})
    odometry = _table(path, "odometry")
    if odometry is not None:
        files = {"odometry": odometry, **_beside(path)}
        return _experiment(path.resolve().name, {part: str(each) for part, each in files.items()})
    within = [each for each in sorted(path.iterdir()) if is_dir(each) and _table(each, "odometry")]
    if not within:
        raise MissingDataError(
            f"{path}: no recording here: odometry.csv (or .parquet) is missing, and in every folder of it; "
            "detections, truth and landmarks are looked for beside it (docs/formats.md)"
        )
    several = [{"odometry": _table(each, "odometry"), **_beside(each)} for each in within]
    parts = {part for each in several for part in each}
    for folder, each in zip(within, several, strict=True):
        for part in sorted(parts - each.keys()):
            raise MissingDataError(
                f"{folder}: has no {part} file, which other recordings of {path} have: all or none"
            )
    lists: dict[str, Any] = {part: [str(each[part]) for each in several] for part in sorted(parts)}
    return _experiment(path.resolve().name, lists)


def _experiment(name: str, files: Mapping[str, Any]) -> dict[str, Any]:
    # A name of its own is for the results folder: what it must not hold is left out.
    kept = "".join(each if each.isascii() and (each.isalnum() or each in "_.-") else "-" for each in name)
    return {
        "name": kept.lstrip("_.-")[:100] or "recording",
        "source": {"name": "recording", **files},
        "back_ends": [{"name": "ekf_slam"}],
    }


def _beside(folder: Path) -> dict[str, Path]:
    found = {part: _table(folder, part) for part in PARTS}
    if found["truth"] is None and is_file(folder / "truth.txt"):
        found["truth"] = folder / "truth.txt"
    return {part: path for part, path in found.items() if path is not None}


def _table(folder: Path, part: str) -> Path | None:
    return next(
        (folder / f"{part}{suffix}" for suffix in TABLES if is_file(folder / f"{part}{suffix}")), None
    )
