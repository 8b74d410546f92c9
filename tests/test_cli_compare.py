"""``slamcmp compare`` as a build runs it: two versions of a back end, and a condition."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import slamcmp
from tests.command import Command

EXPERIMENT = """
source: {{name: circle, landmarks: 8, steps: 25, {source}}}
back_ends:
  - {{name: ekf_slam, label: EKF}}
  - {{name: '{mine}:Mine', label: mine}}
seeds: 5
"""
MINE = """
from slamcmp.backends.dead_reckoning import DeadReckoning
from slamcmp.geometry import exp
from slamcmp.types import Estimate


class Mine(DeadReckoning):
    def estimate(self):
        found = super().estimate()
        return Estimate(found.T_world_body @ exp([SHIFT, 0, 0]), found.P)
"""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a first version (``before``), a worse one and one on other streams."""
    folder = tmp_path_factory.mktemp("compare")
    for name, shift, source in (("before", 0.0, ""), ("after", 0.9, ""), ("other", 0.0, "speed_m_s: 0.7")):
        mine = folder / "mine.py"
        mine.write_text(MINE.replace("SHIFT", str(shift)))
        (folder / "e.yaml").write_text(EXPERIMENT.format(mine=mine, source=source))
        found = slamcmp.run(
            folder / "e.yaml", folder=folder / "results" / name, executor="serial", progress=False
        )
        assert set(found.trials["status"]) == {"ok"}
    return folder


@pytest.fixture
def call(folders: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return Command(folders, monkeypatch, capsys)


def test_a_worse_back_end_fails_the_build(call: Command) -> None:
    worse = "online_ate worse by 5%"
    code, out, error = call("compare", "before", "after", "--fail-if", worse)
    assert code == 1, error
    assert f"FAILS: {worse}" in out
    assert "code: mine: " in out
    assert "code: EKF" not in out
    verdicts = {
        line.split()[2]: line.split()[-1] for line in out.splitlines() if line.startswith("online_ate ")
    }
    assert verdicts["mine"] != "identical"
    assert verdicts["EKF"] == "identical"
    code, out, _ = call("compare", "after", "before", "--fail-if", worse, "--back-end", "mine")
    assert (code, "passes: online_ate" in out) == (0, True)
    code, out, _ = call("compare", "before", "after", "--json", "--fail-if", worse)
    data = json.loads(out)
    assert (code, data["fails"]) == (1, True)
    (found,) = data["comparisons"]
    assert {row["metric"] for row in found["rows"]} >= {"online_ate", "update_median_ms"}
    assert found["differences"]["configuration"] == []


def test_other_streams_are_refused_and_wrong_inputs_told(call: Command) -> None:
    for others, said in (
        (["other"], "different streams"),
        (["other"], "source.speed_m_s 1 → 0.7"),
        (["nowhere"], "nowhere: no results here"),
        (["after", "--metric", "online_at"], "did you mean 'online_ate'?"),
        (["after", "--fail-if", "onlin_ate worse by 5%"], "did you mean 'online_ate'? Known: "),
        (["after", "--pair", "EKF"], "expected BASE=OTHER"),
    ):
        code, out, error = call("compare", "before", *others)
        assert (code, out) == (3 if "nowhere" in others else 2, ""), others
        assert said in error
        assert error.count("\n") == 1


def test_of_three_folders_the_one_that_cannot_be_compared_does_not_hide_the_other(call: Command) -> None:
    code, out, error = call("compare", "before", "other", "after", "--metric", "online_ate")
    assert code == 2
    assert "results/after against results/before" in out
    assert "results/other" not in out
    assert "results/before and results/other cannot be compared" in error


def test_markdown_and_page_are_written(call: Command, folders: Path) -> None:
    assert call("compare", "before", "after", "--format", "html", "--output", "out.html")[:2] == (
        0,
        "out.html\n",
    )
    assert "after against" in (folders / "out.html").read_text()
    text = call("compare", "before", "after", "--format", "markdown")[1]
    assert text.startswith("### results/after against results/before\n\n| metric |")
