"""The images of README and docs: each is made by one command, from an experiment that is shipped."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.registry import figures

ROOT = Path(__file__).parents[1]
COMMAND = ROOT / "docs" / "make_figures.py"


@pytest.fixture(scope="module")
def command() -> dict[str, Any]:
    """What the command's file defines."""
    namespace: dict[str, Any] = {"__name__": "make_figures", "__file__": str(COMMAND)}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(COMMAND.parent))
        exec(compile(COMMAND.read_text(encoding="utf-8"), str(COMMAND), "exec"), namespace)
    return namespace


def shown() -> set[str]:
    """Every image that a page shows, by its file name."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    links = [
        link for page in pages for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text("utf-8"))
    ]
    assert all(Path(link).parent.name == "images" for link in links)
    return {Path(link).name for link in links}


def test_every_image_is_made_by_the_command_and_shown(command: dict[str, Any]) -> None:
    kept = {path.name for path in (ROOT / "docs" / "images").iterdir()}
    made = {*command["IMAGES"], *command["MATCHES"], *command["STUDY"], *command["PAGES"]}
    assert made == kept
    # The page of the shipped experiments shows each experiment's own (tests/docs/test_site.py).
    assert shown() <= made
    assert {*command["PAGES"], *command["MATCHES"], *command["STUDY"]} <= shown()


def test_every_image_of_a_page_is_drawn_by_its_code_and_shown_there(command: dict[str, Any]) -> None:
    for image, page in command["PAGES"].items():
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        assert f'savefig("{image}"' in text
        assert f"images/{image})" in text


def test_images_do_not_make_a_checkout_heavy() -> None:
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()]
    assert max(sizes) < 1_000_000
    assert sum(sizes) < 6_000_000


def test_every_image_comes_from_a_shipped_experiment_that_draws_it(command: dict[str, Any]) -> None:
    shipped = shipped_experiments()
    for experiment, figure in [*command["IMAGES"].values(), *command["STUDY"].values()]:
        assert figure in figures
        named = load_experiment(shipped[experiment]).figures
        assert named is None or figure in named
    for experiment, pair in command["MATCHES"].values():
        assert max(pair) < load_experiment(shipped[experiment]).source.parameters["steps"]


def test_an_image_that_is_not_known_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, str(COMMAND), "dail.png"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "no image dail.png; known: dial.png" in done.stderr
