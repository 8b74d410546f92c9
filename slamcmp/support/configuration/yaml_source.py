"""A YAML file as plain data that remembers where each key and value stands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.support.configuration.bounds import TOO_DEEP, TooLargeError, require_bounded
from slamcmp.support.messages import told

KeyPath = tuple[str | int, ...]
BYTES_MAX = 10_000_000


class YamlSource:
    """The data of one YAML file with the line and column of everything in it."""

    def __init__(self, name: str, text: str) -> None:
        """Parse ``text``; ``name`` stands for the file in messages.

        Raises:
            UsageError: not YAML, a key stands twice, or the top level is not a mapping.
        """
        self.name = name
        try:
            root = YAML(typ="rt").load(text)
            require_bounded(root)
        except (RecursionError, TooLargeError) as error:
            what = str(error) if isinstance(error, TooLargeError) else TOO_DEEP
            raise UsageError(f"{name}: {what}") from None
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            where = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
            what = (error.problem or error.context or "cannot be read").replace("\n", " ")
            raise UsageError(f"{where}: not valid YAML: {what}") from error
        except YAMLError as error:
            raise UsageError(told(f"{name}: not valid YAML: {' '.join(str(error).split())}")) from error
        except Exception as error:
            # A number of 5000 digits, the 99th of a month, a key that is a list: Python's own complaint.
            raise UsageError(told(f"{name}: not valid YAML: {' '.join(str(error).split())}")) from error
        if not isinstance(root, CommentedMap):
            raise UsageError(f"{name}:1:1: an experiment is a mapping (key: value), not {_kind(root)}")
        self._root = root
        self.data: dict[str, Any] = _plain(root)

    def where(self, path: Sequence[str | int], *, key: bool = False) -> str:
        """``file:line:column`` of the value at ``path`` (of its key with ``key=True``)."""
        line, column = self.position(path, key=key)
        return f"{self.name}:{line}:{column}"

    def existing(self, path: Sequence[str | int]) -> KeyPath:
        """``path`` without the steps that lead nowhere (pydantic's names of a union's members)."""
        node: Any = self._root
        kept: list[str | int] = []
        for depth, step in enumerate(path):
            inside = isinstance(node, CommentedMap) and step in node
            inside = inside or (isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node))
            if inside:
                node = node[step]
                kept.append(step)
            elif isinstance(node, CommentedMap) and depth == len(path) - 1:
                kept.append(step)
        return tuple(kept)

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, int]:
        """Line and column, both from 1."""
        node: Any = self._root
        line, column = 0, 0
        for depth, step in enumerate(path):
            last = depth == len(path) - 1
            if isinstance(node, CommentedMap):
                # Keys that are numbers or lists are known by their text.
                written = next((each for each in node if each == step or str(each) == step), None)
                if written is None:
                    break
                if written in node.lc.data:
                    line, column = node.lc.key(written) if key and last else node.lc.value(written)
                node = node[written]
            elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
                line, column = node.lc.item(step)
                node = node[step]
            else:
                break
        return line + 1, column + 1


def load_yaml(path: Path) -> YamlSource:
    """Read one YAML file.

    Raises:
        MissingDataError: there is no such file.
        UsageError: it is not UTF-8 text or not valid YAML.
    """
    try:
        if path.stat().st_size > BYTES_MAX:
            raise UsageError(f"{path}: {path.stat().st_size} bytes are no experiment: at most {BYTES_MAX}")
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        if isinstance(error, UnicodeDecodeError):
            raise UsageError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from error
        raise MissingDataError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    return YamlSource(str(path), text)


def _plain(node: Any) -> Any:
    """Without ruamel's own types, which carry formatting and comments."""
    if isinstance(node, dict):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node]
    if node is None or isinstance(node, bool):
        return node
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    # ruamel keeps booleans with an anchor as a subclass of int with this name.
    return bool(node) if type(node).__name__ == "ScalarBoolean" else str(node)


def _kind(value: Any) -> str:
    return "empty" if value is None else "a list" if isinstance(value, list) else f"{value!r}"
