"""Which files a worker may read: the standard library, the allowed packages, the submission."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import re
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from slamcmp.grading.sandbox.errors import SandboxUnavailable
from slamcmp.grading.sandbox.policy import Readable

_NEVER = {"slamcmp"}
"""It holds the solutions."""


@functools.cache
def readable_for(packages: tuple[str, ...]) -> Readable:
    """What every worker with these packages may read, its own submission not yet among it.

    Raises:
        SandboxUnavailable: a package is not installed, or is slamcmp itself.
    """
    multiarch = sysconfig.get_config_var("MULTIARCH") or ""
    shared = ["/lib64", "/usr/lib64", "/etc/ld.so.cache", "/usr/share/zoneinfo"]
    if multiarch:
        shared += [f"/lib/{multiarch}", f"/usr/lib/{multiarch}"]
    shared += [str(path) for path in Path(sys.base_prefix, "lib").glob("*.so*")]
    entries = [str(path) for path in _package_files(packages)]
    libraries = {sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")}
    sites = {str(Path(path).parent) for path in entries}
    masked = ("site-packages", "dist-packages")
    return Readable(
        trees=tuple(dict.fromkeys(path for path in (*shared, *entries) if os.path.exists(path))),
        libraries=tuple((folder, masked) for folder in sorted(libraries) if _is_stdlib(folder)),
        listed=tuple(sorted(sites)),
    )


def world_reachable(path: str) -> bool:
    """Whether a user without any rights can get to ``path`` and read it."""
    current = Path(path)
    if not current.exists() or not current.stat().st_mode & 0o004:
        return False
    return all(parent.stat().st_mode & 0o001 for parent in Path(os.path.realpath(path)).parents) and all(
        parent.stat().st_mode & 0o001 for parent in current.parents
    )


def _is_stdlib(folder: str) -> bool:
    # In a virtual environment platstdlib names a folder of it that holds site-packages only.
    return os.path.isfile(os.path.join(folder, "os.py")) or os.path.isdir(os.path.join(folder, "lib-dynload"))


def _package_files(packages: Sequence[str]) -> list[Path]:
    """The top-level files and folders of the packages and of all that they require."""
    found: dict[str, Path] = {}
    waiting, seen = [_distribution(name) for name in packages], set()
    while waiting:
        distribution = waiting.pop()
        name = _normal(distribution.metadata["Name"])
        if name in seen:
            continue
        seen.add(name)
        if name in _NEVER:
            raise SandboxUnavailable(
                f"package {name!r} cannot be readable in the sandbox: it holds solutions"
            )
        for file in distribution.files or ():
            top = file.parts[0]
            if top not in ("..", "__pycache__") and not Path(top).is_absolute():
                path = Path(str(distribution.locate_file(top)))
                found[str(path)] = path
        for requirement in distribution.requires or ():
            wanted = re.match(r"[A-Za-z0-9._-]+", requirement)
            if wanted is None or "extra ==" in requirement:
                continue
            try:
                waiting.append(importlib.metadata.distribution(wanted[0]))
            except importlib.metadata.PackageNotFoundError:
                continue
    return list(found.values())


def _distribution(name: str) -> importlib.metadata.Distribution:
    try:
        return importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        owners = importlib.metadata.packages_distributions().get(name)
        if owners:
            return importlib.metadata.distribution(owners[0])
    raise SandboxUnavailable(f"the assignment allows package {name!r}, which is not installed here")


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
