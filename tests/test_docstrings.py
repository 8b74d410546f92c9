"""Names that docstrings put between backticks exist.

A module's docstring is where a reader starts, and a name that is nowhere sends him searching. What counts as
a name: one word, dotted or called or not, or a word with an underscore inside a longer piece of code. It
exists if the module's code has it; without a leading underscore it may also be one of the package's (module,
class, function, argument, attribute, registered plug-in, key, or option as the code writes it) or a file of
the repository. Single letters, hats and ``my_…`` are mathematics and the reader's own; other people's names
stand in a list below.
"""

from __future__ import annotations

import ast
import builtins
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "slamcmp"
MODULES = sorted(PACKAGE.rglob("*.py"))
BACKTICKED = re.compile(r"``([^`]+)``|`([^`]+)`")
NAME = re.compile(r"[A-Za-z_][\w.]*(\(\))?")
WORD = re.compile(r"[A-Za-z_]\w*")
KEY = re.compile(r"([a-z][\w.]*):\s")
FOREIGN = {
    *("T_BS", "sequences", "u_left"),  # of recorded data sets
    *("t_ms", "bearing_deg", "sigma_range_m"),  # columns as a user may head them
    *("T_cn_cnm1", "camera_info", "cameras.txt"),  # of other programs' calibrations
    *("EDGE_SE3", "w100_30.g2o", "victoriaPark_reduced_1k.g2o", "cityTrees_reduced_1k.g2o"),  # of graph files
    *("seccomp_data", "unistd_64.h"),  # of Linux
    "fast",  # the extra in pyproject.toml
}
FOLDERS = ("slamcmp", "assignments", "experiments", "docs", "tests", "benchmarks")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def names_in(path: Path) -> frozenset[str]:
    """Every identifier of a module's code, and every string in it that is one word."""
    found: set[str] = {path.stem, *path.relative_to(ROOT).parent.parts}
    for node in ast.walk(tree(path)):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.arg(arg=name):
                found.add(name)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                found.add(name)
            case ast.keyword(arg=str(name)):
                found.add(name)
            case ast.alias(name=name, asname=asname):
                found.update(name.split("."))
                found.add(asname or name)
            case ast.Constant(value=str(text)) if re.fullmatch(r"[\w./*-]+", text):
                found.update({text, *text.split("/")})
    return frozenset(found)


@cache
def names_of_the_package() -> frozenset[str]:
    found = set(dir(builtins)).union(*(names_in(path) for path in MODULES))
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            found.update({path.name, path.stem, path.relative_to(ROOT).as_posix()})
    found.update(path.name for path in ROOT.iterdir())
    return frozenset(found)


def names(text: str) -> list[str]:
    """What of a backticked text must exist."""
    text = text.strip()
    if NAME.fullmatch(text):
        return [text.removesuffix("()")]
    if key := KEY.match(text):
        return [key[1]]
    return [
        word
        for word in WORD.findall(text)
        if "_" in word.strip("_") and len(max(word.split("_"), key=len)) > 2
    ]


def exists(name: str, path: Path) -> bool:
    """Whether a name in the docstring of the module at ``path`` is one."""
    last = name.rsplit(".", 1)[-1]
    if len(name) == 1 or name in names_in(path) or name in FOREIGN or re.match(r"my_|\w_hat$", name):
        return True
    if last.startswith("_"):
        return last in names_in(path)
    if last in {"parquet", "json", "yaml"}:
        name = name.removesuffix(f".{last}")
    if name.endswith("_"):
        return any(each.startswith(name) for each in names_of_the_package())
    known = names_of_the_package()
    return name in known or all(part in known for part in name.split("."))


def unknown(path: Path) -> list[str]:
    text = ast.get_docstring(tree(path)) or ""
    quoted = [double or single for double, single in BACKTICKED.findall(text)]
    return [name for piece in quoted for name in names(piece) if not exists(name, path)]


def test_every_backticked_name_of_a_module_docstring_exists() -> None:
    wrong = {path.relative_to(ROOT).as_posix(): unknown(path) for path in MODULES}
    assert {path: found for path, found in wrong.items() if found} == {}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("``construct`` and ``SlidingWindow.solve`` of ``ekf_slam``, ``window: null``", []),
        ("``T_k^-1 T`` and :meth:`SlidingWindow.marginalise`, ``None``, README.md, ``x``", []),
        ("``_append_pose``", ["_append_pose"]),
        ("``SlidingWindow._marginalise_oldest``", ["SlidingWindow._marginalise_oldest"]),
        ("``marginalise_everything()``", ["marginalise_everything"]),
        ("``A = linearise_all(T)``", ["linearise_all"]),
        ("``postponed_covariance.py``", ["postponed_covariance.py"]),
        ("``no_such_key: 3``", ["no_such_key"]),
    ],
)
def test_invented_names_are_found(text: str, wrong: list[str], tmp_path: Path) -> None:
    home = PACKAGE / "backends" / "window" / "sliding_window.py"
    quoted = [double or single for double, single in BACKTICKED.findall(text)]
    assert [name for piece in quoted for name in names(piece) if not exists(name, home)] == wrong
