"""``record:`` through the public runner: a short run of the shipped experiment, with known answers."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from slamcmp.errors import UsageError
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.config.experiment import Experiment, load_experiment
from slamcmp.experiment.runner import run_experiment
from slamcmp.report.cautions import cautions
from slamcmp.results.runs.posteriors import load_posteriors
from slamcmp.results.store import Results, load_results

SHIPPED = Path(__file__).parents[2] / "experiments" / "observability.yaml"
NULLITY = {
    "EKF": 2,
    "EKF body error": 0,
    "iterated EKF": 2,
    "ideal EKF": 3,
    "FEJ EKF": 3,
    "OC EKF": 3,
    "right-invariant EKF": 3,
    "robocentric EKF": 3,
    "UKF": 2,
    "window 10": 2,
    "window 10 FEJ": 3,
    "batch": 3,
}
"""What theory says (Huang, Mourikis, Roumeliotis 2010; Zhang, Wu, Huang 2017; Dong-Si, Mourikis 2011)."""


def short(experiment: Experiment, **changes: Any) -> Experiment:
    """One lap, one seed, and GTSAM's batch solver besides."""
    source = experiment.source.with_parameter("steps", 80)
    gtsam = Component("back end", "batch", "batch", {}, "batch (GTSAM)")
    fields = {"source": source, "back_ends": (*experiment.back_ends, gtsam), "seeds": (0,), **changes}
    return replace(experiment, **fields)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    folder = tmp_path_factory.mktemp("record") / "results"
    run_experiment(short(load_experiment(SHIPPED)), folder=folder, executor="serial")
    return load_results(folder)


def by_label(results: Results) -> pd.DataFrame:
    return results.trials.set_index("label")


def test_nullity_of_every_back_end(results: Results) -> None:
    rows = by_label(results)
    assert (rows["status"] == "ok").all()
    assert rows["nullity"].dropna().astype(int).to_dict() == NULLITY


def test_correct_back_ends_gain_nothing_and_the_others_a_heading(results: Results) -> None:
    rows = by_label(results)
    correct = [label for label, nullity in NULLITY.items() if nullity == 3]
    assert (rows.loc[correct, "spurious_turn_per_rad2"] < 1e-15).all()
    assert (rows.loc[correct, "spurious_shift_per_m2"] < 1e-15).all()
    standard = [label for label, nullity in NULLITY.items() if nullity == 2]
    assert (rows.loc[standard, "spurious_turn_per_rad2"] > 1.0).all()
    # Sigma points leave their rounding.
    assert (rows.loc[standard, "spurious_shift_per_m2"] < 1e-8).all()
    assert rows.loc["EKF body error", "spurious_shift_per_m2"] > 1.0


def test_series_are_recorded_every_tenth_frame(results: Results) -> None:
    frames = results.frames
    looked_at = {*range(9, 80, 10)}
    for name in ("nullity", "spurious_turn_per_rad2", "kl_from_batch"):
        assert set(frames.loc[frames[name].notna(), "k"]) == looked_at
    ekf = frames[frames["label"] == "EKF"].set_index("k")["nullity"]
    # No landmark was seen again before the first look after the start; nothing contradicts itself then.
    assert ekf[79] == 2
    drift = by_label(results)["linearisation_drift"]
    # The price of pinned points: they lie farther from the estimate than the newest ones.
    assert drift["FEJ EKF"] > 3 * drift["EKF"] > 0
    assert drift["window 10"] < 1e-3 * drift["EKF"]


def test_divergence_vanishes_for_the_same_posterior_only(results: Results) -> None:
    """Own batch against itself, and against GTSAM's, which solves the same cost in another chart."""
    kl = by_label(results)["kl_from_batch"]
    assert kl["batch"] == pytest.approx(0.0, abs=1e-20)
    assert 0.0 <= kl["batch (GTSAM)"] < 1e-6
    assert (kl.drop(["batch", "batch (GTSAM)"]) > 1e-3).all()
    assert kl["window 10"] < kl["EKF"]


