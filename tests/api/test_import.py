"""``import slamcmp`` loads nothing heavy, and type checkers see the names it finds later."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys

import pytest

import slamcmp

HEAVY = (
    "numpy",
    "pandas",
    "gtsam",
    "cv2",
    "scipy",
    "matplotlib",
    "pydantic",
    "pyarrow",
    "rich",
    "ruamel",
    "typer",
)


def loaded_after(code: str) -> set[str]:
    told = "; import sys; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code + told], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("code", ["import slamcmp", "import slamcmp; dir(slamcmp); slamcmp.__version__"])
def test_importing_loads_no_heavy_module(code: str) -> None:
    assert not loaded_after(code) & set(HEAVY)


def test_types_load_no_more_than_numpy() -> None:
    assert loaded_after("import slamcmp; slamcmp.Estimate") & set(HEAVY) == {"numpy"}


def test_every_name_is_found_where_it_is_said_to_be() -> None:
    for name in slamcmp.__all__:
        assert getattr(slamcmp, name) is not None
        assert name in dir(slamcmp)
    assert set(slamcmp._HOME) == set(slamcmp.__all__)


def test_type_checkers_see_the_same_names_from_the_same_modules() -> None:
    tree = ast.parse(inspect.getsource(slamcmp))
    checks = (node for node in tree.body if isinstance(node, ast.If))
    (block,) = (node for node in checks if ast.unparse(node.test) == "TYPE_CHECKING")
    seen = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == slamcmp._HOME


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'rnu'"):
        slamcmp.rnu  # noqa: B018
