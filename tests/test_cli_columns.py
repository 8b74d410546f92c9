"""Columns of the tables: ``columns:`` in the experiment, ``--columns`` on the line; and ``--open``."""

from __future__ import annotations

import json
import re
import webbrowser
from pathlib import Path
from typing import Any

import pytest

from tests.command import Command

EXPERIMENT: dict[str, Any] = {
    "source": {"name": "circle", "landmarks": 6, "steps": 10},
    "back_ends": [{"name": "ekf_slam"}, {"name": "dead_reckoning"}],
    "seeds": 2,
    "columns": ["online_heading_rmse_deg", "online_ate"],
}
RUN = ("run", "e.yaml", "--executor", "serial")


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    (tmp_path / "e.yaml").write_text(json.dumps(EXPERIMENT))
    return Command(tmp_path, monkeypatch, capsys)


def summary_headings(page: Path) -> list[str]:
    """Of the report's summary, without those that say what ran."""
    table = re.search(r'<table id="summary-table">.*?</thead>', page.read_text("utf-8"), flags=re.DOTALL)
    assert table is not None
    return re.findall(r'<th scope="col"[^>]*title="[^"]*"[^>]*>([^<]+)</th>', table[0])


def test_columns_of_the_experiment_and_of_the_line(call: Command, tmp_path: Path) -> None:
    code, out, _ = call(*RUN)
    assert code == 0
    page = tmp_path / "results" / "e" / "report.html"
    # In the order in which they were asked for.
    assert summary_headings(page) == ["heading RMSE [deg]", "ATE [m]"]
    assert out.index("online heading RMSE [deg]") < out.index("online ATE [m]")
    assert "NEES" not in out.partition("\n\n")[0]
    assert call("report", "e", "--columns", "online_pose_nees,nis_per_dof")[0] == 0
    assert summary_headings(page) == ["pose NEES", "NIS/dof"]
    # The line wins, and the tables keep every column all the same.
    code, out, _ = call(*RUN, "--columns", "landmark_rmse", "--no-report", "--json")
    rows = json.loads(out)["summary"]
    assert all("landmark_rmse" in row and "online_ate" not in row for row in rows)
    assert all("online_ate" in row for row in json.loads(out)["trials"])


@pytest.mark.parametrize("command", [RUN, ("report", "results/e")])
def test_a_column_that_is_none_is_told_before_anything_runs(
    call: Command, tmp_path: Path, command: tuple[str, ...]
) -> None:
    if command[0] == "report":
        assert call(*RUN, "--no-report")[0] == 0
    code, _, said = call(*command, "--columns", "online_ate,onlin_pose_nees")
    assert code == 2
    assert "onlin_pose_nees" in said
    assert "did you mean 'online_pose_nees'?" in said
    assert not list(tmp_path.rglob("report.html"))


def test_a_wrong_column_in_the_file_is_told_with_its_place(call: Command, tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(
        "source: {name: circle}\nback_ends: [{name: ekf_slam}]\ncolumns: [online_at]\n"
    )
    code, _, said = call(*RUN)
    assert code == 2
    assert "e.yaml:3:" in said
    assert "online_ate" in said


def test_open_shows_the_page_that_was_written(
    call: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(shown.append(address)) or True)
    assert call(*RUN, "--open")[0] == 0
    page = tmp_path / "results" / "e" / "report.html"
    assert shown == [page.resolve().as_uri()]
    assert call("report", "e", "--open")[0] == 0
    assert shown == [page.resolve().as_uri()] * 2


def test_open_without_a_browser_says_where_the_page_is(
    call: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda _address: False)
    code, _, said = call(*RUN, "--open", "--quiet")
    assert code == 0
    assert "no browser was found; the page is" in said
    code, _, said = call(*RUN, "--open", "--no-report")
    assert code == 2
    assert "--no-report" in said
