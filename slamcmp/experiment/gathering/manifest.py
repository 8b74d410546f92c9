"""Where results come from: code, machine, configuration."""

from __future__ import annotations

import datetime
import json
import linecache
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import slamcmp
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.content_key import run_code, stream_code
from slamcmp.registry import SESSION
from slamcmp.results.store import finite
from slamcmp.support.files.paths import is_file
from slamcmp.support.provenance.code_version import PACKAGE, code_version, versions

SEEDS_NAMED = 8
"""Of a folder, so many at most stand in its name."""
WITH_DEFAULTS = frozenset({"source", "front_end", "back_ends"})
"""Keys of a configuration below which every parameter stands, whether it was given or not."""


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
        "code": code(experiment),
        "cpu": cpu_name(),
        "platform": platform_name(),
        "python": python_version(),
        "config": experiment.as_dict(),
        "config_file": None if experiment.path is None else str(experiment.path),
        "seeds": [seed for seed in experiment.seeds if seed is not None],
        "in_session": in_session(experiment),
    }


def code(experiment: Experiment) -> dict[str, str]:
    """The version by its text of what makes the stream, and of each back end with what scores it."""
    parts = {"stream": stream_code(experiment.source, experiment.front_end)}
    parts |= {each.label: run_code(each) for each in experiment.back_ends}
    return {part: code_version(files) for part, files in parts.items()}


def in_session(experiment: Experiment) -> dict[str, str | None]:
    """Of each back end that only this process has the label, and the text of the cell or file it is from."""
    plugins = {choice.label: choice.plugin() for choice in experiment.back_ends}
    return {label: _text(each.target) for label, each in plugins.items() if SESSION in each.traits}


def _text(target: Any) -> str | None:
    """Through a function's code: a class of a notebook's cell does not know where it is from."""
    for each in (target, *getattr(target, "__dict__", {}).values()):
        code = getattr(each, "__code__", None)
        if code is not None:
            return "".join(linecache.getlines(code.co_filename)) or None
    return None


def now() -> str:
    """The time in UTC, ISO 8601 to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def folder_for_seeds(folder: Path, seeds: Sequence[int] | None) -> Path:
    """``folder``, or one beside it where it has a table of other seeds, which a run of these would replace.

    ``results/NAME-seed-7``; of no seeds in particular (None) it is the folder itself.
    """
    if seeds is None:
        return folder
    try:
        known = set(json.loads((folder / "manifest.json").read_text())["seeds"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError, MemoryError):
        return folder
    if known <= set(seeds):
        return folder
    named = (
        "-".join(map(str, seeds)) if len(seeds) <= SEEDS_NAMED else f"{seeds[0]}-and-{len(seeds) - 1}-more"
    )
    return folder.with_name(f"{folder.name}-seed{'s' if len(seeds) > 1 else ''}-{named}")


def require_same_experiment(experiment: Experiment, folder: Path) -> None:
    """Keep one experiment from replacing the results of another that only has the same name.

    Two files are the same experiment where both ask the same, of however many seeds, or where the first is no
    longer at its place: a file may change, and may move.

    Raises:
        UsageError: the folder holds the results of another file.
    """
    try:
        known = json.loads((folder / "manifest.json").read_text())
        file, config = known["config_file"], known["config"]
        other = experiment.path is not None and Path(file) != experiment.path and is_file(Path(file))
    except (OSError, ValueError, LookupError, TypeError, RecursionError, MemoryError):
        # Damaged, or of a program: what it says about another experiment nobody knows.
        return
    if not other:
        return
    if _asks_the_same(config, json.loads(json.dumps(finite(experiment.as_dict()), default=str))):
        return
    raise UsageError(
        f"{folder} holds the results of {file}, a different experiment of the same name; these of "
        f"{experiment.path} need a 'name:' of their own, or another folder with --results"
    )


def _asks_the_same(known: Any, now: Any, *, defaults: bool = True) -> bool:
    """Whether two configurations differ in nothing but seeds, and settings that the first did not have yet.

    With ``defaults`` every setting stands in both, so that one that is only in the second is newer than the
    results.
    """
    if isinstance(known, dict) and isinstance(now, dict):
        names = (known.keys() if defaults else known.keys() | now.keys()) - {"seeds"}
        return all(
            name in known
            and name in now
            and _asks_the_same(known[name], now[name], defaults=defaults and name in WITH_DEFAULTS)
            for name in names
        )
    if isinstance(known, list) and isinstance(now, list):
        pairs = zip(known, now, strict=False)
        return len(known) == len(now) and all(_asks_the_same(a, b, defaults=defaults) for a, b in pairs)
    return bool(known == now)


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
        # A new file under the package is code that the commit does not name, a back end say.
        changed = git("status", "--porcelain", "--untracked-files=all", "--", PACKAGE.name)
        return {"sha": git("rev-parse", "HEAD"), "dirty": bool(changed)}
    except (OSError, subprocess.SubprocessError):
        return None


def python_version() -> str:
    """``3.12.4``."""
    return sys.version.split()[0]


def platform_name() -> str:
    """Operating system and machine."""
    return platform.platform()


def cpu_name() -> str:
    """The processor's model name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
