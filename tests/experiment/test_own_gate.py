"""Experiments whose back ends gate for themselves: from the file to the tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from slamcmp.experiment.job.make_stream import make_stream, truth_of_stream
from slamcmp.experiment.job.task import truth_path
from slamcmp.experiment.runner import run_experiment
from slamcmp.results.runs.run_file import StoredRun, load_run, load_truth, save_run
from slamcmp.types import MeasurementStream, Run, Trajectory

SOURCE = {"name": "circle", "steps": 60, "landmarks": 20, "outlier_fraction": 0.15}
FRONT_END = {"name": "labelled", "gate_probability": None, "range_max_m": 6.0}


def spoilt_stream() -> tuple[MeasurementStream, tuple[np.ndarray, ...]]:
    settings = {key: value for key, value in SOURCE.items() if key != "name"}
    stream, log = make_stream(
        ("circle", settings), ("labelled", {"gate_probability": None, "range_max_m": 6.0}), 0
    )
    truth = truth_of_stream(log.truth, stream)
    assert truth is not None
    assert truth.outliers is not None
    return stream, truth.outliers


def test_outliers_are_told_of_the_streams_observations() -> None:
    """Unspoilt ones lie within six sigma of the truth, nearly all spoilt ones do not."""
    stream, outliers = spoilt_stream()
    _, log = make_stream(("circle", {k: v for k, v in SOURCE.items() if k != "name"}), ("labelled", {}), 0)
    assert log.truth is not None
    sensor, far = stream.problem.sensor, {True: 0, False: 0}
    # The range limit removed detections: the masks are not the log's.
    assert sum(mask.size for mask in outliers) < sum(each.ids.size for each in log.detections)
    for frame, mask, T in zip(stream.frames, outliers, log.truth.T_world_body, strict=True):
        assert mask.size == frame.ids.size
        y = sensor.residual(frame.z, sensor.predict(T, log.truth.positions[frame.ids]))
        distances = np.einsum("mi,mij,mj->m", y, np.linalg.inv(frame.R), y)
        for bad, distance in zip(mask.tolist(), distances.tolist(), strict=True):
            far[bad] += distance > 36
    assert far[False] == 0
    assert far[True] > 0.9 * sum(int(mask.sum()) for mask in outliers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gates") / "gates.yaml"
    back_ends = [
        {"name": "ekf_slam"},
        {"name": "ekf_slam", "own_gate": 0.999},
        {"name": "ekf_ideal", "label": "ideal", "own_gate": 0.999},
    ]
    path.write_text(json.dumps({"source": SOURCE, "front_end": FRONT_END, "back_ends": back_ends}))
    return run_experiment(path, folder=path.parent / "results", executor="serial").folder


def test_tables_say_who_gated_and_what_that_did(folder: Path) -> None:
    from slamcmp.results.store import load_results

    results = load_results(folder)
    trials = results.trials.set_index("label")
    assert trials["digest"].nunique() == 1
    gates = trials["own_gate"]
    assert np.isnan(gates["ekf_slam"])
    assert gates[["ekf_slam, own gate", "ideal"]].tolist() == [0.999, 0.999]
    assert np.isnan(trials.loc["ekf_slam", "gate_recall"])

    _, outliers = spoilt_stream()
    for label in ("ekf_slam, own gate", "ideal"):
        frames = results.frames[results.frames["label"] == label]
        spoilt = np.array([mask.sum() for mask in outliers])
        correct = np.array([(~mask).sum() for mask in outliers])
        assert np.array_equal(frames["gate_correct"], correct)
        # Every rejection is a correct observation or an outlier that was not missed.
        caught = spoilt - frames["gate_missed"]
        assert np.array_equal(frames["gate_rejected"], frames["gate_false_rejections"] + caught)
        recall = 1 - frames["gate_false_rejections"].sum() / correct.sum()
        assert trials.loc[label, "gate_recall"] == pytest.approx(recall)
    # What the outliers cost the filter that takes all: measured 10.7 m to 0.14 m.
    assert trials.loc["ekf_slam", "online_ate"] > 5 * trials.loc["ekf_slam, own gate", "online_ate"]
    totals = results.manifest["front_end_totals"]
    assert totals["outliers kept"] == sum(int(mask.sum()) for mask in outliers)
    assert totals["outliers"] > totals["outliers kept"]


def test_masks_survive_their_files(folder: Path, tmp_path: Path) -> None:
    _, outliers = spoilt_stream()
    runs = [load_run(path) for path in sorted((folder / "runs").glob("*.npz"))]
    masks = [run.run.kept_observations for run in runs if run is not None]
    assert sum(mask is None for mask in masks) == 1
    for mask in masks:
        assert mask is None or [each.size for each in mask] == [each.size for each in outliers]
    (truth_file,) = (folder / "streams").glob("*.truth.npz")
    known = load_truth(truth_path(folder, truth_file.name.removesuffix(".truth.npz")))
    assert known is not None
    assert known.truth is not None
    assert known.truth.outliers is not None
    assert all(np.array_equal(a, b) for a, b in zip(known.truth.outliers, outliers, strict=True))

    nothing = np.empty(0)
    run = Run(
        "a", {}, "d", 0, 3, "crashed", "at once", Trajectory(nothing, np.empty((0, 3, 3))), nothing, nothing
    )
    for kept in ((), (np.array([True, False]),), (np.array([], dtype=bool), np.array([True]))):
        save_run(StoredRun(Run(**{**vars(run), "kept_observations": kept}), {}, 0.0), tmp_path / "run.npz")
        again = load_run(tmp_path / "run.npz")
        assert again is not None
        assert [each.tolist() for each in again.run.kept_observations] == [each.tolist() for each in kept]
