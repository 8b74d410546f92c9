"""Which text of each module this process runs: read, hashed and executed from the same bytes.

A file may change after it was imported, and even a file that is imported again may run from an older
``.pyc``, which Python takes for current where size and second of the last change agree. Results are named by
the code that made them, so a worker must be able to say what it really loaded.

A user's file belongs to a package of its folder with a name of its own: what it imports from beside it is
its own neighbour, whatever a file of the same name in another user's folder holds, and a file that has
changed is loaded anew with all that stands beside it.
"""

from __future__ import annotations

import builtins
import hashlib
import importlib
import importlib.util
import os
import site
import sys
import sysconfig
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from importlib.machinery import (
    EXTENSION_SUFFIXES,
    ExtensionFileLoader,
    ModuleSpec,
    PathFinder,
    SourceFileLoader,
)
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

PACKAGE = "slamcmp"
USER = "slamcmp_user_"
"""Start of the names of the packages that users' folders become."""
_digests: dict[str, str] = {}
_folders: dict[Path, str] = {}
"""The current package of each user's folder."""
_libraries: dict[Path, set[str]] = {}
"""What the files of each user's folder imported that is neither Python's nor beside them, by any way."""
_lock = threading.RLock()
around_library_imports: Callable[[], AbstractContextManager[None]] = nullcontext
"""Entered around what a user's module imports and does not lie beside it."""


def loaded_digests() -> Mapping[str, str]:
    """sha256 of the text that each module was last loaded from, by absolute path; libraries are left out."""
    return dict(_digests)


def record_loads() -> None:
    """From now on note what is imported, but for the modules of installed libraries."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        # Behind the finders of others: test runners and editable installs have theirs in front.
        at = sys.meta_path.index(PathFinder) if PathFinder in sys.meta_path else len(sys.meta_path)
        sys.meta_path.insert(at, _Finder())
        for name in (PACKAGE, __name__):
            file = str(sys.modules[name].__file__)
            _note(file, Path(file).read_bytes())


def load_user_file(path: Path) -> ModuleType:
    """The module of a user's file, loaded anew if it or anything that was loaded beside it has changed.

    Raises:
        BaseException: whatever the file raises.
    """
    path = path.resolve()
    with _lock:
        _let_search(path.parent)
        package = _package_of(path.parent)
        name = f"{package}.{path.stem.replace('.', '_')}"
        if name not in sys.modules:
            loader = _Loader(name, str(path))
            spec = importlib.util.spec_from_file_location(name, path, loader=loader)
            assert spec is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
            try:
                loader.exec_module(module)
            except BaseException:
                sys.modules.pop(name, None)
                raise
        return sys.modules[name]


def imported_libraries(folder: Path) -> frozenset[str]:
    """The libraries that a user's files in this folder have imported in this process, by any way."""
    return frozenset(_libraries.get(folder.resolve(), ()))


def _let_search(folder: Path) -> None:
    """Let what imports by another way than a statement find neighbours, as from a script's folder."""
    others = {str(each) for each in (*_folders, folder)}
    first = next((index for index, each in enumerate(sys.path) if each in others), len(sys.path))
    if sys.path[first : first + 1] != [str(folder)]:
        # Before the folders of other users' files, whose neighbours may have the same names.
        if str(folder) in sys.path:
            sys.path.remove(str(folder))
        sys.path.insert(first, str(folder))
    if importlib.import_module is not _import_module:
        importlib.import_module = _import_module


def _import_module(name: str, package: str | None = None) -> ModuleType:
    """``importlib.import_module``; a user's module that calls it gets its own neighbour."""
    caller = _user_package(str(sys._getframe(1).f_globals.get("__name__", "")))
    if caller is not None and not name.startswith("."):
        module: ModuleType = _importer(caller)(name, fromlist=("__name__",))
        return module
    return _python_import_module(name, package)


_python_import_module = importlib.import_module


def is_library(path: Path) -> bool:
    """Whether the file came with Python or with an installed package."""
    return any(path.is_relative_to(folder) for folder in _library_folders())


