"""Experiments from a program: mappings, classes, mistakes, results that are found again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import slamcmp
from slamcmp.registry import back_ends
from tests.api.conftest import WORLD, Reckoner


def test_a_mapping_a_file_and_an_experiment_give_the_same_numbers(here: Path) -> None:
    content = {"name": "small", "source": WORLD, "back_ends": [{"name": "ekf_slam"}], "seeds": [4]}
    (here / "small.yaml").write_text(json.dumps(content))
    options: dict[str, Any] = {"executor": "serial", "progress": False}
    mapping = slamcmp.run(content, folder=here / "mapping", **options)
    file = slamcmp.run("small.yaml", folder=here / "file", **options)
    checked = slamcmp.run(slamcmp.load_experiment("small.yaml"), folder=here / "checked", **options)
    timeless = [name for name in mapping.trials if not name.endswith(("_s", "_ms", "_mb"))]
    for other in (file, checked):
        pd.testing.assert_frame_equal(mapping.trials[timeless], other.trials[timeless])
    assert mapping.manifest["config_file"] is None
    pd.testing.assert_frame_equal(slamcmp.load_results(here / "mapping").trials, mapping.trials)


def test_a_shipped_experiment_goes_by_its_name(here: Path) -> None:
    with pytest.raises(slamcmp.MissingDataError, match="did you mean 'quickstart'"):
        slamcmp.run("quickstrat")


def test_numpy_values_tuples_ranges_and_paths_are_plain_values(here: Path, ran: Any) -> None:
    results = slamcmp.run(
        {
            "source": {**WORLD, "range_sigma_m": np.float64(0.1), "steps": np.int64(10)},
            "back_ends": ("ekf_slam",),
            "seeds": range(2),
            "sweep": {"source.landmarks": np.array([5, 6])},
        },
        executor="serial",
        progress=False,
    )
    assert results.manifest["config"]["source"]["steps"] == 10
    assert results.trials["source.landmarks"].tolist() == [5, 5, 6, 6]


def test_without_a_name_the_content_has_a_folder_of_its_own(here: Path, ran: Any) -> None:
    first = ran(["dead_reckoning"], executor="serial")
    again = ran(["dead_reckoning"], executor="serial")
    other = ran(["dead_reckoning"], executor="serial", seeds=2)
    assert first.folder == again.folder != other.folder
    assert first.folder.parent == here / "results"
    assert again.manifest["jobs_run"] == 0
    pd.testing.assert_frame_equal(slamcmp.load_results(first.folder.name).trials, again.trials)


def test_a_class_of_this_process_runs_beside_worker_processes(
    here: Path, ran: Any, local_class: type, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = [local_class, {"name": local_class, "label": "stretched", "scale": 1.1}, "dead_reckoning"]
    results = ran(entries, progress=True)
    rows = results.trials.set_index("label")
    assert rows.index.tolist() == ["Cell", "stretched", "dead_reckoning"]
    assert set(rows["status"]) == {"ok"}
    assert rows.loc["Cell", "online_ate"] == pytest.approx(
        rows.loc["dead_reckoning", "online_ate"], rel=1e-12
    )
    assert rows.loc["stretched", "online_ate"] > 2 * rows.loc["Cell", "online_ate"]
    told = capsys.readouterr().err
    assert "Cell: in this process, without a memory limit, and anew each time" in told
    assert set(results.manifest["in_session"]) == {"Cell", "stretched"}
    assert "class Reckoner" in ran([Reckoner], executor="serial").manifest["in_session"]["Reckoner"]


def test_what_another_definition_of_the_class_gave_is_never_taken_over(
    here: Path, ran: Any, local_class: type
) -> None:
    first = ran([local_class, "dead_reckoning"], folder=here / "same").trials.set_index("label")
    local_class.update = lambda self, frame: None  # as a second run of an edited cell
    second = ran([local_class, "dead_reckoning"], folder=here / "same")
    rows = second.trials.set_index("label")
    assert rows.loc["Cell", "online_ate"] > 2 * first.loc["Cell", "online_ate"]
    assert second.manifest["jobs_reused"] == 1
    assert not [file for file in (here / "same").glob("*/*") if "session" in file.name]


def test_a_registered_class_goes_by_its_name_and_is_reused(here: Path, ran: Any) -> None:
    results = ran([back_ends.get("dead_reckoning").target])
    assert results.trials["label"].tolist() == ["dead_reckoning"]
    assert results.manifest["in_session"] == {}
    assert ran(["dead_reckoning"], folder=results.folder).manifest["jobs_reused"] == 1


def test_a_name_registered_in_this_process_is_run_here(
    here: Path, ran: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    back_ends.names()
    monkeypatch.setattr(back_ends, "_plugins", dict(back_ends._plugins))
    back_ends.register("told_the_truth", needs_truth=True)(_Told)
    results = ran(["told_the_truth"])
    assert results.trials["status"].tolist() == ["ok"], results.trials["message"].tolist()
    assert list(results.manifest["in_session"]) == ["told_the_truth"]


class _Told(Reckoner):
    def __init__(self, problem: slamcmp.Problem, truth: slamcmp.GroundTruth) -> None:
        super().__init__(problem)
        assert isinstance(truth, slamcmp.GroundTruth)


def test_a_class_that_fails_is_a_row_like_any_other(here: Path, ran: Any, local_class: type) -> None:
    def broken(self: Any, frame: slamcmp.Frame) -> None:
        raise ZeroDivisionError("on purpose")

    local_class.update = broken
    results = ran([local_class, "dead_reckoning"])
    assert results.trials["status"].tolist() == ["crashed", "ok"]
    assert "frame 0: ZeroDivisionError: on purpose" in results.trials["message"][0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"sedes": 3}, "experiment['sedes']: unknown key 'sedes'; did you mean 'seeds'?"),
        (
            {"source": {**WORLD, "landmark": 3}},
            "experiment['source']['landmark']: unknown key 'landmark'; did you mean 'landmarks'?",
        ),
        (
            {"back_ends": ["ekf_slam", {"name": "isam2", "relinearise_skip": 1}]},
            "experiment['back_ends'][1]['relinearise_skip']: unknown key 'relinearise_skip'; did you mean "
            "'relinearize_skip'?",
        ),
        (
            {"back_ends": [{"name": Reckoner, "scall": 2.0}]},
            "experiment['back_ends'][0]['scall']: unknown key 'scall'; did you mean 'scale'?",
        ),
        (
            {"back_ends": ["ekf_slma"]},
            "experiment['back_ends'][0]['name']: unknown back end 'ekf_slma'; did you mean 'ekf_slam'?",
        ),
        (
            {"sweep": {"source.landmark": [3]}},
            "experiment['sweep']['source.landmark']: sweep: source 'circle' has no parameter 'landmark'; did "
            "you mean 'landmarks'?",
        ),
        ({"seeds": "three"}, "experiment['seeds']: seeds: input should be"),
        ({"back_ends": [Reckoner, Reckoner]}, "experiment['back_ends'][1]: label 'Reckoner' is taken"),
    ],
)
def test_a_mistake_is_told_with_its_place_as_in_a_file(here: Path, change: dict[str, Any], told: str) -> None:
    content = {"source": WORLD, "back_ends": ["ekf_slam"], **change}
    with pytest.raises(slamcmp.UsageError) as error:
        slamcmp.run(content)
    assert told in str(error.value)


def test_all_mistakes_are_told_at_once_in_the_order_written(here: Path) -> None:
    with pytest.raises(slamcmp.UsageError) as error:
        slamcmp.run({"back_ends": ["nobody"], "source": {"name": "circel"}, "sede": 2})
    lines = str(error.value).splitlines()
    assert [line.partition(": ")[0] for line in lines] == [
        "experiment['back_ends'][0]['name']",
        "experiment['source']['name']",
        "experiment['sede']",
    ]


def test_worker_processes_are_refused_for_what_they_cannot_import(
    here: Path, ran: Any, local_class: type
) -> None:
    with pytest.raises(slamcmp.UsageError, match="Cell is known to this process only"):
        ran([local_class], executor="processes")


@pytest.mark.parametrize("wrong", [3, None, Reckoner, ["quickstart"]])
def test_what_is_no_experiment_is_told(wrong: Any) -> None:
    with pytest.raises(slamcmp.UsageError, match="an experiment is a file, a shipped name, a mapping"):
        slamcmp.run(wrong)


@pytest.mark.parametrize(
    ("seeds", "used"), [(2, [0, 1]), ([7, 3], [7, 3]), (np.arange(2, 4), [2, 3]), (range(1), [0])]
)
def test_seeds_in_place_of_the_experiments_own(here: Path, seeds: Any, used: list[int]) -> None:
    content = {"source": WORLD, "back_ends": ["dead_reckoning"], "seeds": 9}
    results = slamcmp.run(content, seeds=seeds, executor="serial", progress=False)
    assert results.trials["seed"].tolist() == used


@pytest.mark.parametrize(
    "options",
    [{"seeds": seeds} for seeds in (0, -1, [], [1, 1], [-1], "3", 1.5, True, [0.5])]
    + [{"jobs": jobs} for jobs in (0, -2, "2", 1.5, True)],
)
def test_options_out_of_range_are_told(here: Path, options: dict[str, Any]) -> None:
    (name,) = options
    with pytest.raises(slamcmp.UsageError, match=f"run: {name} is "):
        slamcmp.run({"source": WORLD, "back_ends": ["dead_reckoning"]}, **options)


def test_an_object_is_no_class(here: Path, ran: Callable[..., Any]) -> None:
    problem = slamcmp.make_stream("circle", steps=3, landmarks=3).problem
    with pytest.raises(slamcmp.UsageError, match="hand over the class"):
        slamcmp.run_back_end(Reckoner(problem), slamcmp.make_stream("circle", steps=3, landmarks=3))
