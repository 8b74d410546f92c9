"""What a configuration may hold at most: whatever lies beyond is a mistake or an attack, never a question."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

DEPTH_MAX = 40
NODES_MAX = 200_000
INTEGER_MAX = 2**63 - 1
TOO_DEEP = f"nested too deeply; {DEPTH_MAX} levels are allowed"
KeyPath = tuple[str | int, ...]


class TooLargeError(Exception):
    """More than can be meant; the message says what."""


def require_bounded(data: Any) -> None:
    """Refuse what is nested too deeply, or grows too large when every alias is written out.

    Raises:
        TooLargeError: it does.
    """
    sizes: dict[int, int] = {}

    def size(node: Any, depth: int) -> int:
        if depth > DEPTH_MAX:
            raise TooLargeError(TOO_DEEP)
        if not isinstance(node, Mapping | list | tuple):
            return 1
        # Shared parts are counted once and added as often as they stand there.
        known = sizes.get(id(node))
        if known is None:
            parts = node.values() if isinstance(node, Mapping) else node
            known = 1 + sum(size(part, depth + 1) for part in parts)
            sizes[id(node)] = known
        if known > NODES_MAX:
            raise TooLargeError(f"more than {NODES_MAX} values, with every alias written out")
        return known

    size(data, 1)


def unusable_values(data: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, str]]:
    """Where a number is beyond 64 bits or a text is no Unicode, and what is wrong with it."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            if not _is_text(str(key)):
                yield (*path, key), "a key that is not valid Unicode text"
            yield from unusable_values(value, (*path, key))
    elif isinstance(data, list | tuple):
        for index, value in enumerate(data):
            yield from unusable_values(value, (*path, index))
    elif isinstance(data, int) and not isinstance(data, bool) and abs(data) > INTEGER_MAX:
        yield path, f"an integer beyond 64 bits; at most {INTEGER_MAX}"
    elif isinstance(data, str) and not _is_text(data):
        yield path, "a text that is not valid Unicode"


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text
