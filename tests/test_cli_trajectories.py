"""``slamcmp import trajectory`` and ``slamcmp export``: there and back again, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import slamcmp
from slamcmp.datasets.graphs.graph_reader import read_graph
from slamcmp.datasets.trajectory_files import in_space, read_trajectory
from slamcmp.results.runs.stored_runs import stored_run
from slamcmp.results.store import load_results
from tests.command import Command

EXPERIMENT = {
    "name": "e",
    "source": {"name": "circle", "landmarks": 8, "steps": 25},
    "back_ends": [
        {"name": "ekf_slam", "label": "EKF"},
        {"name": "ekf_world", "label": "RTS", "smooth": True},
    ],
    "seeds": 2,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("trajectories")
    slamcmp.run(EXPERIMENT, folder=place / "results" / "e", executor="serial", progress=False)
    return place


@pytest.fixture
def call(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return Command(folder, monkeypatch, capsys)


@pytest.mark.parametrize("file_format", ["tum", "kitti", "euroc", "csv", "parquet"])
def test_a_run_goes_out_and_comes_back(call: Command, folder: Path, file_format: str) -> None:
    run = stored_run(load_results(folder / "results" / "e"), "RTS", 1)
    assert run.final is not None
    path = folder / f"out.{'parquet' if file_format == 'parquet' else 'txt'}"
    code, out, error = call(
        "export", "e", "--back-end", "RTS", "--trial", "1", "--format", file_format, "--output", str(path)
    )
    assert (code, out) == (0, f"{path}: 25 poses of RTS, final ({file_format})\n"), error
    found = read_trajectory(path).trajectory
    tables = file_format in ("csv", "parquet")
    expected = run.final.T_world_body if tables else in_space(run.final.T_world_body)
    np.testing.assert_allclose(found.T_world_body, expected, atol=1e-14)
    if tables:
        np.testing.assert_array_equal(found.P, run.final.P)


def test_a_graph_has_the_estimate_and_the_edges(call: Command, folder: Path) -> None:
    arguments = ("--back-end", "RTS", "--trial", "0", "--format", "g2o", "--trajectory", "online")
    assert call("export", "e", *arguments, "--output", "out.g2o")[0] == 0
    run = stored_run(load_results(folder / "results" / "e"), "RTS", 0)
    graph = read_graph(folder / "out.g2o")
    np.testing.assert_allclose(np.stack(list(graph.poses.values())), run.online.T_world_body, atol=1e-12)


def test_all_runs_go_into_a_folder(call: Command, folder: Path) -> None:
    code, out, _ = call("export", "e", "--format", "tum", "--json")
    written = json.loads(out)["files"]
    assert (code, len(written)) == (0, 4)
    assert {(each["back_end"], each["trial"], each["trajectory"]) for each in written} == {
        ("EKF", 0, "online"), ("EKF", 1, "online"), ("RTS", 0, "final"), ("RTS", 1, "final")
    }  # fmt: skip
    assert all((folder / each["file"]).is_file() for each in written)


def test_what_was_exported_is_compared_with_what_was_imported(call: Command) -> None:
    for label, name in (("EKF", "ekf"), ("RTS", "rts")):
        call("export", "e", "--back-end", label, "--trial", "0", "--format", "csv", "--output", f"{name}.csv")
    arguments = ("import", "trajectory", "ekf.csv", "rts.csv", "--truth", "rts.csv", "--as", "A", "--as", "B")
    code, out, error = call(
        *arguments, "--final", "--results", "results/i", "--parameter", "window=3", "--json"
    )
    assert code == 0, error
    data = json.loads(out)
    assert [row["back_end"] for row in data["summary"]] == ["A", "B"]
    assert data["imports"][0]["covariance"] is True
    trials = load_results("results/i").trials.set_index("label")
    assert trials.loc["B", "final_ate"] < 1e-9 < trials.loc["A", "final_ate"]
    assert call("compare", "results/i", "results/i")[0] == 0
    code, _, error = call("compare", "results/i", "results/e")
    assert code == 2
    assert "cannot be compared" in error


def test_wrong_inputs_are_one_line(call: Command) -> None:
    call("export", "e", "--back-end", "EKF", "--trial", "0", "--format", "tum", "--output", "ok.txt")
    imported = ("import", "trajectory", "ok.txt", "--truth", "ok.txt", "--as", "A")
    for arguments, code, said in (
        (imported, 2, "say --online"),
        ((*imported, "--as", "B", "--as", "C", "--online"), 2, "--as is given 3 times for 1 files"),
        ((*imported, "--online", "--parameter", "window"), 2, "expected NAME=VALUE"),
        ((*imported, "--online", "--results", "results/e"), 2, "holds the results of an experiment"),
        (("import", "trajectory", "no.txt", "--truth", "ok.txt", "--as", "A", "--online"), 3, "no such file"),
        (("export", "e", "--format", "tum", "--back-end", "EKFS"), 2, "did you mean 'EKF'?"),
        (("export", "e", "--format", "tum", "--trial", "7"), 2, "no trial 7"),
        (
            ("export", "e", "--format", "tum", "--back-end", "EKF", "--trial", "0", "--trajectory", "final"),
            2,
            "filter",
        ),
        (("export", "nowhere", "--format", "tum"), 3, "no results here"),
        (("export", "no.npz", "--format", "tum"), 3, "no such file"),
    ):
        answer = call(*arguments)
        assert answer[0] == code, (arguments, answer)
        assert said in answer[2]
        assert answer[2].count("\n") == 1
