"""Collect every mistake of a configuration, each with its place and what would be right."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from slamcmp.errors import UsageError
from slamcmp.registry import did_you_mean
from slamcmp.support.messages import LIMIT, told

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from slamcmp.support.configuration.yaml_source import KeyPath


LINE_BYTES = 600
"""Of one mistake."""


class ConfigSource(Protocol):
    """A configuration that knows where everything in it stands: a YAML file, or a mapping in a program."""

    data: dict[str, Any]

    def existing(self, path: Sequence[str | int]) -> KeyPath:
        """``path`` without the steps that lead nowhere."""

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, ...]:
        """Sorts mistakes in the order of the source."""

    def where(self, path: Sequence[str | int], *, key: bool = False) -> str:
        """The place of the value (of its key with ``key=True``) as a reader finds it."""


class ConfigError(UsageError):
    """A configuration cannot be used; one line a mistake, each with its place: ``file:line:column: what``."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


class ConfigErrors:
    """The mistakes found so far in one configuration."""

    def __init__(self, source: ConfigSource) -> None:
        self._source = source
        self._found: dict[tuple[tuple[int, ...], str], list[str]] = {}

    def add(self, path: Sequence[str | int], what: str, *, key: bool = False) -> None:
        """Note a mistake at the value (``key=True``: at the key) that ``path`` leads to."""
        place = self._source.position(path, key=key), self._source.where(path, key=key)
        messages = self._found.setdefault(place, [])
        if what not in messages:
            messages.append(what)

    def add_pydantic(
        self, errors: Iterable[ErrorDetails], prefix: KeyPath, known: dict[KeyPath, Iterable[str]]
    ) -> None:
        """Note what pydantic found below ``prefix``; ``known`` gives the valid keys of each mapping."""
        located = [(self._source.existing((*prefix, *error["loc"])), error) for error in errors]
        for path, error in located:
            # Of a union's members, the one that got furthest tells what is wrong.
            deeper = any(other[: len(path)] == path and len(other) > len(path) for other, _ in located)
            if deeper and len(prefix) + len(error["loc"]) > len(path):
                continue
            parent, last = path[:-1], str(path[-1]) if path else ""
            if error["type"] == "extra_forbidden":
                names = known.get(parent, ())
                self.add(path, f"unknown key {last!r}{did_you_mean(last, names)}", key=True)
            elif error["type"] == "missing":
                self.add(parent, f"key {last!r} is missing")
            else:
                self.add(path, _wrong_value(path, error))

    def raise_if_any(self) -> None:
        """Raise :class:`ConfigError` with every mistake, in the order of the file."""
        if self._found:
            texts = [(where, " or: ".join(found)) for (_, where), found in sorted(self._found.items())]
            lines = [f"{where}: {told(text, LINE_BYTES)}" for where, text in texts]
            if sum(map(_size, lines)) > LIMIT - 100:
                # Rather all places with shorter texts than some of them with long ones.
                share = (LIMIT - 100) // len(lines)
                lines = [f"{where}: {told(text, max(100, share - _size(where)))}" for where, text in texts]
            shown = list(itertools.takewhile(_Room(LIMIT - 100).takes, lines)) or [told(lines[0])]
            more = len(lines) - len(shown)
            raise ConfigError([*shown, f"… and {more} more mistakes"] if more else shown)


class _Room:
    """So many bytes, filled line by line."""

    def __init__(self, size: int) -> None:
        self._left = size

    def takes(self, line: str) -> bool:
        self._left -= _size(line)
        return self._left >= 0


def _size(line: str) -> int:
    return len(line.encode(errors="backslashreplace")) + 3


def _wrong_value(path: KeyPath, error: ErrorDetails) -> str:
    name = next((str(step) for step in reversed(path) if isinstance(step, str)), "value")
    given: Any = error.get("input")
    text = f"{name}: {error['msg'][:1].lower()}{error['msg'][1:]}"
    if error["type"] == "literal_error" and isinstance(given, str):
        expected = str(error.get("ctx", {}).get("expected", ""))
        options = [option for option in expected.replace(" or ", ", ").split(", ") if option]
        hint = did_you_mean(given, [option.strip(chr(39)) for option in options])
        return f"{name}: {_shown(given)} is not allowed{hint}"
    return f"{text}, not {_shown(given)}"


def _shown(given: Any) -> str:
    """What was given, as far as it fits into a line."""
    try:
        text = repr(given)
    except (ValueError, RecursionError):
        # An integer of more digits than Python writes out.
        text = f"a {type(given).__name__} that is too large to be shown"
    return told(text, LINE_BYTES // 3)
