"""What students get of an assignment: handout, starter and public tests; an installation holds no more.

Everything else of an assignment's folder is the staff's (hidden tests, the solution, known mistakes). It lies
in the repository's ``experiments/assignments``; setup.py leaves it out of every wheel.
"""

from __future__ import annotations

import ast
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.registry import did_you_mean
from slamcmp.support.files.shipped_files import shipped_folder

SHIPPED = shipped_folder() / "assignments"
STAFF_VARIABLE = "SLAMCMP_STAFF"
"""Names the folder of the staff's assignments, where they do not lie beside the package."""
FILES = ("README.md", "starter.py", "public_tests.py", "lab.yaml")
"""Of an assignment's folder, what students get; the last is there if there is something to run."""
SPECIFICATION = "assignment.yaml"


@dataclass(frozen=True)
class Handout:
    """The students' part of an assignment."""

    folder: Path
    title: str
    entry: str
    """Name of the file to hand in."""

    @property
    def name(self) -> str:
        """The folder's."""
        return self.folder.name


def handouts() -> dict[str, Handout]:
    """Every assignment that students can be given, by name; the staff's own folder counts too."""
    found: dict[str, Handout] = {}
    for base in (SHIPPED, staff_folder()):
        for readme in sorted(base.glob("*/README.md")) if base is not None else []:
            if all((readme.parent / name).is_file() for name in FILES[:3]):
                found[readme.parent.name] = read_handout(readme.parent)
    return dict(sorted(found.items()))


def staff_folder() -> Path | None:
    """The folder that the environment names.

    Raises:
        MissingDataError: there is no such folder.
    """
    named = os.environ.get(STAFF_VARIABLE)
    if not named:
        return None
    folder = Path(named).expanduser()
    if not folder.is_dir():
        raise MissingDataError(f"{STAFF_VARIABLE}={named}: there is no such folder")
    return folder


def read_handout(folder: Path) -> Handout:
    """The students' part of an assignment's folder.

    Raises:
        UsageError: the handout has no title, or the public tests import no file of a student's.
    """
    head = (folder / "README.md").read_text(encoding="utf-8").splitlines()[:1]
    title = head[0].removeprefix("# ").strip() if head and head[0].startswith("# ") else ""
    if not title:
        raise UsageError(f"{folder / 'README.md'}: the first line has to be the title, '# …'")
    tests = folder / "public_tests.py"
    modules = imported_modules(tests.read_text(encoding="utf-8")) - {"numpy", "slamcmp"}
    if len(modules) != 1:
        what = ", ".join(sorted(modules)) or "none"
        raise UsageError(f"{tests}: has to import from the file that is handed in, no other; here: {what}")
    return Handout(folder, title, f"{modules.pop()}.py")


def find_handout(name: str) -> Handout:
    """One of :func:`handouts`.

    Raises:
        MissingDataError: there is no such assignment; the message tells those there are.
    """
    known = handouts()
    if name not in known:
        hint = did_you_mean(name, known) or f"; there are {', '.join(known)}"
        raise MissingDataError(f"there is no assignment {name!r}{hint}")
    return known[name]


def write_handout(name: str, folder: Path) -> list[Path]:
    """Copy an assignment's handout to ``folder``, with the starter under the name to hand in as well.

    Returns:
        The files written.

    Raises:
        MissingDataError: there is no such assignment.
        UsageError: a file is there already; nothing is overwritten, for it may be somebody's work.
    """
    handout = find_handout(name)
    sources = {each: handout.folder / each for each in FILES if (handout.folder / each).is_file()}
    sources[handout.entry] = handout.folder / "starter.py"
    targets = {folder / each: source for each, source in sources.items()}
    if there := [str(target) for target in targets if os.path.lexists(target)]:
        raise UsageError(f"{there[0]} is there already; name another folder, nothing is overwritten")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for target, source in targets.items():
            shutil.copyfile(source, target)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written: {error.strerror}") from error
    return list(targets)


def export_staff(folder: Path) -> list[Path]:
    """Copy the shipped assignments, whole, to a new folder that ``SLAMCMP_STAFF`` can name.

    Raises:
        MissingDataError: this installation holds the students' part only.
        UsageError: the folder is there already.
    """
    sources = sorted(path.parent for path in SHIPPED.glob(f"*/{SPECIFICATION}"))
    if not sources:
        raise MissingDataError(staff_missing("the assignments"))
    if os.path.lexists(folder):
        raise UsageError(f"{folder} is there already; name a new folder")
    try:
        for source in sources:
            shutil.copytree(source, folder / source.name, ignore=shutil.ignore_patterns("__pycache__"))
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written: {error.strerror}") from error
    return [folder / source.name for source in sources]


def staff_missing(what: str) -> str:
    """What to do where only the students' part is installed."""
    return (
        f"{what}: hidden tests and solutions are not part of an installation; work in a checkout of the "
        f"repository, or set {STAFF_VARIABLE} to the folder that `slamcmp assignment export` wrote there"
    )


def imported_modules(source: str) -> set[str]:
    """Modules that a source imports from, without the packages' parts."""
    nodes = list(ast.walk(ast.parse(source)))
    names = [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    names += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return {name.partition(".")[0] for name in names}
