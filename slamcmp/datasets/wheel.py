"""The data files that gtsam's wheel carries."""

from __future__ import annotations

import difflib
import importlib.util
from pathlib import Path

from slamcmp.errors import MissingDataError
from slamcmp.support.files.paths import expanded, is_dir, is_file


def wheel_file(name: str) -> Path:
    """The path of ``gtsam/Data/<name>``, found without importing gtsam (0.3 s).

    Raises:
        MissingDataError: gtsam is not installed, or its wheel has no such file; near names are listed.
    """
    folder = wheel_folder()
    if folder is None:
        raise MissingDataError(f"{name}: needs the data of the gtsam wheel; 'pip install gtsam' brings it")
    path = folder / name
    if not is_file(path):
        known = sorted(file.name for file in folder.glob("*")) if is_dir(folder) else []
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
        hint = f"; near names: {', '.join(near)}" if near else ""
        raise MissingDataError(f"{name}: there is no such file in {folder}{hint}")
    return path


def wheel_folder() -> Path | None:
    """The folder ``gtsam/Data``, found without importing gtsam; None where gtsam is not installed."""
    spec = importlib.util.find_spec("gtsam")
    return None if spec is None or spec.origin is None else Path(spec.origin).parent / "Data"


def find_file(path: str) -> Path:
    """``path`` where it is a file, else the file of that name in the gtsam wheel.

    Raises:
        MissingDataError: neither exists.
    """
    own = expanded(path)
    if is_file(own):
        return own
    if own.is_absolute():
        raise MissingDataError(f"{path}: there is no such file")
    try:
        return wheel_file(path)
    except MissingDataError as error:
        raise MissingDataError(f"{error}; nor in the working directory {Path.cwd()}") from error
