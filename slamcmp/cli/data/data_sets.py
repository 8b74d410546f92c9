"""``slamcmp data list|info|fetch|verify``: the data sets that others published."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.registry import data_sets

if TYPE_CHECKING:
    from slamcmp.datasets.fetching.data_set import DataSet

INTERRUPTED = 130


def _names(incomplete: str) -> list[str]:
    """For the shell's completion."""
    return [name for name in data_sets.names() if name.startswith(incomplete)]


Names = Annotated[
    list[str],
    typer.Argument(help="Data sets, as 'slamcmp data list' names them.", autocompletion=_names),
]
Json = Annotated[bool, typer.Option("--json", help="As JSON, for programs.")]
Root = Annotated[
    Path | None, typer.Option("--to", help="Folder of all data sets; default: what SLAMCMP_DATA names.")
]


def add_commands(data: typer.Typer) -> None:
    """Put this file's commands into ``slamcmp data``."""
    data.command("list", epilog="Example: slamcmp data list --json")(list_sets)
    data.command(epilog="Example: slamcmp data info mrclam6")(info)
    data.command(
        epilog="Examples: slamcmp data fetch mrclam6 --accept-licence; or from a mirror or a folder: "
        "slamcmp data fetch mrclam6 --from ~/Downloads"
    )(fetch)
    data.command(epilog="Example: slamcmp data verify mrclam6")(verify)


def list_sets(as_json: Json = False, root: Root = None) -> None:
    """List the data sets that are known, and which of them are on this machine."""
    where = _root(root)
    found = [(each, each.find(where)) for each in _all()]
    if as_json:
        _print_json([_facts(each, folder) for each, folder in found])
        return
    width = max(len(each.name) for each, _ in found)
    for each, folder in found:
        print(f"{each.name:{width}}  {'here' if folder else '-':4}  {each.title}")


def info(
    name: Annotated[str, typer.Argument(help="A data set.", autocompletion=_names)],
    as_json: Json = False,
    root: Root = None,
) -> None:
    """Tell title, licence, citation, size, address and checksums of a data set, and how to use it."""
    from slamcmp.datasets.fetching.fetch import what_to_do

    each = _set(name)
    facts = _facts(each, each.find(_root(root)))
    if as_json:
        _print_json(facts)
        return
    lines = [(key, facts[key]) for key in ("title", "licence", "citation", "size", "page")]
    lines += [
        ("archive", f"{one['url']} (size {one['size']}, sha256 {one['sha256']})") for one in facts["archives"]
    ]
    lines += [("sha256", f"{checksum}  {file}") for file, checksum in each.in_wheel.items()]
    lines.append(
        ("here", facts["here"] or ("no; pip install gtsam" if each.in_wheel else f"no; {what_to_do(each)}"))
    )
    lines.append(("source", facts["use"] or "none reads it yet"))
    lines += [("note", note) for note in each.notes]
    for key, text in lines:
        print(f"{key:8}  {text}")


def fetch(
    names: Names,
    accept_licence: Annotated[
        bool, typer.Option("--accept-licence", help="Of each set; without it a terminal is asked.")
    ] = False,
    origin: Annotated[
        str | None,
        typer.Option(
            "--from", help="A mirror: an address or folder with the archives, or a folder with the set."
        ),
    ] = None,
    root: Root = None,
) -> None:
    """Download data sets from their official address, or take them from a mirror.

    A download that was cut off goes on where it ended. A folder in the official archive's layout is taken as
    it is. Exit code 3: it cannot be had from here; one line says what to download from where.
    """
    from slamcmp.datasets.fetching.fetch import fetch as fetch_set
    from slamcmp.support.interruption import interruptions

    where = _root(root)
    chosen = [_set(name) for name in dict.fromkeys(names)]
    if where is None and any(not each.in_wheel for each in chosen):
        raise UsageError("where to? set SLAMCMP_DATA to the folder of all data sets, or give --to FOLDER")
    where = where or Path()
    # Whoever is asked is asked before the first long download.
    for each in chosen:
        if each.find(where) is None:
            _ask(each, accept_licence)
    try:
        with interruptions(raising=True):
            for each in chosen:
                with _progress() as progress:
                    done = fetch_set(each, where, origin=origin, tell=print, progress=progress)
                print(f"{each.name}: {'in' if done.new else 'is there already:'} {done.folder}")
    except KeyboardInterrupt:
        print("slamcmp: interrupted; what came is kept, the same command goes on from there", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def verify(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Data sets; default: all that are here.", autocompletion=_names),
    ] = None,
    as_json: Json = False,
    root: Root = None,
) -> None:
    """Compare data sets with their checksums; exit code 1 where a file is missing or has changed."""
    from slamcmp.datasets.fetching.verify import verify as verify_set

    where = _root(root)
    chosen = [_set(name) for name in names] if names else [each for each in _all() if each.find(where)]
    if not chosen:
        raise MissingDataError("no data set is here: slamcmp data list, slamcmp data fetch NAME")
    verdicts = [verify_set(each, where) for each in chosen]
    if as_json:
        _print_json(
            [
                {"name": one.name, "folder": str(one.folder), "compared": one.basis, "wrong": one.findings}
                for one in verdicts
            ]
        )
    else:
        for one in verdicts:
            for finding in one.findings:
                print(f"wrong: {one.name}: {finding}")
            if not one.findings:
                print(f"{one.name}: as it should be, by {one.basis}")
    if any(one.findings for one in verdicts):
        raise typer.Exit(1)


def _all() -> list[DataSet]:
    return [plugin.target() for plugin in data_sets]


def _set(name: str) -> DataSet:
    """An entry of the catalogue.

    Raises:
        UsageError: there is none of that name.
    """
    found: DataSet = data_sets.get(name).target()
    return found


def _root(given: Path | None) -> Path | None:
    from slamcmp.datasets.fetching.data_set import data_root

    return given if given is not None else data_root()


def _facts(each: DataSet, folder: Path | None) -> dict[str, Any]:
    from slamcmp.datasets.fetching.data_set import NOT_KNOWN

    return {
        "name": each.name,
        "title": each.title,
        "licence": each.licence,
        "citation": each.citation,
        "size": each.size,
        "page": each.page,
        "archives": [
            {"url": one.url, "size": one.size or NOT_KNOWN, "sha256": one.sha256 or NOT_KNOWN}
            for one in each.archives
        ],
        "here": None if folder is None else str(folder),
        "use": each.use,
        "notes": list(each.notes),
    }


def _print_json(what: Any) -> None:
    print(json.dumps(what, indent=2, ensure_ascii=False))


def _ask(each: DataSet, accepted: bool) -> None:
    """Show the terms, and go on only where they are accepted.

    Raises:
        UsageError: they are not.
    """
    print(
        f"{each.name}: {each.title}\n  licence:  {each.licence}\n  citation: {each.citation}\n  address:  "
        f"{each.page}"
    )
    if accepted:
        return
    if sys.stdin.isatty() and typer.confirm("Do you accept these terms?"):
        return
    raise UsageError(
        f"{each.name}: its licence is not accepted, so nothing was downloaded; --accept-licence accepts it"
    )


@contextmanager
def _progress() -> Iterator[Callable[[int, int | None], None] | None]:
    """A bar on a terminal; nothing in a file."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TimeRemainingColumn, TransferSpeedColumn

    columns = (BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
