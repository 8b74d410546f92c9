"""The experiments that come with slamcmp, in a checkout or in an installed wheel."""

from __future__ import annotations

from pathlib import Path

from slamcmp.errors import MissingDataError
from slamcmp.registry import did_you_mean
from slamcmp.support.files.paths import is_dir, is_file
from slamcmp.support.files.shipped_files import shipped_folder


def shipped_experiments() -> dict[str, Path]:
    """Every shipped experiment by its name: ``quickstart``, ``anchors/p1``, …"""
    folder = shipped_folder()
    found = sorted(path.relative_to(folder) for path in folder.rglob("*.yaml"))
    return {
        path.with_suffix("").as_posix(): folder / path for path in found if path.parts[0] != "assignments"
    }


def find_experiment(config: str) -> Path:
    """The file ``config``, or the shipped experiment of that name.

    Raises:
        MissingDataError: neither is there.
    """
    path = Path(config)
    if is_file(path):
        return path
    shipped = shipped_experiments()
    name = path.as_posix().removesuffix(path.suffix).removeprefix("experiments/")
    if name in shipped:
        return shipped[name]
    if is_dir(path):
        raise MissingDataError(f"{config!r} is a folder; the experiment file in it is needed")
    hint = did_you_mean(name, shipped) if shipped else ""
    raise MissingDataError(f"there is no experiment file {config!r}{hint}")