def test_divergence_falls_with_the_square_of_the_noise(tmp_path: Path) -> None:
    """Noise and prior scaled together: linearisation is all that tells a filter from the batch solution."""
    shipped = load_experiment(SHIPPED)
    names = ("EKF", "FEJ EKF", "right-invariant EKF", "robocentric EKF", "batch")
    chosen = tuple(each for each in shipped.back_ends if each.label in names)
    scales = (0.03, 0.1)
    experiment = replace(short(shipped, back_ends=chosen), sweep={"source.noise_scale": scales})
    found = run_experiment(experiment, folder=tmp_path / "r", executor="serial").trials
    kl = found.pivot(index="label", columns="source.noise_scale", values="kl_from_batch").drop("batch")
    # (0.1 / 0.03)² = 11.1; the next order leaves its trace.
    ratios = kl[0.1] / kl[0.03]
    assert ratios.between(8.0, 16.0).all(), ratios


def test_a_run_that_records_tells_no_times(results: Results) -> None:
    for name in ("update_s", "estimate_s", "final_solution_s", "peak_memory_mb", "update_median_ms"):
        assert results.trials[name].isna().all()
    assert results.frames["update_s"].isna().all()
    assert set(results.trials["record"]) == {"observability, divergence from batch"}
    assert "No times" in "; ".join(caution.title for caution in cautions(results))


def test_recording_is_part_of_the_key_and_changes_no_estimate(tmp_path: Path, plain_filters: None) -> None:
    """To rounding where filters are compiled (tests/backends/filters/test_compiled.py)."""
    shipped = load_experiment(SHIPPED)
    ekf = tuple(each for each in shipped.back_ends if each.label == "EKF")
    experiment = replace(short(shipped, back_ends=ekf), record=None)
    plain = run_experiment(experiment, folder=tmp_path / "r", executor="serial")
    assert plain.trials["update_s"].gt(0).all()
    assert "record" not in plain.trials
    recorded = run_experiment(short(shipped, back_ends=ekf), folder=tmp_path / "r", executor="serial")
    assert recorded.manifest["jobs_run"] == 1
    assert recorded.trials["online_ate"].tolist() == plain.trials["online_ate"].tolist()
    # Its batch solution was not run: there is nothing to compare with.
    assert recorded.trials["kl_from_batch"].isna().all()


def test_posteriors_of_a_damaged_file_are_none(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    assert load_posteriors(path) == []
    path.write_bytes(b"PK\x03\x04 not a zip file")
    assert load_posteriors(path) == []


def test_mistakes_are_named(tmp_path: Path) -> None:
    fields = {
        "source": {"name": "circle"},
        "back_ends": [{"name": "ekf_slam", "label": "EKF"}],
        "record": {"divergence_from": "EFK"},
    }
    path = tmp_path / "e.yaml"
    path.write_text(json.dumps(fields))
    with pytest.raises(UsageError, match="record: no back end has the label 'EFK'; did you mean 'EKF'"):
        load_experiment(path)
    path.write_text(json.dumps(fields | {"record": {"observabilty": True}}))
    with pytest.raises(UsageError, match="did you mean 'observability'"):
        load_experiment(path)
    known_too_late = {"record": {}, "until": {"metric": "kl_from_batch", "half_width": 0.1}}
    path.write_text(json.dumps(fields | known_too_late))
    with pytest.raises(UsageError, match="'kl_from_batch' is only known when all runs are compared"):
        load_experiment(path)
    path.write_text(json.dumps(fields | {"record": {"every": 0}}))
    with pytest.raises(UsageError, match="every"):
        load_experiment(path)


def test_back_ends_that_cannot_tell_are_left_alone(tmp_path: Path) -> None:
    """iSAM2 has no linear system of its own to tell about, but a posterior to compare."""
    shipped = load_experiment(SHIPPED)
    isam2 = Component("back end", "isam2", "isam2", {"relinearize_skip": 1}, "iSAM2")
    batch = tuple(each for each in shipped.back_ends if each.label == "batch")
    found = run_experiment(
        short(shipped, back_ends=(isam2, *batch)), folder=tmp_path / "r", executor="serial"
    )
    row = by_label(found).loc["iSAM2"]
    assert row["status"] == "ok"
    assert math.isnan(row["nullity"])
    assert np.isfinite(row["kl_from_batch"])
