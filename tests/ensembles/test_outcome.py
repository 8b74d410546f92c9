"""Numbers of many runs, their standard errors, what an interruption leaves, and the command line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from slamcmp.ensembles.ensemble import ensemble_in_steps, run_ensemble
from slamcmp.ensembles.kernels import settings as at
from slamcmp.ensembles.outcome import BATCHES, Ensemble, FilterRuns
from slamcmp.ensembles.problem import ensemble_problem
from slamcmp.ensembles.published import judge_ensemble
from slamcmp.ensembles.stored import RUNS, ensemble_key, load_ensemble, save_ensemble
from slamcmp.errors import UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.shipped import find_experiment
from slamcmp.frontend.stream_file import load_stream
from slamcmp.results.judgements.published import Published
from tests.command import Command
from tests.ensembles.worlds import SOURCE, experiment, problem


def made_up(label: str, generator: np.random.Generator, squares: np.ndarray, frames: int = 30) -> FilterRuns:
    """Runs whose squared position error at each frame is given, (runs, frames)."""
    runs = len(squares)
    scores = generator.random((runs, at.SCORES))
    scores[:, at.SQUARED_POSITION] = squares.mean(axis=1)
    batch = np.arange(runs) % BATCHES
    curves = np.zeros((BATCHES, frames, 2))
    np.add.at(curves[:, :, 0], batch, squares)
    counts = np.bincount(batch, minlength=BATCHES)
    return FilterRuns(label, scores, curves, counts, np.full(runs, -1))


def test_standard_errors_are_the_spread_over_repetitions() -> None:
    """Of 300 ensembles of 400 runs: what each says of its own error, against how far they lie apart.

    The spread of 300 numbers is known to 4 %, 12 % is three times that.
    """
    generator = np.random.default_rng(0)
    values, told = [], []
    for _ in range(300):
        run_level = generator.gamma(2.0, 1.0, (400, 1))
        squares = run_level * generator.exponential(1.0, (400, 30)) * np.linspace(0.5, 2.0, 30)
        metrics = made_up("a", generator, squares).metrics()
        picked = [metrics[name] for name in ("ensemble_position_rmse", "ensemble_mean_position_rmse")]
        values.append([each.value for each in picked])
        told.append([each.standard_error for each in picked])
    np.testing.assert_allclose(np.mean(told, axis=0), np.std(values, axis=0, ddof=1), rtol=0.12)


def test_the_interval_of_a_ratio_holds_the_truth_in_95_of_100() -> None:
    """Paired runs with a true ratio of 0.9; of 400 intervals 380 are expected, 5 sigma are 22."""
    generator = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        shared = generator.gamma(2.0, 1.0, (300, 1))
        first = np.tile(shared, (1, 2))
        other = 0.81 * np.tile(shared * generator.gamma(4.0, 0.25, (300, 1)), (1, 2))
        runs = tuple(made_up(name, generator, each, 2) for name, each in (("a", first), ("b", other)))
        ratio = Ensemble(None, runs).ratios()["b"]  # type: ignore[arg-type]
        inside += ratio.low <= 0.9 <= ratio.high
    assert abs(inside - 380) <= 22


def test_metrics_are_those_of_the_runs(tmp_path: Path) -> None:
    found = run_ensemble(problem(tmp_path, back_ends=["ekf_slam"]), 170)
    (runs,) = found.runs
    metrics = runs.metrics()
    assert metrics["ensemble_position_rmse"].value == pytest.approx(np.sqrt(runs.scores[:, 0].mean()))
    over_time = runs.rmse_over_time()
    assert np.sqrt((over_time[:, 0] ** 2).mean()) == pytest.approx(metrics["ensemble_position_rmse"].value)
    assert over_time[:, 0].mean() == pytest.approx(metrics["ensemble_mean_position_rmse"].value)
    assert math.degrees(over_time[:, 1].mean()) == pytest.approx(
        metrics["ensemble_mean_heading_rmse_deg"].value
    )


def test_workers_and_steps_change_no_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of = problem(tmp_path, back_ends=["ekf_slam", "ekf_oc"])
    whole = run_ensemble(of, 230, workers=2)
    monkeypatch.setattr("slamcmp.ensembles.ensemble.STEP", 100)
    steps = list(ensemble_in_steps(of, 230, workers=1, compared=0))
    assert [each.seeds for each in steps] == [100, 200, 230]
    for a, b in zip(whole.runs, steps[-1].runs, strict=True):
        np.testing.assert_array_equal(a.scores, b.scores)
        np.testing.assert_allclose(a.curves, b.curves, rtol=1e-12)
        np.testing.assert_array_equal(a.runs_of_batch, b.runs_of_batch)


def test_it_goes_on_from_what_is_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamcmp.ensembles.ensemble.STEP", 50)
    of = problem(tmp_path, back_ends=["ekf_slam", "ekf_right_invariant"])
    whole = run_ensemble(of, 120)
    half = next(iter(ensemble_in_steps(of, 120)))
    save_ensemble(half, tmp_path / "out", {})
    before = load_ensemble(of, tmp_path / "out")
    assert before is not None
    assert before.seeds == 50
    *_, found = ensemble_in_steps(of, 120, before=before)
    np.testing.assert_array_equal(found.runs[1].scores, whole.runs[1].scores)
    np.testing.assert_array_equal(found.runs[1].curves, whole.runs[1].curves)
    # Other worlds, other filters and damaged files are not gone on from.
    other = problem(tmp_path, {"position_sigma_m": 0.2}, ["ekf_slam", "ekf_right_invariant"])
    assert ensemble_key(other) != ensemble_key(of)
    assert load_ensemble(other, tmp_path / "out") is None
    (tmp_path / "out" / RUNS).write_bytes((tmp_path / "out" / RUNS).read_bytes()[:-200])
    assert load_ensemble(of, tmp_path / "out") is None


@pytest.mark.parametrize(
    ("source", "keys", "told"),
    [
        ({"name": "random"}, {}, "ensembles run in the world 'circle', and the source is 'random'"),
        ({"odometry": "unicycle"}, {}, "source.odometry is 'unicycle'"),
        ({"outlier_fraction": 0.1}, {}, "ensembles have no outliers"),
        ({"slip_probability": 0.1}, {}, "ensembles have no outliers"),
        ({}, {"front_end": {"name": "labelled"}}, "gate_probability: null"),
        ({}, {"front_end": {"name": "labelled", "gate_probability": None, "range_max_m": 3}}, "in source"),
        ({}, {"sweep": {"source.landmarks": [5, 6]}}, "sweeps source.landmarks"),
        ({}, {"back_ends": [{"name": "isam2"}]}, "none of its back ends has a program"),
        ({}, {"back_ends": [{"name": "ekf_slam", "robust": "huber"}]}, "not with robust: huber"),
    ],
)
def test_what_has_no_program_is_refused(tmp_path: Path, source, keys, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        ensemble_problem(experiment(tmp_path, source, **keys))


@pytest.mark.parametrize("name", ["anchors/p1", "anchors/p2", "anchors/p3"])
def test_the_published_experiments_have_a_program(name: str) -> None:
    of = ensemble_problem(load_experiment(find_experiment(name)))
    assert {each.component.name for each in of.filters} >= {"ekf_slam", "ekf_right_invariant"}
    assert not of.own_maps
    assert of.most < len(of.landmarks)


def test_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slamcmp = Command(tmp_path, monkeypatch, capsys)
    experiment(tmp_path, back_ends=["ekf_slam", "ekf_oc", "isam2"])
    few = ("ensemble", "small.yaml", "--seeds", "20")
    code, out, err = slamcmp(*few, "--samples", "2", "--target", "cpu")
    assert code == 0, err
    assert "left out: isam2: isam2 has no program" in err
    assert "position RMSE over ekf_slam's" in out
    stream = load_stream(tmp_path / "results" / "small-ensemble" / "stream-1.npz")
    assert len(stream.frames) == SOURCE["steps"]
    table = json.loads((tmp_path / "results" / "small-ensemble" / "ensemble.json").read_text())
    assert table["seeds"] == 20
    assert [row["runs"] for row in table["filters"]] == [20, 20]
    assert all(row["deviation_from_back_end"] < 1e-9 for row in table["filters"])
    code, out, err = slamcmp(*few, "--target", "cpu", "--json")
    assert json.loads(out)["filters"] == table["filters"]
    code, out, err = slamcmp(*few, "--target", "cuda")
    assert code == 2
    assert "no ensemble on a GPU" in err


def test_a_publication_is_judged_pair_by_pair() -> None:
    """Of 2000 runs: b is 20 % worse than a, c is b with other noise, d is 20 % better than c."""
    generator = np.random.default_rng(3)
    shared = generator.gamma(2.0, 1.0, (2000, 1))
    factors = {"a": 1.0, "b": 1.44, "c": 1.44, "d": 1.0}
    runs = tuple(
        made_up(name, generator, np.tile(factor * shared * generator.gamma(4.0, 0.25, (2000, 1)), (1, 5)), 5)
        for name, factor in factors.items()
    )
    found = Ensemble(None, runs)  # type: ignore[arg-type]
    rmse = runs[0].metrics()["ensemble_position_rmse"].value
    orders = [["a", "b"], ["b", "c"], ["b", "a"], ["a", "gone", "b"], ["a", "gone"]]
    published = Published.model_validate(
        {
            "source": "nobody",
            "tolerance": {"ensemble_position_rmse": 0.1},
            "rows": [
                {"label": "a", "values": {"ensemble_position_rmse": rmse * 1.05, "online_ate": 1.0}},
                {"label": "b", "values": {"ensemble_position_rmse": rmse}},
                {"label": "gone", "values": {"ensemble_position_rmse": rmse}},
            ],
            "order": [
                {"metric": metric, "labels": labels}
                for metric in ("ensemble_position_rmse", "ensemble_mean_position_rmse")
                for labels in orders
            ]
            + [{"metric": "ensemble_position_rmse", "labels": ["a", "b"], "worst_factor": 1.5}],
        }
    )
    verdict = judge_ensemble(found, published)
    assert [each.verdict for each in verdict.values] == ["inside", "not measured", "outside"]
    four = ["held", "tie", "violated", "held"]
    assert [each.verdict for each in verdict.orders] == [*four, *four, "violated"]
    assert verdict.orders[0].pairs[0].ratio.estimate == pytest.approx(1.2, abs=0.05)
