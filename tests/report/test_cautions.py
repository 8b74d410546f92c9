"""What the page says before it shows a number: each caution where it belongs, and nowhere else."""

from __future__ import annotations

import dataclasses
import math

import pandas as pd
import pytest

from slamcmp.cli.run import _print_results
from slamcmp.report.cautions import cautions, distances_in_sigmas


def test_cautions_name_failed_runs_and_a_healthy_nis_on_a_wrong_trajectory(swept, recorded):
    found = {caution.title: caution.text for caution in cautions(swept)}
    assert "ekf at range sigma = 2 m: 1 diverged" in found["2 of 54 runs are not ok"]
    assert not [title for title in found if "Too few" in title]
    found = {caution.title: caution.text for caution in cautions(recorded)}
    text = found["A healthy NIS hides a wrong trajectory"]
    assert "ekf: NIS/dof 1.0" in text
    assert "isam2" not in text
    assert "the reference batch (final)" in text
    assert "Too few runs for statistics: one run per back end and grid point" in found


def with_nis(results, nis, error_scale=1.0, nees=3.0):
    """All runs of the EKF with this NIS/dof, its positions and landmarks moved away by ``error_scale`` σ."""
    trials = results.trials.assign(nis_per_dof=nis)
    frames = results.frames.assign(online_x=results.frames["true_x"] + 0.2 * error_scale)
    frames = frames.assign(online_y=frames["true_y"], online_P_xx=0.04, online_P_xy=0.0, online_P_yy=0.04)
    return dataclasses.replace(results, trials=trials, frames=frames.assign(online_nees=nees))


def healthy_caution(results):
    found = {caution.title: caution.text for caution in cautions(results)}
    return found.get("A healthy NIS hides a wrong trajectory", "")


def test_caution_needs_a_healthy_nis_and_a_distance(swept):
    finished = dataclasses.replace(
        swept, landmarks=swept.landmarks.iloc[:0], trials=swept.trials[swept.trials["label"] != "batch"]
    )
    assert healthy_caution(with_nis(finished, 1.0, 2.9)) == ""
    text = healthy_caution(with_nis(finished, 1.0, 3.5))
    assert "isam2 at range sigma = 0.5 m: NIS/dof 1.00, yet the online position is typically 3.5" in text
    assert "(6 of 6 runs)" in text
    assert healthy_caution(with_nis(finished, 1.3, 3.5)) == ""
    assert healthy_caution(with_nis(finished, 0.7, 3.5)) == ""


def test_one_far_run_of_six_is_chance(swept):
    results = with_nis(dataclasses.replace(swept, landmarks=swept.landmarks.iloc[:0]), 1.0)
    frames = results.frames.copy()
    trials = sorted(results.trials[results.trials["source.range_sigma_m"] == 1.0]["trial"].unique())
    for count, told in ((1, False), (2, True)):
        far = frames["trial"].isin(trials[:count]) & (frames["label"] == "isam2")
        moved = frames.assign(online_x=frames["online_x"].where(~far, frames["true_x"] + 2.0))
        assert ("isam2" in healthy_caution(dataclasses.replace(results, frames=moved))) is told


def test_caution_for_a_map_that_is_off_while_the_pose_is_not(swept):
    results = with_nis(swept, 1.0)
    landmarks = results.landmarks.assign(P_xx=0.01, P_xy=0.0, P_yy=0.01)
    landmarks = landmarks.assign(x=landmarks["true_x"] + 0.4, y=landmarks["true_y"])
    text = healthy_caution(dataclasses.replace(results, landmarks=landmarks))
    assert "the last map's landmarks are typically 4.0 of the claimed standard deviations away" in text
    assert "online position" not in text


def test_caution_for_overconfidence_that_only_all_runs_show(swept):
    near = with_nis(dataclasses.replace(swept, landmarks=swept.landmarks.iloc[:0]), 1.0, nees=6.9)
    # Six runs: 18 degrees of freedom, 0.1 % above 42.3, that is 7.05 a run.
    assert healthy_caution(near) == ""
    text = healthy_caution(near := with_nis(near, 1.0, nees=7.2))
    assert "the last pose's NEES averages 7.2 over 6 runs where a consistent back end stays below 7.1" in text
    # Four finished runs are too few to say.
    assert "ekf at range sigma = 2 m" not in text


