"""The version of code by its text: sha256 over the files that compute something and over what they import.

Imports are followed through the source text, also those inside functions, so that changing one back end
leaves the versions of the others as they are.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import importlib.util
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]
LIBRARIES = ("numpy", "scipy", "gtsam", "opencv-python-headless")
REQUIRED = frozenset(
    {"annotated_types", "cv2", "gtsam", "jinja2", "matplotlib", "numpy", "pandas", "pyarrow", "pydantic"}
    | {"plotly", "pooch", "requests", "rich", "ruamel", "scipy", "typer"}
)
"""Modules of what slamcmp always needs (pyproject.toml); those that compute are among LIBRARIES."""


@cache
def versions() -> Mapping[str, str]:
    """Of Python (major.minor) and of the libraries that compute."""
    found = {"python": ".".join(map(str, sys.version_info[:2]))}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


def other_libraries(files: Iterable[Path]) -> dict[str, str]:
    """Versions of what ``files`` and ours that they import need beside slamcmp's own requirements.

    numba for filters that it compiles, or whatever a user's file imports; ``absent`` where it is not
    installed. So a failure for want of a library is not told again once the library is there.
    """
    names = {name for path in import_closure(files) for name in _source(path).foreign}
    return {name: _version(name) for name in sorted(names)}


def code_version(files: Iterable[Path]) -> str:
    """sha256 over the text of ``files`` and of every module of ours that they import."""
    return version_of(code_digests(files))


def version_of(digests: Mapping[str, str]) -> str:
    """sha256 over the digests of files, by path; where the package lies makes no difference."""
    hasher = hashlib.sha256()
    for path_text, digest in sorted(digests.items()):
        path = Path(path_text)
        inside = path.is_relative_to(PACKAGE)
        name = path.relative_to(PACKAGE).as_posix() if inside else path.name
        hasher.update(name.encode(errors="surrogateescape") + b"\0" + bytes.fromhex(digest))
    return hasher.hexdigest()


def code_digests(files: Iterable[Path]) -> dict[str, str]:
    """sha256 of the text of ``files`` and of every module of ours that they import, by absolute path."""
    return {str(path): _source(path).digest for path in import_closure(files)}


def import_closure(files: Iterable[Path]) -> set[Path]:
    """``files`` and what they import from this package or from their own folder, and so on."""
    reached: set[Path] = set()
    waiting = [path.resolve() for path in files]
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting.extend(_source(path).imported)
    return reached


def foreign_imports(path: Path) -> tuple[str, ...]:
    """The libraries that a source file imports: top-level names that are neither Python's nor near it."""
    return _source(path).libraries


def file_digest(path: Path) -> str:
    """sha256 of a file's bytes; read again only if the file changed."""
    return _digest(str(path), stamp(path))


def stamp(path: Path) -> tuple[int, ...]:
    """What changes with a file's content: times, size, and which file it is.

    The modification time alone can be set back; the time of the inode's change cannot.
    """
    status = os.stat(path)
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino


@dataclass(frozen=True)
class _Source:
    """What one reading of a source file tells: digest and imports belong to the same text."""

    digest: str
    imported: tuple[Path, ...]
    foreign: tuple[str, ...]
    """Top-level modules that belong to other distributions than slamcmp's own requirements."""
    libraries: tuple[str, ...]
    """All top-level modules that are neither the standard library's nor near it."""


def _source(path: Path) -> _Source:
    return _read(str(path), stamp(path))


@cache
def _read(path_text: str, _stamp: tuple[int, ...]) -> _Source:
    path = Path(path_text)
    text = path.read_bytes()
    found: set[Path] = set()
    foreign: set[str] = set()
    libraries: set[str] = set()
    for module in _module_names(_parsed(text), path):
        parts = module.split(".")
        root = PACKAGE.parent if parts[0] == PACKAGE.name else path.parent
        stems = [root.joinpath(*parts[:length]) for length in range(1, len(parts) + 1)]
        ours = [file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py")]
        ours = [file for file in ours if file.is_file()]
        found.update(ours)
        if not ours and not (stems[0].is_dir() or parts[0] in sys.stdlib_module_names):
            libraries.add(parts[0])
        if not ours and not (stems[0].is_dir() or parts[0] in sys.stdlib_module_names | REQUIRED):
            foreign.add(parts[0])
    imported = tuple(sorted(file.resolve() for file in found))
    digest = hashlib.sha256(text).hexdigest()
    return _Source(digest, imported, tuple(sorted(foreign)), tuple(sorted(libraries)))


def _version(module: str) -> str:
    """Of the distribution that brings a top-level module; ``absent`` without it."""
    try:
        return importlib.metadata.version(module)
    except importlib.metadata.PackageNotFoundError:
        owners = importlib.metadata.packages_distributions().get(module)
    if owners:
        return ", ".join(f"{owner} {importlib.metadata.version(owner)}" for owner in sorted(set(owners)))
    return "absent" if importlib.util.find_spec(module) is None else "without a version"


def _parsed(text: bytes) -> ast.AST:
    try:
        return ast.parse(text)
    except (SyntaxError, ValueError, RecursionError):
        # Whoever imports it is told; it imports nothing.
        return ast.Module([], [])


def _module_names(tree: ast.AST, path: Path) -> Iterator[str]:
    """Every dotted name that might be a module: of ``from a import b`` both a and a.b."""
    for node in _run_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level and path.is_relative_to(PACKAGE):
                package = path.relative_to(PACKAGE.parent).with_suffix("").parts[: -node.level]
                base = ".".join([*package, base]).rstrip(".")
            yield from (f"{base}.{alias.name}".lstrip(".") for alias in node.names if alias.name != "*")
            if base:
                yield base


def _run_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below ``if TYPE_CHECKING:``, which are never run."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            waiting.extend(node.orelse)
        else:
            waiting.extend(ast.iter_child_nodes(node))


@cache
def _digest(path: str, _stamp: tuple[int, ...]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
