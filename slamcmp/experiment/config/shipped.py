"""The experiments that come with slamcmp, in a checkout or in an installed wheel."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

from slamcmp.errors import MissingDataError
from slamcmp.registry import did_you_mean

INSTALLED = "share/slamcmp/experiments/"
"""Where the wheel puts them below the environment's root (``data-files`` in pyproject.toml)."""


def shipped_experiments() -> dict[str, Path]:
    """Every shipped experiment by its name: ``quickstart``, ``anchors/p1``, …"""
    root = Path(__file__).resolve().parents[3]
    folder = root / "experiments"
    if (root / "pyproject.toml").is_file():
        found = {path.relative_to(folder): path for path in folder.rglob("*.yaml")}
    else:
        found = {}
        for file in importlib.metadata.files("slamcmp") or []:
            _, inside, relative = file.as_posix().partition(INSTALLED)
            if inside and relative.endswith(".yaml"):
                found[Path(relative)] = Path(str(file.locate())).resolve()
    return {
        path.with_suffix("").as_posix(): found[path]
        for path in sorted(found)
        if path.parts[0] != "assignments"
    }


def find_experiment(config: str) -> Path:
    """The file ``config``, or the shipped experiment of that name.

    Raises:
        MissingDataError: neither is there.
    """
    path = Path(config)
    if path.is_file():
        return path
    shipped = shipped_experiments()
    name = path.with_suffix("").as_posix().removeprefix("experiments/")
    if name in shipped:
        return shipped[name]
    hint = did_you_mean(name, shipped) if shipped else ""
    raise MissingDataError(f"there is no experiment file {config!r}{hint}")
