"""Published numbers beside measured ones: aggregates by hand, verdicts, and mistakes with their places."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import gmean
from typer.testing import CliRunner

from slamcmp.cli import app
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.config.schema import experiment_schema
from slamcmp.results.judgements.ensemble import ENSEMBLE_METRICS, ensemble_value, run_values
from slamcmp.results.judgements.published import Published
from slamcmp.results.judgements.verdict import judge_published
from slamcmp.results.store import load_results
from slamcmp.support.configuration.config_errors import ConfigError


def frames_of(position: list[list[float]], label: str = "A", first: int = 10, **more: Any) -> pd.DataFrame:
    """A frames table with these position errors (runs, frames); frame numbers start at ``first``."""
    rows = [
        {"trial": trial, "label": label, "k": first + k, "online_position_error_m": error}
        for trial, errors in enumerate(position)
        for k, error in enumerate(errors)
    ]
    return pd.DataFrame(rows).assign(**more)


def test_position_rmse_by_hand() -> None:
    """Errors 3, 1 and 4, 7: RMSE over runs is sqrt 12.5 and 5; over frames sqrt((12.5 + 25) / 2)."""
    frames = frames_of([[3.0, 1.0], [4.0, 7.0]])
    assert ensemble_value("ensemble_position_rmse", frames) == pytest.approx(math.sqrt(18.75), rel=1e-15)
    mean = (math.sqrt(12.5) + 5.0) / 2
    assert ensemble_value("ensemble_mean_position_rmse", frames) == pytest.approx(mean, rel=1e-15)
    one_run = [math.sqrt((9 + 1) / 2), math.sqrt((16 + 49) / 2)]
    assert run_values("ensemble_position_rmse", frames).tolist() == pytest.approx(one_run, rel=1e-15)
    # The table's order does not matter.
    assert ensemble_value("ensemble_position_rmse", frames[::-1]) == pytest.approx(math.sqrt(18.75))


def test_nees_by_hand_and_nothing_before_frame_ten() -> None:
    """Frames 9 and 10: the first counts as 0, even where its NEES is infinite."""
    frames = pd.DataFrame(
        {
            "trial": [0, 0],
            "label": "A",
            "k": [9, 10],
            "online_heading_error_deg": [1.0, 7.0],
            "online_err_2": [0.3, 0.6],
            "online_sigma_2": [0.0, 0.2],
            "true_x": [1.0, 2.0],
            "true_y": 0.0,
            "online_x": 0.0,
            "online_y": [0.0, 1.0],
            "online_P_xx": [0.0, 4.0],
            "online_P_xy": [0.0, 1.0],
            "online_P_yy": [0.0, 2.0],
            "online_nees": [math.nan, 12.0],
        }
    )
    assert ensemble_value("ensemble_nees_heading", frames) == pytest.approx(9.0 / 2)
    # Error (2, -1), P = [[4, 1], [1, 2]]: (2·4 + 2·1·2 + 4·1) / 7 = 16/7, by two axes, over two frames.
    assert ensemble_value("ensemble_nees_position", frames) == pytest.approx(16 / 7 / 2 / 2)
    assert ensemble_value("ensemble_nees_pose", frames) == pytest.approx(12.0 / 3 / 2)
    assert ensemble_value("ensemble_heading_rmse_deg", frames) == pytest.approx(5.0)


def test_a_run_alone_and_a_pose_in_space() -> None:
    """Of each run NEES is a mean and an error a root mean square; in space NEES is divided by six."""
    frames = frames_of([[3.0, 4.0], [6.0, 8.0]], online_nees=[6.0, 12.0, 18.0, 60.0])
    assert run_values("ensemble_nees_pose", frames).tolist() == pytest.approx([3.0, 13.0])
    assert run_values("ensemble_mean_position_rmse", frames).tolist() == pytest.approx(
        [math.sqrt(12.5), math.sqrt(50.0)]
    )
    space = frames.assign(online_err_5=0.0)
    assert run_values("ensemble_nees_pose", space).tolist() == pytest.approx([1.5, 6.5])
    assert ensemble_value("ensemble_nees_pose", space) == pytest.approx(4.0)
    # Of a rotation in space the table has no covariance.
    assert math.isnan(ensemble_value("ensemble_nees_heading", space))


def test_ensemble_without_runs_or_columns_is_missing() -> None:
    frames = frames_of([[1.0]])
    for name in ENSEMBLE_METRICS:
        assert math.isnan(ensemble_value(name, frames.iloc[:0]))
    assert math.isnan(ensemble_value("ensemble_nees_heading", frames))


def tables(errors: dict[str, list[float]], **swept: Any) -> tuple[pd.DataFrame, pd.DataFrame]:
    """One frame a run; the seeds of all labels are the same."""
    trials = pd.DataFrame(
        [
            {"trial": seed, "label": label, "seed": seed, "status": "ok", "online_ate": error, **swept}
            for label, values in errors.items()
            for seed, error in enumerate(values)
        ]
    ).astype({"seed": "Int64"})
    frames = [frames_of([[error] for error in values], label) for label, values in errors.items()]
    return trials, pd.concat(frames)


def published(**fields: Any) -> Published:
    return Published.model_validate({"source": "a paper", **fields})


RUNS = np.tile([1.0, 2.0, 1.5, 1.2, 0.8, 1.1, 1.3, 0.9], 3)
NEARLY = np.tile([1.05, 1 / 1.05], 12)


def test_values_are_inside_up_to_the_tolerance() -> None:
    trials, frames = tables({"A": [3.0, 4.0, 100.0]})
    trials.loc[2, "status"] = "diverged"
    rows = [{"label": "A", "values": {"ensemble_position_rmse": value}} for value in (3.2, 3.0)]
    rows.append({"label": "A", "values": {"online_ate": 3.5, "ensemble_nees_pose": 1.0}})
    verdict = judge_published(
        published(rows=rows, tolerance={"ensemble_position_rmse": 0.15, "ensemble_nees_pose": 0.1}),
        trials,
        frames,
    )
    # sqrt 12.5 = 3.536 is 10.5 % above 3.2 and 17.9 % above 3.
    near, far, untold, missing = verdict.values
    assert (near.verdict, far.verdict, untold.verdict) == ("inside", "outside", "not judged")
    assert near.measured == pytest.approx(math.sqrt(12.5))
    assert far.deviation == pytest.approx(math.sqrt(12.5) / 3 - 1)
    assert near.runs == 2
    assert untold.measured == 3.5
    assert missing.verdict == "not measured"
    assert verdict.sentence() == "1 of 3 judged values inside tolerance"


@pytest.mark.parametrize(
    ("measured", "verdict"), [(1.14, "inside"), (1.16, "outside"), (0.86, "inside"), (0.84, "outside")]
)
def test_a_tolerance_is_a_share_of_the_published_value(measured: float, verdict: str) -> None:
    """Of the mean over the runs, not of their median, which is 0 here."""
    trials, frames = tables({"A": [0.0, 0.0, 3 * measured]})
    rows = [{"label": "A", "values": {"online_ate": 1.0}}]
    judged = judge_published(published(rows=rows, tolerance={"online_ate": 0.15}), trials, frames)
    (value,) = judged.values
    assert (value.measured, value.verdict) == (pytest.approx(measured), verdict)


@pytest.mark.parametrize(
    ("worse", "verdict", "text"),
    [
        (RUNS + 0.1, "held", "best < worst"),
        (RUNS[:20] + 0.1, "held", "best < worst"),
        (RUNS - 0.1, "violated", "best > worst"),
        (RUNS + 0.1 * np.tile([1, -1], 12), "tie", "best = worst"),
        (RUNS[:19] + 0.1, "too few runs", "best ? worst"),
    ],
)
def test_an_order_of_two(worse: np.ndarray, verdict: str, text: str) -> None:
    trials, frames = tables({"best": list(RUNS), "worst": list(worse)})
    order = [{"metric": "ensemble_position_rmse", "labels": ["best", "worst"]}]
    judged = judge_published(published(order=order), trials, frames)
    found = judged.orders[0]
    assert found.verdict == found.pairs[0].verdict == verdict
    assert judged.sentence() == f"ensemble_position_rmse: {text}: {verdict}"
    ratio = found.pairs[0].ratio
    assert ratio.runs == len(worse)
    assert ratio.estimate == pytest.approx(gmean(worse / RUNS[: len(worse)]))


def test_an_order_is_judged_on_seeds_that_both_finished() -> None:
    """Paired by seed, not by place: the worse one's runs stand in another order, and two did not finish."""
    trials, frames = tables({"best": list(RUNS), "worst": list(1.2 * RUNS)})
    trials = pd.concat([trials.iloc[:24], trials.iloc[:23:-1]], ignore_index=True)
    lost = trials["seed"].isin([3, 7]) & (trials["label"] == "worst")
    trials.loc[lost, ["status", "online_ate"]] = ["diverged", 1e6]
    for metric in ("ensemble_position_rmse", "online_ate"):
        order = [{"metric": metric, "labels": ["best", "worst"]}]
        ratio = judge_published(published(order=order), trials, frames).orders[0].pairs[0].ratio
        assert ratio.runs == 22
        assert [ratio.estimate, ratio.low, ratio.high] == pytest.approx([1.2] * 3)


