"""Modules that import and do nothing: many submissions import a plotting library that is not needed here."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any


class _Nothing:
    """Answers every use with itself, so that code which draws runs through and draws nothing."""

    def __call__(self, *_: Any, **__: Any) -> _Nothing:
        return self

    def __getattr__(self, name: str) -> _Nothing:
        # Protocols that numpy and the import system look for must seem absent.
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __getitem__(self, _: Any) -> _Nothing:
        return self

    def __setitem__(self, *_: Any) -> None:
        return

    def __iter__(self) -> Iterator[_Nothing]:
        # As in ``figure, axes = plt.subplots()``.
        return iter((self, self))

    def __enter__(self) -> _Nothing:
        return self

    def __exit__(self, *_: object) -> None:
        return


_NOTHING = _Nothing()


class _InertModule(ModuleType):
    def __getattr__(self, name: str) -> _Nothing:
        if name.startswith("__"):
            raise AttributeError(name)
        return _NOTHING


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, name: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if name.partition(".")[0] not in self._names:
            return None
        return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return _InertModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:  # noqa: ARG002
        return


def make_inert(names: Sequence[str]) -> None:
    """From now on, these packages and all below them import as modules that do nothing."""
    sys.meta_path.insert(0, _Finder(names))
