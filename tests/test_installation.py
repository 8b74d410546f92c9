"""What an installation holds and needs, as setup.py and pyproject.toml say it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import slamcmp
from slamcmp.cli import doctor
from slamcmp.support.code_version import REQUIRED

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, SETUPTOOLS = SETTINGS["project"], SETTINGS["tool"]["setuptools"]
MODULE_OF = {"opencv-python-headless": "cv2", "ruamel.yaml": "ruamel", "annotated-types": "annotated_types"}


def setup_arguments(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What setup.py hands to setuptools, which need not be installed where the tests run."""
    given: dict[str, Any] = {}
    setuptools = ModuleType("setuptools")
    setuptools.setup = given.update  # type: ignore[attr-defined]
    setuptools.find_packages = lambda include: [  # type: ignore[attr-defined]
        ".".join(path.parent.relative_to(ROOT).parts) for path in ROOT.glob("slamcmp/**/__init__.py")
    ]
    monkeypatch.setitem(sys.modules, "setuptools", setuptools)
    monkeypatch.chdir(ROOT)
    exec((ROOT / "setup.py").read_text(encoding="utf-8"), {"__name__": "__main__"})
    return given


def install(given: dict[str, Any], site: Path) -> list[Path]:
    """Copy what the arguments name to ``site`` as a wheel does; the sources of all files copied."""
    copied = []
    for package in given["packages"]:
        parts = package.split(".")
        known = given["package_dir"]
        folder = ROOT / known[package] if package in known else ROOT.joinpath(*parts)
        for pattern in ("*.py", *given["package_data"].get(package, ())):
            for file in folder.glob(pattern):
                target = site.joinpath(*parts, file.relative_to(folder))
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target)
                copied.append(file)
    return copied


def test_an_installation_holds_every_file_and_finds_what_is_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    copied = set(install(setup_arguments(monkeypatch), site))
    for folder in (ROOT / "slamcmp", ROOT / "experiments"):
        files = {path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
        assert files - copied == set()
    script = """
import slamcmp
from slamcmp.experiment.config.shipped import find_experiment, shipped_experiments
from slamcmp.grading.assignment.description import find_assignment
print(slamcmp.__file__, find_experiment("anchors/p1"), find_assignment("ekf"), len(shipped_experiments()))
"""
    # As with ``pip install --target`` or ``--user``: nothing of it lies in the interpreter's environment.
    answer = subprocess.run(
        [sys.executable, "-P", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=True,
    )
    inside = site / "slamcmp"
    count = sum("assignments" not in path.parts for path in (ROOT / "experiments").rglob("*.yaml"))
    assert answer.stdout.split() == [
        str(inside / "__init__.py"),
        str(inside / "shipped" / "anchors" / "p1.yaml"),
        str(inside / "shipped" / "assignments" / "ekf"),
        str(count),
    ]


def test_the_version_stands_once() -> None:
    assert "version" not in PROJECT
    assert SETUPTOOLS["dynamic"]["version"] == {"attr": "slamcmp.__version__"}
    # Read, not imported, by setuptools: it must be a plain text.
    text = (ROOT / "slamcmp" / "__init__.py").read_text(encoding="utf-8")
    assert f'\n__version__ = "{slamcmp.__version__}"\n' in text


def test_the_list_of_required_modules_follows_pyproject() -> None:
    names = [re.split(r"[<>=!~\[; ]", line)[0] for line in PROJECT["dependencies"]]
    assert {MODULE_OF.get(name, name) for name in names} == REQUIRED


def test_constraints_lie_within_the_ranges() -> None:
    # ``packaging`` comes with pytest.
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line)
    pinned = {canonicalize_name(name): version for name, version in pinned.items()}
    extras = PROJECT["optional-dependencies"]
    for line in (*PROJECT["dependencies"], *extras["fast"], *extras["test"], *extras["types"]):
        wanted = Requirement(line)
        assert wanted.specifier.contains(pinned[canonicalize_name(wanted.name)]), line


def test_figures_of_planar_worlds_need_no_opencv(tmp_path: Path) -> None:
    from slamcmp.experiment.config.experiment import load_experiment
    from slamcmp.experiment.runner import run_experiment

    path = tmp_path / "small.yaml"
    path.write_text(
        "source: {name: circle, landmarks: 8, steps: 12}\nfront_end: {name: labelled}\n"
        "back_ends: [{name: ekf_slam}]\nseeds: 1\n"
    )
    run_experiment(load_experiment(path), folder=tmp_path / "small", executor="serial", progress=False)
    script = "import sys; sys.modules['cv2'] = None\nfrom slamcmp.cli import main; main()"
    # It loads every figure, and the report, before it draws one.
    command = [sys.executable, "-c", script, "plot", "small", "--figure", "map", "--format", "png"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "small" / "figures" / "map.png").is_file()


@pytest.mark.parametrize(
    ("numba", "ok", "said"),
    [
        (None, True, "not installed; only ekf_compiled needs it: pip install 'slamcmp[fast]'"),
        ("__version__ = '0.99.1'", True, "0.99.1, for ekf_compiled"),
        ("raise ImportError('Numba needs NumPy 2.3 or less')", False, "Numba needs NumPy 2.3 or less"),
    ],
)
def test_doctor_knows_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, numba: str | None, ok: bool, said: str
) -> None:
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    if numba is None:
        monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)
    else:
        (tmp_path / "numba.py").write_text(numba)
        monkeypatch.syspath_prepend(tmp_path)
    (finding,) = [found for found in doctor.examine() if found.what == "numba"]
    assert finding.ok == ok
    assert said in finding.detail