@pytest.mark.parametrize(
    ("middle", "last", "verdict", "text"),
    [
        (1.1 * RUNS, 1.2 * RUNS, "held", "best < middle < last"),
        (RUNS * NEARLY, 1.5 * RUNS, "tie", "best = middle < last"),
        (0.999 * RUNS * NEARLY, 1.5 * RUNS, "tie", "best = middle < last"),
        (1.2 * RUNS, 1.2 * RUNS * NEARLY, "tie", "best < middle = last"),
        (0.9 * RUNS, 1.2 * RUNS, "violated", "best > middle < last"),
        (1.2 * RUNS, 1.1 * RUNS, "violated", "best < middle > last"),
        (1.2 * RUNS[:19], 1.5 * RUNS, "too few runs", "best ? middle ? last"),
    ],
)
def test_an_order_of_three_is_held_only_where_each_pair_is(
    middle: np.ndarray, last: np.ndarray, verdict: str, text: str
) -> None:
    trials, frames = tables({"best": list(RUNS), "middle": list(middle), "last": list(last)})
    order = [{"metric": "online_ate", "labels": ["best", "middle", "last"]}]
    found = judge_published(published(order=order), trials, frames).orders[0]
    assert (found.verdict, found.text) == (verdict, text)


@pytest.mark.parametrize(
    ("middle", "last", "verdict"),
    [
        (1.1 * RUNS, 2 * RUNS, "held"),
        (RUNS * NEARLY, 2 * RUNS, "tie"),  # the last is far worse, but two are not told apart
        (1.1 * RUNS, 1.3 * RUNS, "violated"),  # significantly worse, but not by the factor
        (RUNS - 0.05, 2 * RUNS, "violated"),  # a reversed pair before it
    ],
)
def test_an_order_with_a_factor(middle: np.ndarray, last: np.ndarray, verdict: str) -> None:
    trials, frames = tables({"best": list(RUNS), "middle": list(middle), "last": list(last)})
    order = [{"metric": "ensemble_position_rmse", "labels": ["best", "middle", "last"], "worst_factor": 1.5}]
    found = judge_published(published(order=order), trials, frames).orders[0]
    assert found.verdict == verdict
    ratio = np.sqrt(np.mean(np.square(last)) / np.mean(np.square(middle)))
    assert found.factor == pytest.approx(ratio)


