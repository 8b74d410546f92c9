"""What an installation holds and needs, as setup.py and pyproject.toml say it."""

from __future__ import annotations

import ast
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
from slamcmp.grading.assignment.handout import FILES
from slamcmp.support.provenance.code_version import REQUIRED

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, SETUPTOOLS = SETTINGS["project"], SETTINGS["tool"]["setuptools"]
MODULE_OF = {"opencv-python-headless": "cv2", "ruamel.yaml": "ruamel", "annotated-types": "annotated_types"}


class BuildPy:
    """The part of setuptools' command that setup.py changes: which modules of a package are packed."""

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        return [(package, path.stem, str(path)) for path in sorted(Path(package_dir).glob("*.py"))]


def setup_arguments(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What setup.py hands to setuptools, which need not be installed where the tests run."""
    given: dict[str, Any] = {}
    setuptools = ModuleType("setuptools")
    setuptools.setup = given.update  # type: ignore[attr-defined]
    commands = ModuleType("setuptools.command.build_py")
    commands.build_py = BuildPy  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "setuptools.command.build_py", commands)
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
        command = given["cmdclass"]["build_py"]()
        modules = command.find_package_modules(package, folder.relative_to(ROOT).as_posix())
        files = [ROOT / each[2] for each in modules]
        for pattern in given["package_data"].get(package, ()):
            files += folder.glob(pattern)
        for file in files:
            target = site.joinpath(*parts, file.relative_to(folder))
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
            copied.append(file)
    return copied


def is_the_staffs(path: Path) -> bool:
    """Whether a file says how hidden tests are made, or how an assignment is solved."""
    return path.is_relative_to(ROOT / "experiments" / "assignments") and path.name not in FILES


def test_an_installation_holds_every_file_but_the_staffs_and_finds_what_is_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    copied = set(install(setup_arguments(monkeypatch), site))
    for folder in (ROOT / "slamcmp", ROOT / "experiments"):
        files = {path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
        assert files - copied == {path for path in files if is_the_staffs(path)}
        assert not any(is_the_staffs(path) for path in copied)
    script = """
import slamcmp
from slamcmp.experiment.config.shipped import find_experiment, shipped_experiments
from slamcmp.grading.assignment.handout import find_handout
print(slamcmp.__file__, find_experiment("anchors/p1"), find_handout("ekf").folder, len(shipped_experiments()))
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


def test_no_line_of_a_solution_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site"
    install(setup_arguments(monkeypatch), site)
    told = "\n".join(path.read_text("utf-8") for path in (site / "slamcmp" / "shipped").rglob("*.*"))
    assignments = ROOT / "experiments" / "assignments"
    for solution in sorted(assignments.glob("*/solution/solution.py")):
        source, given = solution.read_text("utf-8"), (solution.parents[1] / "starter.py").read_text("utf-8")
        asked = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
        bodies = [ast.get_source_segment(source, node.body[-1]) for node in asked]
        # Short lines, of an angle wrapped, stand in more places than in a solution.
        bodies = [body for body in bodies if body and len(body) > 50 and body not in given]
        assert bodies, solution
        assert [body for body in bodies if body in told] == [], solution


def test_students_work_with_an_installation_and_grading_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    install(setup_arguments(monkeypatch), site)

    def slamcmp_says(*words: str, **more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-P", "-m", "slamcmp", *words],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(site), "SLAMCMP_GRADING_SECRET": "0123456789abcdef", **more},
            capture_output=True,
            text=True,
        )

    listed = slamcmp_says("list", "assignments")
    assert "\nekf_slam " in listed.stdout
    assert slamcmp_says("handout", "kalman_filter", "mine").returncode == 0
    checked = slamcmp_says("check", "mine/kalman_filter.py")
    assert checked.returncode == 1
    assert "not implemented yet" in checked.stdout
    graded = slamcmp_says("grade", "kalman_filter", "mine/kalman_filter.py")
    assert graded.returncode == 3
    assert graded.stderr.count("\n") == 1
    assert "hidden tests and solutions are not part of an installation" in graded.stderr
    # With the staff's folder the same installation grades.
    staff = tmp_path / "staff"
    shutil.copytree(ROOT / "experiments" / "assignments" / "kalman_filter", staff / "kalman_filter")
    solution = str(staff / "kalman_filter" / "solution" / "solution.py")
    shutil.copyfile(solution, tmp_path / "kalman_filter.py")
    words = ("assignment", "export", "there")
    assert "not part of an installation" in slamcmp_says(*words).stderr
    graded = slamcmp_says(
        "grade", "kalman_filter", "kalman_filter.py", "--accept-weak-sandbox", SLAMCMP_STAFF=str(staff)
    )
    assert "100.00 of 100 points" in graded.stdout, graded.stderr


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
        (
            None,
            True,
            "not installed; filters in the plane take several times as long: pip install 'slamcmp[fast]'",
        ),
        ("__version__ = '0.99.1'", True, "0.99.1 compiles filters in the plane"),
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


def test_the_description_of_a_wheel_links_to_the_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the README leaves the repository, its figures and pages are found by absolute links."""
    given = setup_arguments(monkeypatch)
    assert given["long_description_content_type"] == "text/markdown"
    assert {"version", "readme"} <= set(PROJECT["dynamic"])
    links = re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", given["long_description"])
    home = PROJECT["urls"]["Homepage"]
    assert len(links) > 15
    for image, link in links:
        kind = "raw" if image else "blob"
        assert link.startswith(f"{home}/{kind}/main/"), link
        path = link.removeprefix(f"{home}/{kind}/main/").partition("#")[0]
        assert (ROOT / path).exists(), link
