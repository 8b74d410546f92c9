"""The examples in docstrings are run."""

from __future__ import annotations

import doctest
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

import slamcmp
from tests.api.conftest import WORLD

MODULES = ["slamcmp", *(name for name in slamcmp._HOMES if name.startswith("slamcmp.api."))]


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name: str, here: Path) -> None:
    done = doctest.testmod(
        importlib.import_module(name),
        optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE,
    )
    assert done.attempted > 0
    assert done.failed == 0


def test_the_readmes_lines_run(here: Path) -> None:
    """On a small world in place of the shipped experiment; ``check`` has tests of its own."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    (own,) = (block for block in blocks if "class MyEkf" in block)
    (lines,) = (block for block in blocks if "slamcmp.run(" in block)
    small = repr({"source": WORLD, "back_ends": ["ekf_slam", "isam2"], "seeds": 2})
    lines, shipped = re.subn(r'"quickstart"', small, lines)
    lines, world = re.subn(r'{"name": "circle"}', repr(WORLD), lines)
    lines, checks = re.subn(r"^slamcmp\.check\(MyEkf\)\n", "", lines, flags=re.MULTILINE)
    assert (shipped, world, checks) == (1, 1, 1)
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(own + lines, names)
    assert names["run"].status == "ok", names["run"].message
