"""What docs/architecture.md and CONTRIBUTING.md say is so: names exist, the walk is as long, recipes work."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")

ROW = re.compile(r"^\| (\d+) \| (\d*) ?\| `([^`]+)` \| (.+) \|$", re.MULTILINE)
OLD_WALK = (34, 47)
"""Files, and returns to one of them, that the same measurement took before there was this page."""


@cache
def defined(path: Path) -> frozenset[str]:
    """Every class, function, method and name at the top level of a module, methods as ``Class.method``."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{each.name}" for each in node.body if isinstance(each, ast.FunctionDef)}
            fields = [each.target for each in node.body if isinstance(each, ast.AnnAssign)]
            found |= {each.id for each in fields if isinstance(each, ast.Name)}
        if isinstance(node, ast.Assign):
            found |= {each.id for each in node.targets if isinstance(each, ast.Name)}
    return frozenset(found)


def all_names() -> set[str]:
    names = set().union(*(defined(path) for path in (ROOT / "slamcmp").rglob("*.py")))
    return names | {name.rpartition(".")[2] for name in names}


def test_every_file_of_the_page_exists() -> None:
    quoted = re.findall(r"`([\w./-]+)`", ARCHITECTURE)
    paths = {text for text in quoted if "/" in text and "NAME" not in text}
    assert len(paths) > 40
    # Families of back ends are named by their folder alone.
    roots = (ROOT, ROOT / "slamcmp" / "backends")
    assert sorted(path for path in paths if not any((root / path).exists() for root in roots)) == []


def test_every_name_of_the_page_exists() -> None:
    before_walk = ARCHITECTURE.partition("## The walk")[0]
    names = set(re.findall(r"`([A-Za-z]\w+)`", before_walk)) - {"T_prev_body", "T_world_body"}
    assert len(names) > 30
    assert sorted(names - all_names()) == []


def test_every_row_of_the_walk_names_what_its_file_defines() -> None:
    rows = ROW.findall(ARCHITECTURE)
    assert [int(number) for number, *_ in rows] == list(range(1, len(rows) + 1))
    for number, _, file, text in rows:
        path = ROOT / file
        assert path.is_file(), file
        names = re.findall(r"`([A-Za-z_][\w.]*)`", text)
        if path.suffix == ".py":
            assert set(names) & defined(path), f"row {number} names nothing of {file}"
            assert sorted(set(names) - defined(path) - all_names()) == []


def test_the_walk_is_as_long_as_it_says_and_shorter_than_it_was() -> None:
    rows = ROW.findall(ARCHITECTURE)
    files = {file for _, _, file, _ in rows}
    returns = sum(bool(origin) and int(origin) != int(number) - 1 for number, origin, _, _ in rows)
    assert f": {len(files)} files and {returns} returns." in ARCHITECTURE
    assert len(files) < OLD_WALK[0]
    assert returns < OLD_WALK[1]


RECIPES = {
    "back end": "slamcmp.backends.filters",
    "source": "slamcmp.worlds",
    "metric": "slamcmp.metrics",
    "figure": "slamcmp.report.figures",
}

USE = """
import importlib, json, sys
from pathlib import Path

for package, folder in json.loads(sys.argv[1]).items():
    importlib.import_module(package).__path__.append(folder)

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.registry import back_ends
from slamcmp.report import draw_figures

results = run_experiment(load_experiment("recipes.yaml"), folder="found", executor="serial")
drawn = draw_figures(results, ["map_growth"], Path("figures"), ("png",))
trials = results.trials.set_index("label")
print(json.dumps({
    "status": list(trials["status"]),
    "figures": [path.name for path in drawn],
    "end": dict(trials["online_end_error"]),
    "summary": back_ends.get("doubting_odometry").summary,
}))
"""


@pytest.fixture(scope="module")
def recipes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The recipes' files, each in a folder of its own, by the package they belong into."""
    folder = tmp_path_factory.mktemp("recipes")
    found = dict(re.findall(r"<!-- ([\w ]+) -->\n```python\n(.*?)```", CONTRIBUTING, flags=re.DOTALL))
    assert found.keys() == RECIPES.keys()
    files = {}
    for name, package in RECIPES.items():
        path = folder / package / f"my_{name.replace(' ', '_')}.py"
        path.parent.mkdir()
        path.write_text(found[name], encoding="utf-8")
        files[package] = path
    return files


def test_one_file_each_is_all_that_a_new_thing_needs(recipes: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "recipes.yaml").write_text(
        "source: {name: post, steps: 8}\nfront_end: {name: labelled}\nback_ends:\n"
        "  - {name: doubting_odometry, doubt: 1.5}\n  - {name: ekf_slam}\nseeds: 1\n"
    )
    folders = json.dumps({package: str(path.parent) for package, path in recipes.items()})
    answer = subprocess.run(
        [sys.executable, "-c", USE, folders], cwd=tmp_path, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found["status"] == ["ok", "ok"]
    assert found["figures"] == ["map_growth.png"]
    assert found["summary"] == "Dead reckoning with inflated noise."
    # The robot stands still and its odometry says so.
    assert found["end"]["doubting_odometry"] == 0.0
    assert 0.0 < found["end"]["ekf_slam"] < 1e-2


def test_the_recipes_pass_the_style_checks(recipes: dict[str, Path]) -> None:
    command = [sys.executable, "-m", "ruff", "check", "--config", str(ROOT / "pyproject.toml"), "--no-cache"]
    ruff = subprocess.run([*command, *map(str, recipes.values())], capture_output=True, text=True)
    assert ruff.returncode == 0, ruff.stdout
