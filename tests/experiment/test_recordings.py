"""Several recordings as the paired samples, and samples that are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.planning.trials import make_trials
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.partial import missing_runs
from slamcmp.results.store import load_results


def drive(path: Path, seed: int) -> None:
    """A graph file of twenty steps past one landmark."""
    rng = np.random.default_rng(seed)
    lines = []
    for k in range(20):
        if k:
            x, y, theta = rng.normal([1, 0, 0.02], 0.01)
            lines.append(f"EDGE_SE2 {k - 1} {k} {x!r} {y!r} {theta!r} 10000 0 0 10000 0 10000")
        lines.append(
            f"EDGE_SE2_XY {k} 100 {10 - k + rng.normal(0, 0.1)!r} {3 + rng.normal(0, 0.1)!r} 100 0 100"
        )
    path.write_text("\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n")


def experiment_file(folder: Path, source: str, more: str = "") -> Path:
    path = folder / "mine.yaml"
    path.write_text(
        f"source: {source}\nreference: batch\n{more}"
        "back_ends: [{name: batch}, {name: ekf_slam}, {name: dead_reckoning}]\n"
    )
    return path


@pytest.fixture
def three(tmp_path: Path) -> Path:
    for seed, name in enumerate("abc"):
        drive(tmp_path / f"{name}.g2o", seed)
    return tmp_path


def test_recordings_are_the_paired_samples(three: Path) -> None:
    path = experiment_file(three, "{name: graph_file, path: [a.g2o, b.g2o, c.g2o]}")
    experiment = load_experiment(path)
    trials = make_trials(experiment)
    assert [(trial.recording, trial.seed, dict(trial.swept)) for trial in trials] == [
        ("a.g2o", 0, {}),
        ("b.g2o", 1, {}),
        ("c.g2o", 2, {}),
    ]
    assert [trial.stream.source.arguments()["path"] for trial in trials] == [
        str(three / f"{name}.g2o") for name in "abc"
    ]
    # What the manifest keeps says the same again.
    assert experiment.as_dict()["source"]["path"] == ["a.g2o", "b.g2o", "c.g2o"]

    results = run_experiment(path, folder=three / "r", jobs=1)
    assert len(results.trials) == 9
    assert (results.trials["status"] == "ok").all()
    assert results.manifest["recordings"] == ["a.g2o", "b.g2o", "c.g2o"]
    assert results.manifest["seeds"] == []
    assert missing_runs(results) is None
    lost = results.trials[(results.trials["seed"] != 1) | (results.trials["label"] != "batch")]
    missing = missing_runs(replace(results, trials=lost))
    assert missing is not None
    assert missing.sentence() == (
        "not complete: 1 of 9 runs are missing (batch: b.g2o); back ends are compared on the 2 of 3 trials "
        "that all of them have"
    )
    by_recording = results.trials.groupby("recording")["digest"].nunique()
    assert by_recording.to_dict() == {"a.g2o": 1, "b.g2o": 1, "c.g2o": 1}
    assert results.trials["digest"].nunique() == 3
    # Each alone has the same scores as among the three.
    alone = run_experiment(
        experiment_file(three, "{name: graph_file, path: b.g2o}"), folder=three / "alone", jobs=1
    ).trials
    assert "recording" not in alone
    among = results.trials[results.trials["recording"] == "b.g2o"]
    for name in ("online_ate", "final_ate", "landmark_rmse"):
        np.testing.assert_array_equal(among[name], alone[name])


def test_recordings_stand_beside_a_sweep(three: Path) -> None:
    path = experiment_file(
        three,
        "{name: graph_file, path: [a.g2o, b.g2o]}",
        "sweep: {source.steps: [5, 10]}\n",
    )
    trials = make_trials(load_experiment(path))
    assert [(trial.swept["source.steps"], trial.recording) for trial in trials] == [
        (5, "a.g2o"),
        (5, "b.g2o"),
        (10, "a.g2o"),
        (10, "b.g2o"),
    ]


@pytest.mark.parametrize(
    ("source", "more", "message"),
    [
        ("{name: graph_file, path: [a.g2o, a.g2o]}", "", r"1:\d+: path: a\.g2o stands twice"),
        ("{name: graph_file, path: [a.g2o, 3]}", "", r"1:\d+: path: the name of a file or folder, not 3"),
        (
            "{name: graph_file, path: [a.g2o, b.g2o]}",
            "seeds: 3\n",
            "it takes no seed; leave it out",
        ),
        (
            "{name: graph_file, path: [a.g2o, b.g2o]}",
            "sweep: {source.path: [a.g2o, c.g2o]}\n",
            "source.path names recordings already",
        ),
        (
            "{name: image_folder, folder: [a, b], rate_hz: 1.0}",
            "seeds: 3\n",
            "the source's recordings are the samples; leave seeds out",
        ),
        (
            "{name: image_folder, folder: [a, b], rate_hz: 1.0}",
            "until: {metric: online_ate, half_width: 0.1}\n",
            "there are no more to add",
        ),
        ("{name: graph_file, path: [], steps: 3}", "", "path: "),
        ("{name: graph_file, path: [a.g2o, b.g2o], steps: [3, 4]}", "", "steps: "),
    ],
)
def test_what_is_no_list_of_recordings(three: Path, source: str, more: str, message: str) -> None:
    with pytest.raises(SlamcmpError, match=message):
        load_experiment(experiment_file(three, source, more))


def test_copies_of_one_recording_are_one_sample(three: Path) -> None:
    (three / "b.g2o").write_text((three / "a.g2o").read_text())
    path = experiment_file(three, "{name: graph_file, path: [a.g2o, b.g2o]}")
    with pytest.raises(
        UsageError, match=r"recordings 'a\.g2o' and 'b\.g2o' are one and the same stream"
    ) as caught:
        run_experiment(path, folder=three / "r", jobs=1)
    assert caught.value.exit_code == 1
    rows = load_results(three / "r").trials.groupby("recording")["status"].agg(list).to_dict()
    assert rows == {"a.g2o": ["ok"] * len(rows["a.g2o"]), "b.g2o": ["missing"] * 3}


SOURCE = """
from slamcmp.datasets.graphs.graph_file import graph_file


def recorded(seed=0, *, steps: int = 20):
    return graph_file(path=__file__.replace("own.py", "a.g2o"), steps=steps)
"""


def test_twelve_seeds_of_one_recording_are_no_twelve_samples(three: Path) -> None:
    (three / "own.py").write_text(SOURCE)
    path = experiment_file(three, "{name: 'own.py:recorded'}", "seeds: 3\n")
    with pytest.raises(
        UsageError, match=r"'own\.py:recorded' makes one and the same stream .* of seeds 0 and 1"
    ):
        run_experiment(path, folder=three / "r", jobs=1)
    # No more is run than had begun when the second stream was made.
    assert len(list((three / "r" / "runs").glob("*.npz"))) <= 4
    # What had run is a partial result, not a lost one; the second seed's rows say what is wrong.
    told = load_results(three / "r")
    assert told.manifest["jobs_missing"] >= 3
    rows = told.trials.set_index("seed")
    assert set(rows.loc[[0], "status"]) == {"ok"}
    assert rows.loc[[1], "status"].tolist() == ["missing"] * 3
    assert rows.loc[1, "message"].unique().tolist() == ["no sample of its own: seed 0 has this very stream"]
    one = run_experiment(
        experiment_file(three, "{name: 'own.py:recorded'}", "sweep: {source.steps: [5, 20]}\n"),
        folder=three / "r",
        jobs=1,
    )
    assert (one.trials["status"] == "ok").all()
