"""What the shell offers after Tab: experiments, plug-ins, figures, results folders."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

import typer


def results_folders(incomplete: str) -> list[str]:
    """Folders with a manifest: names below ``results/``, or paths where one is begun."""
    begun = Path(incomplete)
    if "/" in incomplete:
        parent = begun if incomplete.endswith("/") else begun.parent
        return sorted(f"{each}" for each in _folders(parent) if str(each).startswith(str(begun)))
    names = [each.name for each in _folders(Path("results"))]
    return _beginning(names, incomplete)


def experiments(incomplete: str) -> list[str]:
    """Shipped experiments, and YAML files here."""
    from slamcmp.experiment.config.shipped import shipped_experiments

    begun = Path(incomplete)
    parent = begun if incomplete.endswith("/") else begun.parent
    files: list[str] = []
    with contextlib.suppress(OSError):
        files = [str(each) for each in parent.glob("*.yaml")]
    return _beginning([*shipped_experiments(), *files], incomplete)


def figures(incomplete: str) -> list[str]:
    """Registered figures."""
    from slamcmp.registry import figures as known

    return _beginning(known.names(), incomplete)


def metrics(incomplete: str) -> list[str]:
    """Metric columns of the trials table."""
    from slamcmp.metrics import metric_columns

    return _beginning(metric_columns(), incomplete)


def kinds(incomplete: str) -> list[str]:
    """What ``slamcmp list`` lists."""
    from slamcmp.cli.kinds import FILES, KINDS

    return _beginning([*KINDS, *FILES], incomplete)


def plugins(ctx: typer.Context, incomplete: str) -> list[str]:
    """Plug-ins of the kind that stands before."""
    from slamcmp.cli.kinds import KINDS

    kind = str(ctx.params.get("kind"))
    if kind == "experiments":
        return experiments(incomplete)
    return _beginning(KINDS[kind].names(), incomplete) if kind in KINDS else []


def back_ends(incomplete: str) -> list[str]:
    """Registered back ends."""
    from slamcmp.registry import back_ends as known

    return _beginning(known.names(), incomplete)


def _folders(parent: Path) -> list[Path]:
    with contextlib.suppress(OSError):
        return [each for each in parent.iterdir() if (each / "manifest.json").is_file()]
    return []


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return sorted(name for name in names if name.startswith(incomplete))