def test_a_swept_value_names_its_runs() -> None:
    trials, frames = tables({"A": [1.0, 2.0]})
    trials["source.noise_scale"] = [1.0, 4.0]
    rows = [{"label": "A", "at": {"source.noise_scale": 4.0}, "values": {"ensemble_position_rmse": 2.0}}]
    (found,) = judge_published(published(rows=rows), trials, frames).values
    assert found.measured == 2.0
    assert found.runs == 1


GOOD = """
source: {name: circle, steps: 20}
back_ends:
  - {name: ekf_slam, label: EKF}
seeds: 2
sweep: {source.noise_scale: [1.0, 2.0]}
published:
  source: A paper
  tolerance: {ensemble_position_rmse: 0.1}
  rows:
    - label: EKF
      at: {source.noise_scale: 2.0}
      values: {ensemble_position_rmse: 0.5}
  order:
    - metric: online_ate
      labels: [EKF, EKF]
"""


def test_the_section_is_read_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "good.yaml"
    path.write_text(GOOD)
    experiment = load_experiment(path)
    assert experiment.published is not None
    assert experiment.published.rows[0].values == {"ensemble_position_rmse": 0.5}
    assert Published.model_validate(experiment.as_dict()["published"]) == experiment.published


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("label: EKF\n", "label: EFK\n", "11:14: published: no back end has the label 'EFK'; did you mean"),
        ("rmse: 0.5", "rms: 0.5", "13:16: published: there is no metric 'ensemble_position_rms'; did"),
        ("rmse: 0.1", "rmse: -0.1", "9:39: ensemble_position_rmse: input should be greater than 0"),
        ("scale: 2.0", "scale: 3.0", "12:32: published: the sweep has no source.noise_scale = 3.0"),
        ("      at: {source.noise_scale: 2.0}\n", "", "11:7: published: source.noise_scale is swept; 'at:'"),
        ("  tolerance:", "  tolerence:", "9:3: unknown key 'tolerence'; did you mean 'tolerance'"),
        ("labels: [EKF, EKF]", "labels: [EKF]", "16:15: labels: list should have at least 2 items"),
        ("  source: A paper\n", "", "key 'source' is missing"),
    ],
)  # fmt: skip
def test_mistakes_are_told_with_their_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert GOOD.count(old) == 1
    path = tmp_path / "bad.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError) as error:
        load_experiment(path)
    assert message in str(error.value)
    assert len(error.value.lines) == 1


