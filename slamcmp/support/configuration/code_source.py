"""What a program hands over in place of a YAML file, with the way to everything in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from slamcmp.errors import UsageError
from slamcmp.support.configuration.bounds import TOO_DEEP, TooLargeError, require_bounded
from slamcmp.support.configuration.yaml_source import KeyPath


class CodeSource:
    """Nested mappings and sequences; a place in them is written as the expression that leads there."""

    def __init__(self, name: str, data: Mapping[Any, Any]) -> None:
        """``name`` stands for the outermost mapping in messages."""
        self.name = name
        try:
            require_bounded(data)
        except (RecursionError, TooLargeError) as error:
            what = str(error) if isinstance(error, TooLargeError) else TOO_DEEP
            raise UsageError(f"{name}: {what}") from None
        self.data: dict[str, Any] = plain_data(data)

    def existing(self, path: Sequence[str | int]) -> KeyPath:
        """``path`` without the steps that lead nowhere (pydantic's names of a union's members)."""
        node: Any = self.data
        kept: list[str | int] = []
        for depth, step in enumerate(path):
            if _leads_on(node, step):
                node = node[step]
                kept.append(step)
            elif isinstance(node, dict) and depth == len(path) - 1:
                kept.append(step)
        return tuple(kept)

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, ...]:  # noqa: ARG002
        """Which member of which member: mistakes are told in the order in which they were written."""
        node: Any = self.data
        found: list[int] = []
        for step in path:
            if not _leads_on(node, step):
                break
            found.append(list(node).index(step) if isinstance(node, dict) else int(step))
            node = node[step]
        return tuple(found)

    def where(self, path: Sequence[str | int], *, key: bool = False) -> str:  # noqa: ARG002
        """``experiment['back_ends'][0]['name']``, as far as the path leads somewhere."""
        node: Any = self.data
        text = self.name
        for step in path:
            if not _leads_on(node, step):
                break
            text += f"[{step!r}]"
            node = node[step]
        return text


def plain_data(value: Any) -> Any:
    """The same in the types that a YAML file gives: arrays and ranges as lists, numpy's numbers as ours."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(each) for key, each in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain_data(each) for each in value]
    if isinstance(value, PurePath):
        return str(value)
    # numpy's scalars and arrays, without importing numpy for those who have none.
    return value.tolist() if hasattr(value, "tolist") else value


def _leads_on(node: Any, step: str | int) -> bool:
    if isinstance(node, dict):
        return step in node
    return isinstance(node, list) and isinstance(step, int) and step < len(node)
