"""The configuration that is printed loads again, and a results folder says how to make it again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import slamcmp
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import shipped_experiments
from slamcmp.experiment.reproduction import write_reproduction
from slamcmp.results.store import finite
from tests.command import Command

PLUGINS = Path(__file__).parents[1] / "user_plugins.py"


def printed(config: dict[str, Any], *, as_stored: bool) -> str:
    """As the report prints it: from a program's results, or from those that were read from their folder."""
    if as_stored:
        config = json.loads(json.dumps(finite(config), default=str))
    return json.dumps(config, indent=2, default=str)


@pytest.mark.parametrize("as_stored", [True, False])
def test_every_shipped_configuration_loads_as_it_is_printed(tmp_path: Path, as_stored: bool) -> None:
    path = tmp_path / "printed.yaml"
    for name, file in shipped_experiments().items():
        experiment = load_experiment(file)
        path.write_text(printed(experiment.as_dict(), as_stored=as_stored))
        assert load_experiment(path).as_dict() == experiment.as_dict(), name


@pytest.mark.parametrize("infinity", ["inf", "Infinity", ".inf", "INF"])
def test_infinity_is_a_number_where_one_is_asked_for(tmp_path: Path, infinity: str) -> None:
    path = tmp_path / "e.yaml"
    text = "source: {{name: circle}}\nfront_end: {{name: labelled, range_max_m: {0}}}\n"
    text += (
        "back_ends: [{{name: sliding_window, window: null}}]\nsweep: {{front_end.range_max_m: [8.0, {0}]}}\n"
    )
    path.write_text(text.format(infinity))
    experiment = load_experiment(path)
    assert experiment.front_end.parameters["range_max_m"] == float("inf")
    assert experiment.sweep["front_end.range_max_m"] == (8.0, float("inf"))
    path.write_text("source: {name: inf}\nback_ends: [{name: ekf_slam, smooth: inf}]\nseeds: inf\n")
    with pytest.raises(UsageError) as error:
        load_experiment(path)
    assert len(str(error.value).split("\n")) == 3


def test_no_seed_is_for_sources_that_take_none(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text("source: {name: victoria_park}\nback_ends: [{name: dead_reckoning}]\nseeds: [null]\n")
    assert load_experiment(path).seeds == (None,)
    path.write_text("source: {name: circle}\nback_ends: [{name: dead_reckoning}]\nseeds: [null]\n")
    with pytest.raises(UsageError, match=r":3:9: seeds: source 'circle' needs numbers, not null"):
        load_experiment(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("repro")
    (place / "mine.py").write_text(PLUGINS.read_text())
    lines = [
        "source: {name: circle, landmarks: 6, steps: 12}",
        "front_end: {name: labelled, range_max_m: .inf}",
    ]
    lines += [
        "back_ends:",
        "  - {name: 'mine.py:Hindsight', label: mine}",
        "  - {name: ekf_slam}",
        "seeds: 2",
    ]
    (place / "e.yaml").write_text("\n".join(lines) + "\n")
    slamcmp.run(place / "e.yaml", folder=place / "results" / "e", executor="serial", progress=False)
    return place


@pytest.fixture
def call(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return Command(folder, monkeypatch, capsys)


def test_what_is_written_makes_the_same_streams_and_runs(call: Command, folder: Path) -> None:
    code, out, error = call("repro", "e")
    assert code == 0, (out, error)
    written = folder / "results" / "e" / "repro"
    names = ["experiment.yaml", "requirements.txt", "reproduce.sh", "mine.py"]
    assert out.splitlines()[:4] == [str(Path("results/e/repro") / name) for name in names]
    assert "numpy==" in (written / "requirements.txt").read_text()
    assert "slamcmp run experiment.yaml" in (written / "reproduce.sh").read_text()
    before = slamcmp.load_results(folder / "results" / "e")
    again = slamcmp.run(
        written / "experiment.yaml", folder=folder / "again", executor="serial", progress=False
    )
    columns = ["seed", "label", "digest", "online_ate"]
    assert again.trials[columns].equals(before.trials[columns])
    assert again.manifest["config"]["front_end"] == before.manifest["config"]["front_end"] | {
        "range_max_m": float("inf")
    }


def test_other_code_and_versions_are_told(call: Command, folder: Path) -> None:
    results = slamcmp.load_results(folder / "results" / "e")
    results.manifest["versions"]["numpy"] = "1.0"
    results.manifest["code"]["ekf_slam"] = "0" * 64
    made = write_reproduction(results, folder / "other")
    assert not made.same
    assert {each.what for each in made.checked if not each.same} == {"numpy", "code of ekf_slam"}
    (folder / "mine.py").write_text(PLUGINS.read_text() + "\nCHANGED = 1\n")
    code, out, _ = call("repro", "e", "--json", "--output", "third")
    assert code == 1
    data = json.loads(out)
    assert [each["what"] for each in data["checked"] if not each["same"]] == ["code of mine"]
    (folder / "mine.py").unlink()
    code, out, _ = call("repro", "e", "--output", "fourth")
    assert code == 1
    assert "mine.py: is not beside" in out


def test_imported_results_have_no_experiment(call: Command, folder: Path) -> None:
    (folder / "t.txt").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 1 1 0 0 0 0 1\n")
    call("import", "trajectory", "t.txt", "--truth", "t.txt", "--as", "A", "--online", "--max-gap", "2")
    code, _, error = call("repro", "imported")
    assert (code, error.count("\n")) == (2, 1)
    assert "imported trajectories have no experiment" in error


def test_one_seed_does_not_replace_the_table_of_others(call: Command, folder: Path) -> None:
    (folder / "mine.py").write_text(PLUGINS.read_text())
    before = (folder / "results" / "e" / "manifest.json").read_bytes()
    arguments = ("run", "e.yaml", "--no-report", "--executor", "serial", "--seed")
    code, out, error = call(*arguments, "7")
    assert code == 0, error
    assert "results/e keeps the table of its seeds; this run's is results/e-seed-7" in error
    assert "results-e-seed-7" in out.replace("/", "-")
    assert (folder / "results" / "e" / "manifest.json").read_bytes() == before
    assert slamcmp.load_results(folder / "results" / "e-seed-7").trials["seed"].tolist() == [7, 7]
    # One seed of a table of one, and of none, has nothing to keep.
    assert call(*arguments, "7", "--results", "results/e-seed-7")[0] == 0
    found = slamcmp.run(folder / "e.yaml", seeds=[1, 9], executor="serial", progress=False)
    assert found.folder.name == "e-seeds-1-9"
