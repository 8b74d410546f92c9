"""Can this machine and this installation run experiments? One finding a line."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "pydantic", "typer", "rich")


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    what: str
    ok: bool
    detail: str
    """What was found or, where it is not ok, what to do."""


def examine() -> Iterator[Finding]:
    """Look at everything an experiment needs, in the order in which it needs it."""
    checks: tuple[tuple[str, Callable[[], str]], ...] = (
        ("Python", lambda: f"{platform.python_version()} on {platform.platform()}"),
        ("libraries", _libraries),
        ("gtsam", _gtsam),
        ("OpenCV", _opencv),
        ("numba", _numba),
        ("data in the gtsam wheel", _wheel_data),
        ("BLAS threads", _blas_threads),
        ("writing here", _writable),
        ("machine", _machine),
    )
    for what, check in checks:
        try:
            yield Finding(what, True, check())
        except Exception as error:
            yield Finding(what, False, f"{type(error).__name__}: {error}")


def _libraries() -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES)


def _gtsam() -> str:
    """Solve three poses a metre apart that see one landmark: the last must lie at x = 2."""
    from slamcmp.models.sensors import make_sensor
    from slamcmp.registry import back_ends
    from slamcmp.types import Frame, Problem

    plugin = back_ends.get("isam2")
    start = Problem(np.eye(3), np.eye(3) * 1e-4, make_sensor("relative_position", {"space_dim": 2}))
    back_end = plugin.target(start)
    for k in range(3):
        step = np.eye(3)
        step[0, 2] = 1.0 if k else 0.0
        Q, R = np.eye(3) * (1e-4 if k else 0.0), np.eye(2)[None]
        back_end.update(Frame(k, float(k), step, Q, np.array([7]), np.array([[5.0 - k, 1.0]]), R))
    x = back_end.estimate().T_world_body[0, 2]
    if abs(x - 2.0) > 1e-6:
        raise RuntimeError(f"3 poses came out at x = {x}, not 2; reinstall: pip install 'gtsam>=4.3,<4.4'")
    return f"{importlib.metadata.version('gtsam')} solves a 3-pose graph"


def _opencv() -> str:
    cv2 = importlib.import_module("cv2")
    corners = cv2.goodFeaturesToTrack(np.kron(np.eye(4), np.full((8, 8), 255)).astype(np.uint8), 8, 0.1, 2)
    return f"{cv2.__version__} finds {len(corners)} corners on a chequered image"


def _numba() -> str:
    """It is optional; one that is installed and does not load is a fault (it is particular about numpy)."""
    if importlib.util.find_spec("numba") is None:
        return "not installed; filters in the plane take several times as long: pip install 'slamcmp[fast]'"
    return f"{importlib.import_module('numba').__version__} compiles filters in the plane"


def _wheel_data() -> str:
    from slamcmp.registry import sources

    plugin = sources.get("victoria_park")
    files = [Path(path) for path in plugin.traits["files"]()]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise FileNotFoundError(f"{missing[0]} is missing; reinstall: pip install --force-reinstall gtsam")
    return ", ".join(f"{path.name} ({path.stat().st_size // 1024} kB)" for path in files)


def _blas_threads() -> str:
    found = os.environ.get("OPENBLAS_NUM_THREADS", "not limited")
    return f"{found} here, 1 in each worker"


def _writable() -> str:
    with tempfile.TemporaryFile(dir=Path.cwd()) as file:
        file.write(b"x" * 4096)
    status = os.statvfs(Path.cwd())
    return f"{Path.cwd()}, {status.f_bavail * status.f_frsize / 1e9:.1f} GB free"


def _machine() -> str:
    from slamcmp.experiment.gathering.manifest import cpu_name
    from slamcmp.support.cores import available_cores
    from slamcmp.support.memory import machine_memory_mb

    return f"{cpu_name()}, {available_cores()} cores, {machine_memory_mb() / 1024:.1f} GB memory"
