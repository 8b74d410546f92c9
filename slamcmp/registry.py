"""One mechanism for every kind of plug-in: a file in the right package and one decorator.

``@back_ends.register("my_ekf")`` above a class is all that is needed; the modules of a registry's packages
are imported the first time somebody asks for a name, so nothing else has to be edited and ``--help`` stays
fast.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import inspect
import pkgutil
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from slamcmp.errors import UsageError
from slamcmp.loaded_code import USER, load_user_file

Target = TypeVar("Target", bound=Callable[..., Any])


@dataclass(frozen=True)
class Plugin:
    """A registered class or function with what the registry knows about it."""

    name: str
    target: Callable[..., Any]
    traits: Mapping[str, Any] = field(default_factory=dict)

    @property
    def summary(self) -> str:
        """The first sentence of the target's docstring."""
        text = inspect.getdoc(self.target) or ""
        return text.split("\n\n", 1)[0].replace("\n", " ")

    def parameters(self) -> dict[str, inspect.Parameter]:
        """The keyword-only parameters a configuration may set, with resolved annotations."""
        return keyword_only(self.target)


class Registry:
    """The plug-ins of one kind, found by importing every module of the packages that hold them."""

    def __init__(self, kind: str, *packages: str) -> None:
        self.kind = kind
        self._packages = packages
        self._plugins: dict[str, Plugin] = {}
        self._of_users: dict[int, Plugin] = {}
        """What users' files register, by the identity of the target: they are found by their file."""
        self._loaded = False

    def register(self, name: str, **traits: Any) -> Callable[[Target], Target]:
        """Decorator that adds a class or function under ``name``; parameters are its keyword-only ones."""

        def add(target: Target) -> Target:
            if getattr(target, "__module__", "").startswith(USER):
                self._of_users[id(target)] = Plugin(name, target, traits)
                return target
            known = self._plugins.get(name)
            if known is not None and (known.target.__module__ != target.__module__):
                raise ValueError(
                    f"{self.kind} {name!r} is registered twice: in {known.target.__module__} "
                    f"and in {target.__module__}"
                )
            self._plugins[name] = Plugin(name, target, traits)
            return target

        return add

    def __iter__(self) -> Iterator[Plugin]:
        self._load()
        return iter(sorted(self._plugins.values(), key=lambda plugin: plugin.name))

    def names(self) -> list[str]:
        """Every registered name, sorted."""
        return [plugin.name for plugin in self]

    def __contains__(self, name: str) -> bool:
        self._load()
        return name in self._plugins

    def get(self, name: str) -> Plugin:
        """The plug-in called ``name``, or the one in a user's file (``path/file.py:Name``).

        Raises:
            UsageError: no such plug-in; the message lists near matches and all names.
        """
        if ".py:" in name:
            return load_user_plugin(name, self)
        if name in _in_session:
            return _in_session[name]
        self._load()
        if name in GONE.get(self.kind, {}):
            raise UsageError(f"{self.kind} {name!r} is gone: {GONE[self.kind][name]}")
        if name not in self._plugins:
            raise UsageError(f"unknown {self.kind} {name!r}{did_you_mean(name, self._plugins)}")
        return self._plugins[name]

    def traits_of(self, target: Callable[..., Any]) -> Mapping[str, Any]:
        """What a user's file registered its class or function with, whatever was put around it."""
        seen: Any = target
        while seen is not None:
            if id(seen) in self._of_users:
                return self._of_users[id(seen)].traits
            seen = seen.func if isinstance(seen, functools.partial) else getattr(seen, "__wrapped__", None)
        return {}

    def _load(self) -> None:
        if self._loaded:
            return
        for package_name in self._packages:
            package = importlib.import_module(package_name)
            for module in pkgutil.iter_modules(package.__path__, package_name + "."):
                importlib.import_module(module.name)
        # Not before: after an import that failed, the next call says so again instead of knowing half.
        self._loaded = True


