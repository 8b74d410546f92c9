"""Keys: they follow what computes a result, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcmp.errors import MissingDataError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.content_key import data_files
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.experiment.runner import run_experiment
from slamcmp.registry import sources
from slamcmp.support.provenance.code_version import PACKAGE, import_closure


def test_closure_of_a_back_end_holds_its_models_and_no_other_back_end() -> None:
    names = {
        str(path.relative_to(PACKAGE))
        for path in import_closure([PACKAGE / "backends" / "filters" / "ekf_slam.py"])
    }
    assert {"backends/filters/ekf_slam.py", "types/stream.py", "geometry.py", "registry.py"} <= names
    assert not any("gtsam" in name or "isam2" in name or name.startswith("report") for name in names)


def test_what_reports_is_no_part_of_what_computes() -> None:
    reached = import_closure([PACKAGE / "experiment" / "job" / "worker.py"])
    names = {path.name for path in reached}
    assert {"run_back_end.py", "worker.py", "run_file.py"} <= names
    assert not names & {"runner.py", "cli.py", "progress.py", "store.py", "processes.py"}


def keys(path: Path) -> tuple[str, list[str]]:
    (trial,) = make_trials(load_experiment(path))
    return trial.stream.key, [job.key for job in trial.runs]


def test_keys_follow_parameters_but_not_labels(write_experiment) -> None:
    both = [{"name": "DeadReckoning", "at": 3}, "Hindsight"]
    stream, runs = keys(write_experiment(back_ends=both))
    renamed = [{"name": "DeadReckoning", "at": 3, "label": "mine"}, "Hindsight"]
    assert keys(write_experiment(back_ends=renamed)) == (stream, runs)
    changed = [{"name": "DeadReckoning", "at": 4}, "Hindsight"]
    assert keys(write_experiment(back_ends=changed))[0] == stream
    assert keys(write_experiment(back_ends=changed))[1][0] != runs[0]
    assert keys(write_experiment(back_ends=changed))[1][1] == runs[1]
    other_seed, other_runs = keys(write_experiment(back_ends=both, seeds=[1]))
    assert other_seed != stream
    assert not set(other_runs) & set(runs)
    # A default that is spelt out is the same experiment.
    spelt = [{"name": "DeadReckoning", "at": 3, "pause_s": 0.0}, "Hindsight"]
    assert keys(write_experiment(back_ends=spelt)) == (stream, runs)


def test_keys_follow_the_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "log.txt"
    data.write_text("1")
    plugin = sources.get("victoria_park")
    monkeypatch.setitem(plugin.traits, "files", lambda **_: [data])
    path = tmp_path / "e.yaml"
    path.write_text("source: {name: victoria_park}\nback_ends: [{name: ekf_slam}]\n")
    first = keys(path)
    data.write_text("22")
    assert keys(path)[0] != first[0]
    data.unlink()
    with pytest.raises(MissingDataError, match=r"log\.txt"):
        keys(path)


def test_keys_follow_each_of_two_files_of_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the left and the right image of an instant have."""
    images = [tmp_path / "left" / "0.png", tmp_path / "right" / "0.png"]
    for image in images:
        image.parent.mkdir()
        image.write_text("1")
    monkeypatch.setitem(sources.get("victoria_park").traits, "files", lambda **_: images)
    path = tmp_path / "e.yaml"
    path.write_text("source: {name: victoria_park}\nback_ends: [{name: ekf_slam}]\n")
    seen = {keys(path)[0]}
    for image in images:
        image.write_text("22")
        seen.add(keys(path)[0])
    assert len(seen) == 3
    assert set(data_files(load_experiment(path).source).digests) == {"left/0.png", "right/0.png"}


def test_a_folder_of_data_is_found_beside_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    path = tmp_path / "e.yaml"
    path.write_text(
        "source: {name: kitti_odometry, folder: drive}\nfront_end: {name: tracked_features}\n"
        "back_ends: [{name: ekf_slam}]\n",
        encoding="utf-8",
    )
    source = load_experiment(path).source
    assert source.parameters["folder"] == "drive"
    assert source.arguments()["folder"] == str(tmp_path / "drive")


def test_graph_file_is_found_beside_the_experiment_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside, here = tmp_path / "experiments", tmp_path / "here"
    for folder, x in ((beside, "1"), (here, "2")):
        (folder / "data").mkdir(parents=True)
        (folder / "data" / "my.g2o").write_text(f"EDGE_SE2 0 1 {x} 0 0 1 0 0 1 0 1\n")
    monkeypatch.chdir(here)
    path = beside / "e.yaml"
    path.write_text("source: {name: graph_file, path: data/my.g2o}\nback_ends: [{name: ekf_slam}]\n")
    first = load_experiment(path).source
    assert first.parameters["path"] == "data/my.g2o"
    assert first.arguments()["path"] == str(beside / "data" / "my.g2o")
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).frames["online_x"][1] == 1.0
    in_both = keys(path)
    (beside / "data" / "my.g2o").unlink()
    assert keys(path) != in_both
    assert run_experiment(path, folder=tmp_path / "r", jobs=1).frames["online_x"][1] == 2.0
    (here / "data" / "my.g2o").unlink()
    with pytest.raises(MissingDataError) as caught:
        keys(path)
    for place in (beside, here, "gtsam/Data"):
        assert str(place) in str(caught.value)
    path.write_text("source: {name: graph_file, path: w100.graph}\nback_ends: [{name: ekf_slam}]\n")
    assert len(keys(path)[1]) == 1
