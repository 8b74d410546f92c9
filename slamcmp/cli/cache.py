"""``slamcmp cache path|info|clear``: the results that all experiments share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from slamcmp.cli.output import answer
from slamcmp.errors import UsageError

if TYPE_CHECKING:
    from slamcmp.experiment.shared_cache import SharedCache


def add_commands(app: typer.Typer) -> None:
    """Put this file's commands into the application."""
    cache = typer.Typer(
        name="cache",
        help="Look at, or clear, the results that all experiments share.",
        epilog="Example: slamcmp cache info",
        no_args_is_help=True,
    )
    cache.command(epilog="Example: slamcmp cache path")(path)
    cache.command(epilog="Example: slamcmp cache info --json")(info)
    cache.command(epilog="Example: slamcmp cache clear")(clear)
    app.add_typer(cache)


def path() -> None:
    """Print where the cache is: SLAMCMP_CACHE, else slamcmp in XDG_CACHE_HOME or ~/.cache."""
    folder = str(_cache().folder)
    answer(folder=folder)
    print(folder)


def info() -> None:
    """Tell what the cache holds.

    A result of a job with the same key (configuration, code, data and versions) is taken from there,
    whichever experiment or results folder computed it; slamcmp run --no-cache does without. SLAMCMP_CACHE
    names another folder, or turns it off: SLAMCMP_CACHE=off.
    """
    from slamcmp.experiment.shared_cache import LIMIT_BYTES

    cache = _cache()
    held = cache.content()
    answer(
        folder=str(cache.folder),
        runs=held.runs,
        streams=held.streams,
        size_bytes=held.size_bytes,
        limit_bytes=LIMIT_BYTES,
    )
    print(f"folder   {cache.folder}")
    print(f"runs     {held.runs}")
    print(f"streams  {held.streams}")
    print(f"size     {held.size_bytes / 1e6:.1f} MB, at most {LIMIT_BYTES / 1e6:.0f} MB: the oldest go first")


def clear() -> None:
    """Remove all that the cache holds; results folders keep what they have."""
    cache = _cache()
    held = cache.clear()
    answer(folder=str(cache.folder), runs=held.runs, streams=held.streams, size_bytes=held.size_bytes)
    print(f"removed: {held.runs} runs, {held.streams} streams, {held.size_bytes / 1e6:.1f} MB")


def _cache() -> SharedCache:
    """The cache.

    Raises:
        UsageError: it is turned off.
    """
    from slamcmp.experiment.shared_cache import VARIABLE, shared_cache

    cache = shared_cache()
    if cache is None:
        raise UsageError(
            f"the shared cache is off: {VARIABLE} says so, or there is no home; unset it, or name a folder"
        )
    return cache
