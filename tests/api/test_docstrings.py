"""The examples in docstrings are run."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import slamcmp

MODULES = ["slamcmp", *(name for name in slamcmp._HOMES if name.startswith("slamcmp.api."))]


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name: str, here: Path) -> None:
    done = doctest.testmod(
        importlib.import_module(name),
        optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE,
    )
    assert done.attempted > 0
    assert done.failed == 0
