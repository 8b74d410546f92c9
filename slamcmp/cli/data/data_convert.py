"""``slamcmp data convert``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.errors import MissingDataError, StorageError, UsageError

if TYPE_CHECKING:
    from slamcmp.types import Log

TABLES = (".csv", ".parquet", ".txt", ".tsv")
GRAPHS = (".g2o", ".graph", ".toro")


class Tables(StrEnum):
    """What the recording's own files can be written as."""

    csv = "csv"
    parquet = "parquet"


def convert(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="FROM... TO",
            help="From the files of one log (.csv, .parquet, .txt in TUM's format), a graph (.g2o, "
            ".graph), or an "
            "experiment; to a .g2o file, or a folder for the recording's own files.",
        ),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A parameter of the source, such as range_sigma_m=0.05."
        ),
    ] = None,
    format: Annotated[Tables, typer.Option(help="Of the recording's own files.")] = Tables.csv,
    trial: Annotated[int, typer.Option(min=0, help="Which trial's log, of an experiment.")] = 0,
) -> None:
    """Write a log as g2o text, or as the recording's own files with the experiment that reads them."""
    from slamcmp.datasets.graphs.g2o_writer import write_g2o
    from slamcmp.datasets.plain.recording_writer import write_recording

    if len(paths) < 2:
        raise UsageError("FROM... TO: what to convert, and last the .g2o file or the folder to write")
    *given, to = paths
    log = _log(given, settings or [], trial)
    for warning in log.warnings:
        print(f"note: {warning}")
    seen = sum(frame.ids.size for frame in log.detections)
    if Path(to).suffix == ".g2o":
        try:
            write_g2o(to, log)
        except OSError as error:
            raise StorageError(f"cannot write {to}: {error.strerror}") from error
        print(f"{to}: {log.t.size} poses, {seen} observations")
        return
    if Path(to).suffix:
        raise UsageError(f"{to}: a name that ends in .g2o, or a folder for the recording's own files")
    written = write_recording(log, Path(to), kind=format.value)
    for each in written.left_out:
        print(f"not held: {each}")
    print(f"{log.t.size} frames, {seen} detections:")
    for file in written.files:
        print(f"  {file}")


def _log(given: list[str], settings: list[str], trial: int) -> Log:
    """What the first arguments name, as a log.

    Raises:
        UsageError: files that do not belong together, or a parameter that the source does not have.
    """
    from slamcmp.datasets.plain.plain_roles import files_by_role
    from slamcmp.support.files.paths import is_file

    suffixes = {Path(name).suffix for name in given}
    if suffixes <= set(TABLES):
        for name in given:
            if not is_file(Path(name)):
                raise MissingDataError(f"{name}: there is no such file")
        files = files_by_role([Path(name) for name in given])
        if "odometry" not in files:
            raise UsageError(f"{', '.join(given)}: none of them is odometry, which every log needs")
        return _of_source("recording", {role: str(path) for role, path in files.items()}, settings)
    if len(given) > 1:
        raise UsageError(f"{', '.join(given)}: several files are those of one log, {', '.join(TABLES)}")
    if suffixes <= set(GRAPHS):
        return _of_source("graph_file", {"path": given[0]}, settings)
    if settings:
        raise UsageError("--set: an experiment has its parameters in its file")
    from slamcmp.cli.stream import trial_stream

    return trial_stream(given[0], trial)[1]


def _of_source(name: str, parameters: dict[str, Any], settings: list[str]) -> Log:
    from slamcmp.registry import sources

    log: Log = sources.get(name).target(0, **checked_parameters(name, parameters, settings))
    return log


def checked_parameters(name: str, parameters: dict[str, Any], settings: list[str]) -> dict[str, Any]:
    """A source's parameters with those that ``--set NAME=VALUE`` sets.

    Raises:
        UsageError: one that the source does not have, or a value that it does not take.
    """
    from pydantic import ValidationError
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    from slamcmp.registry import did_you_mean, sources
    from slamcmp.support.configuration.plugin_models import bind_parameters

    plugin = sources.get(name)
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or key not in plugin.parameters():
            raise UsageError(f"--set {text}: NAME=VALUE of {name}{did_you_mean(key, plugin.parameters())}")
        try:
            parameters[key] = YAML(typ="safe").load(value)
        except YAMLError as error:
            raise UsageError(f"--set {text}: no value as YAML has them") from error
    try:
        return bind_parameters(plugin, parameters)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"--set {place}: {first['msg']}") from error