GONE: Mapping[str, Mapping[str, str]] = {
    "back end": {
        "ekf_compiled": "ekf_slam gives its numbers, compiled where numba is installed (pip install "
        "'slamcmp[fast]'); name ekf_slam instead"
    },
}
"""By kind and name: plug-ins of older versions, and what to name instead."""


def keyword_only(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The keyword-only parameters of a class or function, with resolved annotations."""
    return {
        name: parameter
        for name, parameter in inspect.signature(target, eval_str=True).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }


SESSION = "session"
"""The trait of a plug-in that only this process has, a class from a notebook's cell for instance."""
_in_session: dict[str, Plugin] = {}


@contextlib.contextmanager
def in_session(plugins: Mapping[str, Plugin]) -> Iterator[None]:
    """Let every registry find these by their keys, in this process and for as long as the context lasts."""
    _in_session.update(plugins)
    try:
        yield
    finally:
        for key in plugins:
            _in_session.pop(key, None)


def did_you_mean(name: str, known: Any) -> str:
    """``; did you mean 'x'? known: a, b, c``, ready to be appended to an error message."""
    names = sorted(known)
    hint = near_miss(name, names)
    return f"{hint} Known: {', '.join(names)}" if hint else f"; known: {', '.join(names)}"


def near_miss(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?``, or nothing where no name is near."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def load_user_plugin(spec: str, registry: Registry) -> Plugin:
    """Import ``path/file.py:Name`` from the user's own file, with the traits that it registers, if it does.

    A file that has changed is imported anew, as a notebook's reader expects, and so are the neighbours that
    it imports.

    Raises:
        UsageError: no such file, the file does not import, or it has no such name.
    """
    kind = registry.kind
    path_text, _, attribute = spec.rpartition(":")
    try:
        path = Path(path_text).expanduser().resolve()
        is_file = path.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        raise UsageError(f"{kind} {spec!r}: {error}") from error
    if not is_file:
        raise UsageError(f"{kind} {spec!r}: there is no file {path}")
    try:
        module = load_user_file(path)
    except (Exception, SystemExit) as error:
        raise UsageError(f"{kind} {spec!r}: {path} does not import: {_told(error, path)}") from error
    target = getattr(module, attribute, None)
    if not callable(target):
        classes = [name for name, value in vars(module).items() if inspect.isclass(value)]
        raise UsageError(f"{kind} {spec!r}: {path} has no {attribute!r}{did_you_mean(attribute, classes)}")
    traits = {**registry.traits_of(target), "user_file": path}
    # A file's name need not be valid Unicode; what tables show of it has to be.
    shown = path.name.encode("utf-8", "backslashreplace").decode()
    return Plugin(f"{shown}:{attribute}", target, traits)


def _told(error: BaseException, path: Path) -> str:
    """``KeyError: 'x' (mine.py, line 3)``; a syntax error names its place itself."""
    text = f"{type(error).__name__}: {error}".removesuffix(": ")
    lines = [
        entry.lineno for entry in traceback.extract_tb(error.__traceback__) if entry.filename == str(path)
    ]
    return text if isinstance(error, SyntaxError) or not lines else f"{text} ({path.name}, line {lines[-1]})"


sources = Registry(
    "source",
    "slamcmp.worlds",
    "slamcmp.datasets",
    "slamcmp.datasets.graphs",
    "slamcmp.datasets.images",
    "slamcmp.datasets.plain",
)
data_sets = Registry("data set", "slamcmp.datasets.catalogue")
front_ends = Registry("front end", "slamcmp.frontend")
back_ends = Registry(
    "back end",
    "slamcmp.backends",
    "slamcmp.backends.filters",
    "slamcmp.backends.window",
    "slamcmp.backends.gtsam_smoothers",
)
sensors = Registry("sensor", "slamcmp.models")
metrics = Registry("metric", "slamcmp.metrics")
executors = Registry("executor", "slamcmp.experiment.executors")
figures = Registry(
    "figure",
    "slamcmp.report.figures",
    "slamcmp.report.figures.frontend",
    "slamcmp.report.figures.runs",
    "slamcmp.report.figures.sweeps",
)
test_kinds = Registry("kind of test", "slamcmp.grading.kinds")
