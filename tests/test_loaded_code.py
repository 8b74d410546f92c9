"""What a process says it loaded is what it executes; users' folders do not get into each other's way."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from slamcmp.loaded_code import is_library, load_user_file, loaded_digests
from slamcmp.registry import back_ends, sources
from slamcmp.support.provenance.code_version import PACKAGE


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_each_loaded_module_of_ours_is_known_by_its_text() -> None:
    """In a fresh process: the registry's walk loads nearly all of them."""
    code = (
        "import json, slamcmp, sys\n"
        "from slamcmp.registry import back_ends\n"
        "back_ends.names()\n"
        "from slamcmp.loaded_code import loaded_digests\n"
        "files = [m.__file__ for n, m in sys.modules.items() if n.partition('.')[0] == 'slamcmp']\n"
        "print(json.dumps([files, dict(loaded_digests())]))\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    files, known = json.loads(told)
    assert len(files) > 30
    for file in files:
        assert known[os.path.realpath(file)] == digest(Path(file))
    assert not any(is_library(Path(file)) and PACKAGE not in Path(file).parents for file in known)


def test_change_of_equal_length_in_the_same_second_is_executed(tmp_path: Path) -> None:
    """Python's own check of a compiled file compares the second and the size of the text only."""
    path = tmp_path / "mine.py"
    for value in "123":
        path.write_text(f"VALUE = {value}\n")
        os.utime(path, (1_700_000_000, 1_700_000_000))
        assert int(value) == load_user_file(path).VALUE
        assert loaded_digests()[str(path)] == digest(path)


def test_neighbours_of_one_name_stay_apart_also_when_imported_late(tmp_path: Path) -> None:
    modules = []
    for name in ("a", "b"):
        folder = tmp_path / name
        (folder / "pack").mkdir(parents=True)
        (folder / "helper.py").write_text(f"NAME = {name!r}\n")
        (folder / "pack" / "__init__.py").write_text("from . import inner\n")
        (folder / "pack" / "inner.py").write_text("import helper\nNAME = helper.NAME + 'inner'\n")
        (folder / "late.py").write_text("from helper import NAME\n")
        (folder / "dynamic.py").write_text("from helper import NAME\n")
        (folder / "mine.py").write_text(
            "import helper, pack.inner\nfrom pack import inner as again\nimport pack.inner as third\n"
            "def late():\n    import late\n    from pack.inner import NAME as deep\n"
            "    return late.NAME + deep\n"
            "def dynamic():\n    import importlib\n    return importlib.import_module('dynamic').NAME\n"
        )
        modules.append(load_user_file(folder / "mine.py"))
    for name, module in zip("ab", modules, strict=True):
        assert name == module.helper.NAME
        assert module.pack.inner is module.again is module.third
        assert f"{name}inner" == module.pack.inner.NAME
    assert [module.late() for module in modules] == ["aainner", "bbinner"]
    assert [module.dynamic() for module in modules] == ["a", "b"]
    assert "helper" not in sys.modules
    assert loaded_digests()[str(tmp_path / "b" / "late.py")] == digest(tmp_path / "b" / "late.py")


def test_changed_neighbour_is_loaded_anew(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("VALUE = 1\n")
    (tmp_path / "mine.py").write_text("import helper\nVALUE = helper.VALUE\n")
    first = load_user_file(tmp_path / "mine.py")
    assert load_user_file(tmp_path / "mine.py") is first
    (tmp_path / "helper.py").write_text("VALUE = 2\n")
    assert load_user_file(tmp_path / "mine.py").VALUE == 2
    assert first.VALUE == 1


def test_neighbour_that_comes_later_is_found(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import comes_later\n")
    with pytest.raises(ModuleNotFoundError, match=r"^No module named 'comes_later'$"):
        load_user_file(tmp_path / "mine.py")
    (tmp_path / "comes_later.py").write_text("VALUE = 3\n")
    assert load_user_file(tmp_path / "mine.py").comes_later.VALUE == 3


def test_standard_library_and_this_package_are_not_shadowed(tmp_path: Path) -> None:
    for name in ("json", "slamcmp"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('the wrong one')\n")
    (tmp_path / "mine.py").write_text("import json, slamcmp.geometry\nTEXT = json.dumps(1)\n")
    assert load_user_file(tmp_path / "mine.py").TEXT == "1"


def test_classes_of_a_users_module_know_their_module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\nfrom typing import get_type_hints\n"
        "@dataclass\nclass Mine:\n    x: int = 3\nHINTS = get_type_hints(Mine)\n"
    )
    module = load_user_file(tmp_path / "mine.py")
    assert {"x": int} == module.HINTS
    assert sys.modules[module.Mine.__module__] is module


REGISTERED = """
import functools
from slamcmp.registry import back_ends, sources

@sources.register("mine", seeded=False, files=lambda **_: ["data.csv"], paths=("path",), parameter_docs=dict)
def mine(seed=0, *, path: str = "x"): ...

def wrapped(function):
    @functools.wraps(function)
    def inner(*args, **kwargs): return function(*args, **kwargs)
    return inner

@wrapped
@sources.register("second", seeded=False)
def second(seed=0): ...

third = functools.partial(mine, path="y")

@back_ends.register("ekf_slam", needs_truth=True, closes_loops=False)
class Mine: ...

def plain(seed=0): ...
"""


def test_traits_that_a_users_file_registers_are_known(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    names = sources.names(), back_ends.names()
    shipped = back_ends.get("ekf_slam").target
    for text in (REGISTERED, REGISTERED + "# changed\n"):
        path.write_text(text)
        for name in ("mine", "second", "third"):
            assert sources.get(f"{path}:{name}").traits["seeded"] is False
        assert {"files", "paths", "parameter_docs"} <= sources.get(f"{path}:mine").traits.keys()
        found = back_ends.get(f"{path}:Mine")
        assert (found.traits["needs_truth"], found.traits["closes_loops"]) == (True, False)
        assert found.traits["user_file"] == path
        assert set(sources.get(f"{path}:plain").traits) == {"user_file"}
    # They are found by their file only, and take no shipped name.
    assert (sources.names(), back_ends.names()) == names
    assert back_ends.get("ekf_slam").target is shipped