@cache
def _library_folders() -> tuple[Path, ...]:
    paths = sysconfig.get_paths()
    folders = {paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    folders |= {*site.getsitepackages(), site.getusersitepackages()}
    return tuple({form for folder in folders for form in (Path(folder), Path(folder).resolve())})


def _package_of(folder: Path) -> str:
    """The package that the folder is at present: a new one where a file of the last has changed."""
    known = _folders.get(folder)
    if known is not None and _is_current(known):
        return known
    generation = 0 if known is None else int(known.rpartition("_")[2]) + 1
    name = (
        f"{USER}{hashlib.sha256(str(folder).encode(errors='surrogateescape')).hexdigest()[:12]}_{generation}"
    )
    package = ModuleType(name, f"The folder {folder}.")
    package.__path__ = [str(folder)]
    sys.modules[name] = package
    _folders[folder] = name
    return name


def _is_current(package: str) -> bool:
    files = [
        str(module.__file__)
        for name, module in list(sys.modules.items())
        if name.startswith(f"{package}.") and getattr(module, "__file__", None) is not None
    ]
    try:
        return all(_digest(Path(file).read_bytes()) == _digests.get(os.path.realpath(file)) for file in files)
    except OSError:
        return False


def _note(file: str, text: bytes) -> None:
    _digests[os.path.realpath(file)] = _digest(text)


def _digest(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()


class _Loader(SourceFileLoader):
    """Executes exactly the bytes whose hash it notes."""

    def get_code(self, fullname: str) -> CodeType | None:  # noqa: ARG002
        text = self.get_data(self.path)
        code: CodeType = self.source_to_code(text, self.path)
        _note(self.path, text)
        return code

    def exec_module(self, module: ModuleType) -> None:
        folder = _user_package(module.__name__)
        if folder is not None:
            imports = _importer(folder)
            module.__dict__["__builtins__"] = {**vars(builtins), "__import__": imports}
        super().exec_module(module)


class _PackageLoader(_Loader):
    """The same for our own modules, whose compiled form is used where it can only be that of the text."""

    def get_code(self, fullname: str) -> CodeType | None:
        for _ in range(3):
            text = self.get_data(self.path)
            if not self._is_safely_compiled():
                return super().get_code(fullname)
            code = SourceFileLoader.get_code(self, fullname)
            if self.get_data(self.path) == text:
                _note(self.path, text)
                return code
        return super().get_code(fullname)

    def _is_safely_compiled(self) -> bool:
        """Whether the compiled file is younger than the second in which the text changed."""
        try:
            compiled = Path(importlib.util.cache_from_source(self.path)).stat().st_mtime
            return compiled >= int(Path(self.path).stat().st_mtime) + 1
        except (OSError, NotImplementedError):
            return False


class _Finder:
    """Finds as Python does, and lets our loaders load what is no library's."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        if spec is None or spec.origin is None:
            return spec
        ours = name.partition(".")[0] == PACKAGE
        if not ours and is_library(Path(spec.origin)):
            return spec
        if type(spec.loader) is SourceFileLoader:
            spec.loader = (_PackageLoader if ours else _Loader)(name, spec.origin)
        elif type(spec.loader) is ExtensionFileLoader:
            _note(spec.origin, Path(spec.origin).read_bytes())
        return spec


def _user_package(name: str) -> str | None:
    top = name.partition(".")[0]
    return top if top.startswith(USER) else None


@cache
def _importer(package: str) -> Callable[..., ModuleType]:
    """``__import__`` for the modules of a user's folder: neighbours first, as a script finds them."""
    folder = Path(sys.modules[package].__path__[0])

    def imports(
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] = (),
        level: int = 0,
    ) -> ModuleType:
        if level:
            return builtins.__import__(name, globals, locals, fromlist, level)
        top = name.partition(".")[0]
        if not is_neighbour(top):
            if top not in sys.stdlib_module_names:
                _libraries.setdefault(folder, set()).add(top)
            with around_library_imports():
                return builtins.__import__(name, globals, locals, fromlist, level)
        whole = f"{package}.{name}"
        try:
            module = builtins.__import__(whole, globals, locals, fromlist or ("__name__",), 0)
        except ModuleNotFoundError as error:
            # The author knows it by its own name.
            told = str(error).replace(f"{package}.", "")
            raise ModuleNotFoundError(told, name=(error.name or "").removeprefix(f"{package}.")) from None
        return module if fromlist else sys.modules[f"{package}.{name.partition('.')[0]}"]

    def is_neighbour(top: str) -> bool:
        if top == PACKAGE or top in sys.stdlib_module_names:
            return False
        try:
            return stands_there(top, folder.stat().st_mtime_ns)
        except OSError:
            return False

    @cache
    def stands_there(top: str, _modified: int) -> bool:
        if (folder / f"{top}.py").is_file() or (folder / top / "__init__.py").is_file():
            return True
        if any((folder / f"{top}{suffix}").is_file() for suffix in EXTENSION_SUFFIXES):
            return True
        # A folder without __init__.py is only a package where nothing else has its name.
        return (folder / top).is_dir() and PathFinder.find_spec(top) is None

    return imports
