"""Where results come from: code, machine, configuration."""

from __future__ import annotations

import datetime
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import slamcmp
from slamcmp.experiment.config import Experiment
from slamcmp.experiment.content_key import PACKAGE, versions


def describe_origin(experiment: Experiment, command: str) -> dict[str, Any]:
    """The part of a manifest that is known before anything ran."""
    return {
        "name": experiment.name,
        "question": experiment.question,
        "description": experiment.description,
        "created": now(),
        "command": command,
        "versions": {"slamcmp": slamcmp.__version__, **versions()},
        "commit": commit(),
        "cpu": cpu_name(),
        "platform": platform.platform(),
        "python": sys.version.split()[0],
        "config": experiment.as_dict(),
        "seeds": [seed for seed in experiment.seeds if seed is not None],
    }


def now() -> str:
    """The time in UTC, ISO 8601 to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def commit() -> dict[str, Any] | None:
    """``{sha, dirty}`` of the git checkout that the package lies in; None outside of one."""
    root = PACKAGE.parent
    if not (root / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        asked = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=10, check=True
        )
        return asked.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", PACKAGE.name)
        return {"sha": git("rev-parse", "HEAD"), "dirty": bool(changed)}
    except (OSError, subprocess.SubprocessError):
        return None


def cpu_name() -> str:
    """The processor's model name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
