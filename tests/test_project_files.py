"""What others' tools read of the repository: citation, environment, workflow, templates."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import slamcmp

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
YAMLS = [
    "CITATION.cff",
    "environment.yml",
    *(str(p.relative_to(ROOT)) for p in (ROOT / ".github").rglob("*.yml")),
]


def read(name: str) -> dict[str, Any]:
    found: dict[str, Any] = YAML(typ="safe").load((ROOT / name).read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("name", YAMLS)
def test_every_file_is_yaml(name: str) -> None:
    assert isinstance(read(name), dict)


def test_the_citation_is_of_this_version() -> None:
    cited = read("CITATION.cff")
    assert {
        "cff-version",
        "message",
        "title",
        "authors",
        "version",
        "date-released",
        "license",
    } <= cited.keys()
    assert (cited["license"], cited["type"]) == (PROJECT["license"], "software")
    assert cited["version"] == slamcmp.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {slamcmp.__version__} ({cited['date-released']})" in changelog
    assert cited["repository-code"] == PROJECT["urls"]["Homepage"]


def test_environment_and_image_install_what_the_project_needs() -> None:
    least = PROJECT["requires-python"].removeprefix(">=")
    minor = int(least.split(".")[1])
    pinned = next(each for each in read("environment.yml")["dependencies"] if str(each).startswith("python="))
    image = re.search(r"^FROM python:3\.(\d+)", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
    assert image is not None
    assert int(pinned.split(".")[1]) >= minor
    assert int(image[1]) >= minor


def test_the_workflow_runs_commands_that_there_are() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    steps = [
        step["run"]
        for job in read(".github/workflows/ci.yml")["jobs"].values()
        for step in job["steps"]
        if "run" in step
    ]
    targets = {name for step in steps for name in re.findall(r"make (\w+)", step)}
    assert targets == {"check"}
    assert re.search(r"^check:", makefile, flags=re.MULTILINE)
    assert any("slamcmp compare" in step and "--fail-if" in step for step in steps)
