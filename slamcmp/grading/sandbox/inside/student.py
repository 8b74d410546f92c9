"""Inside the worker: load the submission, call it, and describe what it raised."""

from __future__ import annotations

import ast
import linecache
import os
import sys
import traceback
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from slamcmp.grading.sandbox.inside.definitions import definitions

MODULE_NAME = "submission"
_MESSAGE_MAX, _FRAMES_MAX, _CODE_MAX = 2000, 12, 200


def load(folder: str, entry: str, *, definitions_only: bool, wanted: Sequence[str] = ()) -> ModuleType:
    """Import ``folder/entry``; its neighbours can be imported by it.

    With ``definitions_only``, run what definitions.py chooses of it for the functions that are wanted: a
    notebook's exploration is not executed.

    Raises:
        BaseException: whatever the submission raises.
    """
    path = os.path.join(folder, entry)
    sys.path.insert(0, os.path.dirname(path))
    with open(path, encoding="utf-8-sig") as file:
        source = file.read()
    linecache.cache[path] = (len(source), None, source.splitlines(keepends=True), path)
    tree = ast.parse(source, filename=path)
    if definitions_only:
        tree.body, _ = definitions(tree.body, wanted)
    name = os.path.splitext(os.path.basename(entry))[0]
    if name in sys.modules or name in sys.stdlib_module_names or not name.isidentifier():
        name = MODULE_NAME
    module = ModuleType(name)
    module.__file__ = path
    sys.modules[name] = module
    exec(compile(tree, path, "exec"), module.__dict__)
    return module


def public_names(module: ModuleType) -> list[str]:
    """Functions and classes that the submission itself defines."""
    names = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and callable(value)
        and getattr(value, "__module__", "") == module.__name__
    ]
    return sorted(names)[:1000]


def describe(error: BaseException, folder: str) -> dict[str, Any]:
    """Type, message and the submission's own lines, ready for the protocol; never raises."""
    frames: list[list[Any]] = []
    try:
        if isinstance(error, SyntaxError) and _inside(error.filename, folder):
            name = os.path.relpath(str(error.filename), folder)
            frames.append(
                [name, int(error.lineno or 0), "<module>", str(error.text or "").strip()[:_CODE_MAX]]
            )
            message = str(error.msg)
        else:
            message = str(error)
        for entry in traceback.extract_tb(error.__traceback__):
            if _inside(entry.filename, folder):
                name = os.path.relpath(entry.filename, folder)
                frames.append([name, int(entry.lineno or 0), entry.name, (entry.line or "")[:_CODE_MAX]])
    except BaseException as second:
        message = f"(the message itself raised {type(second).__name__})"
    # The ends of a deep recursion tell more than its middle.
    if len(frames) > _FRAMES_MAX:
        frames = frames[: _FRAMES_MAX // 2] + frames[-_FRAMES_MAX // 2 :]
    return {"type": type(error).__name__[:200], "message": message[:_MESSAGE_MAX], "frames": frames}


def _inside(filename: str | None, folder: str) -> bool:
    return filename is not None and str(filename).startswith(folder + os.sep)
