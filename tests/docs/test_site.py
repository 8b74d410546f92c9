"""The documentation site builds without a warning, needs no network, and has what there is."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import slamcmp
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.registry import back_ends, figures, front_ends, metrics, sources
from slamcmp.results.numbers import number_text
from tests.anchors.reference import read_runs

NO_FIGURE = {
    "kitti00_stereo",
    "map_size",
    "mrclam",
    "mrclam_unknown",
    "outliers",
    "rendered_room_mono",
    "answer/range_bearing_outliers",
    "answer/range_bearing_windows",
    "answer/relative_position_outliers",
    "answer/stereo",
    "answer/stereo_outliers",
    "answer/stereo_windows",
}
"""Of which no runs are committed: recorded data, or not run to their end."""
ROOT = Path(__file__).resolve().parents[2]
pytest.importorskip("sphinx", reason="the site needs the extra [docs]")
pytest.importorskip("myst_parser", reason="the site needs the extra [docs]")
pytest.importorskip("furo", reason="the site needs the extra [docs]")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as ``make docs`` does."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (command,) = re.findall(r"-m sphinx (.*) docs build/docs", makefile)
    assert "-W" in command.split()
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "sphinx",
            *command.split(),
            "-d",
            str(folder / "kept"),
            "docs",
            str(folder / "html"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder / "html"


class Loads(HTMLParser):
    """What a page loads by itself, and where its links lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.ids.add(given.get("id", ""))
        if tag in {"script", "img", "source", "iframe"} and "src" in given:
            self.loaded.append(given["src"])
        if tag == "link" and {"stylesheet", "preload", "icon"} & set(given.get("rel", "").split()):
            self.loaded.append(given["href"])
        if tag == "a" and "href" in given:
            self.links.append(given["href"])


def test_each_experiment_that_has_results_has_a_figure_and_a_sentence(site: Path) -> None:
    page = (site / "experiments.html").read_text(encoding="utf-8")
    heading = r'<h3><code[^>]*><span class="pre">([^<]+)</span>'
    sections = dict(re.findall(heading + r"(.*?)</section>", page, re.S))
    assert set(sections) == set(shipped_experiments())
    without = {name for name, text in sections.items() if "<img" not in text}
    assert all("Committed results:</em> none yet" in sections[name] for name in without)
    assert without <= NO_FIGURE
    # Derived from the table beside it, by hand here.
    runs = read_runs("association_shared")
    here = runs[(runs["source.outlier_fraction"] == 0.1) & (runs["status"] == "ok")]
    medians = here.groupby("label")["online_ate"].median()
    best, worst = (
        f"{number_text(medians[each])} m ({each})" for each in (medians.idxmin(), medians.idxmax())
    )
    assert f"goes from {best} to {worst}" in sections["association_shared"]
    # One run a back end is no median.
    assert "The online ATE goes from" in sections["victoria_park"]
    assert "The median online ATE goes from" in sections["dial"]


def test_pages_load_nothing_from_elsewhere_and_links_lead_somewhere(site: Path) -> None:
    pages = {page: Loads(page) for page in site.rglob("*.html")}
    assert len(pages) > 45
    for page, found in pages.items():
        assert not [each for each in found.loaded if re.match(r"(https?:)?//", each)], page.name
        for link in found.links:
            address, _, place = link.partition("#")
            if re.match(r"[a-z]+:", address):
                continue
            target = (page.parent / address).resolve() if address else page
            assert target.exists(), f"{page.name}: {link}"
            if place and target in pages:
                assert place in pages[target].ids, f"{page.name}: {link}"


def text(page: Path) -> str:
    return re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))


def test_every_shipped_experiment_is_there_with_its_question_and_figures(site: Path) -> None:
    page = (site / "experiments.html").read_text(encoding="utf-8")
    shown = text(site / "experiments.html")
    for name in shipped_experiments():
        assert f"slamcmp run {name}" in shown, name
    sys.path.insert(0, str(ROOT / "docs"))
    from make_figures import IMAGES, MATCHES, STUDY

    for image in {*IMAGES, *MATCHES, *STUDY}:
        assert f"_images/{image}" in page, image
    assert "What does it cost to forget the past, on a loop that is driven five times?" in shown


def test_the_reference_has_every_public_name_and_plug_in(site: Path) -> None:
    reference = {page.stem: text(page) for page in (site / "reference").glob("*.html")}
    everything = " ".join(reference.values())
    missing = [name for name in slamcmp.__all__ if not re.search(rf"\b{name}\b", everything)]
    assert missing == []
    for kind, registry in (
        ("back-ends", back_ends),
        ("sources", sources),
        ("front-ends", front_ends),
        ("metrics", metrics),
        ("figures", figures),
    ):
        assert [name for name in registry.names() if name not in reference[kind]] == []


def test_the_reference_has_every_command_with_its_example(site: Path) -> None:
    shown = text(site / "reference" / "commands.html")
    help_text = subprocess.run(
        [sys.executable, "-m", "slamcmp", "--help"], capture_output=True, text=True, check=True
    ).stdout
    commands = re.findall(r"^│ ([a-z][a-z-]+) ", help_text, flags=re.MULTILINE)
    assert {"run", "report", "compare"} <= set(commands)
    assert [name for name in commands if f"slamcmp {name}" not in shown] == []