def test_the_schema_has_the_section() -> None:
    schema = json.loads(json.dumps(experiment_schema()))
    assert {"$ref": "#/$defs/Published"} in schema["properties"]["published"]["anyOf"]
    assert schema["$defs"]["Published"]["additionalProperties"] is False
    assert schema["$defs"]["PublishedOrder"]["properties"]["labels"]["minItems"] == 2


def test_run_and_report_show_both_and_the_exit_code_is_of_the_runs(tmp_path: Path) -> None:
    """A published error of 1 km is not reproduced; the runs are fine all the same."""
    path = tmp_path / "far.yaml"
    path.write_text(GOOD.replace("rmse: 0.5", "rmse: 1000.0"))
    folder = tmp_path / "far"
    options = ["--executor", "serial", "--results", str(folder)]
    shown = CliRunner().invoke(app, ["run", str(path), *options])
    assert shown.exit_code == 0, shown.output
    assert "verdict: 0 of 1 judged values inside tolerance" in shown.output
    told = CliRunner().invoke(app, ["run", str(path), *options, "--json", "--no-report"])
    (value,) = json.loads(told.stdout)["published"]["values"]
    assert (value["verdict"], value["published"], value["runs"]) == ("outside", 1000.0, 2)
    frames = load_results(folder).frames
    noisy = frames[frames["source.noise_scale"] == 2.0]
    assert value["measured"] == pytest.approx(ensemble_value("ensemble_position_rmse", noisy))
    page = (folder / "report.html").read_text()
    assert "Published and measured" in page
    assert "outside" in page