def test_cautions_tell_whose_online_column_it_is_and_how_times_were_measured(one_trial):
    def titles(**manifest):
        changed = dataclasses.replace(one_trial, manifest={**one_trial.manifest, **manifest})
        return [caution.title for caution in cautions(changed)]

    once = {"back_ends": [{"name": "batch", "label": "MAP", "every": 0}, {"name": "ekf_slam"}]}
    always = {"back_ends": [{"name": "batch", "label": "MAP", "every": 1}]}
    assert "MAP: the online column is the warm start's" in titles(config=once)
    assert not [title for title in titles(config=always) if "warm start" in title]
    assert "Times were measured with 2 jobs side by side" in titles(jobs=2)
    assert not [title for title in titles(jobs=1) if title.startswith("Times")]


def test_a_lag_that_poses_have_left_says_whose_prior_it_keeps(one_trial, capsys):
    """With its default of 20, given, and swept; not where the whole run fits into it."""
    frames = int(one_trial.trials["frames"].max())
    said = "LAG: the prior of what left the lag stands in body axes"
    for parameters, sweep, expected in (
        ({"lag_frames": frames - 2}, {}, True),
        ({"lag_frames": frames - 1}, {}, False),
        ({"lag_frames": frames}, {"back_ends.LAG.lag_frames": [frames, 2]}, True),
        ({}, {}, frames > 21),
    ):
        config = {"back_ends": [{"name": "fixed_lag", "label": "LAG", **parameters}], "sweep": sweep}
        changed = dataclasses.replace(one_trial, manifest={**one_trial.manifest, "config": config})
        assert (said in [caution.title for caution in cautions(changed)]) == expected
        _print_results(changed, pd.DataFrame(), pd.DataFrame())
        assert ("covariances of LAG: too small" in capsys.readouterr().out) == expected


def test_cautions_name_unequal_streams(one_trial):
    trials = one_trial.trials.copy()
    trials.loc[0, "digest"] = "f" * 64
    found = {
        caution.title: caution.text for caution in cautions(dataclasses.replace(one_trial, trials=trials))
    }
    assert "trial 0" in found["Back ends of one trial did not get the same measurements"]


def test_distance_in_sigmas_is_the_mahalanobis_distance(one_trial):
    frames = one_trial.frames.iloc[:1].copy()
    # P = [[4, 1], [1, 1]], offset (2, 0): e^T P^-1 e = 4 · 1 / 3.
    frames[["online_x", "online_y", "true_x", "true_y"]] = [[0.0, 0.0, 2.0, 0.0]]
    frames[["online_P_xx", "online_P_xy", "online_P_yy"]] = [[4.0, 1.0, 1.0]]
    assert distances_in_sigmas(frames).item() == pytest.approx(math.sqrt(4 / 3))
    # Offset (0, 2), of a run without truth beside the other: 4 · 4 / 3.
    without_truth = frames.assign(trial=1, true_x=math.nan, true_y=math.nan, final_x=0.0, final_y=2.0)
    both = distances_in_sigmas(pd.concat([frames, without_truth], ignore_index=True))
    label = frames["label"].item()
    assert both[0, label] == pytest.approx(math.sqrt(4 / 3))
    assert both[1, label] == pytest.approx(math.sqrt(16 / 3))
    nothing = without_truth.drop(columns=["final_x", "final_y"])
    assert math.isnan(distances_in_sigmas(nothing).item())
    # The median is over the frames whose covariance is one.
    several = pd.concat([frames] * 3 + [frames.assign(online_P_xy=9.0)], ignore_index=True)
    several["true_x"] = [1.0, 2.0, 10.0, 50.0]
    assert distances_in_sigmas(several).item() == pytest.approx(math.sqrt(4 / 3))
