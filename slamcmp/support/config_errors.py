"""Collect every mistake of a configuration, each with its place and what would be right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from slamcmp.errors import UsageError
from slamcmp.registry import did_you_mean

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from slamcmp.support.yaml_source import KeyPath, YamlSource


class ConfigError(UsageError):
    """A configuration cannot be used; one line a mistake, each ``file:line:column: what``."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


class ConfigErrors:
    """The mistakes found so far in one file."""

    def __init__(self, source: YamlSource) -> None:
        self._source = source
        self._found: dict[tuple[int, int], list[str]] = {}

    def add(self, path: Sequence[str | int], what: str, *, key: bool = False) -> None:
        """Note a mistake at the value (``key=True``: at the key) that ``path`` leads to."""
        messages = self._found.setdefault(self._source.position(path, key=key), [])
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
            raise ConfigError(
                [
                    f"{self._source.name}:{line}:{column}: {' or: '.join(messages)}"
                    for (line, column), messages in sorted(self._found.items())
                ]
            )


def _wrong_value(path: KeyPath, error: ErrorDetails) -> str:
    name = next((str(step) for step in reversed(path) if isinstance(step, str)), "value")
    given: Any = error.get("input")
    text = f"{name}: {error['msg'][:1].lower()}{error['msg'][1:]}"
    if error["type"] == "literal_error" and isinstance(given, str):
        expected = str(error.get("ctx", {}).get("expected", ""))
        options = [option for option in expected.replace(" or ", ", ").split(", ") if option]
        return f"{name}: {given!r} is not allowed{did_you_mean(given, [o.strip(chr(39)) for o in options])}"
    return f"{text}, not {given!r}"
