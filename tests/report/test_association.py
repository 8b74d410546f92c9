"""Rows that gated themselves: what is drawn of them, and that no table or comparison hides it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
import pytest

from slamcmp.report.cautions import cautions
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.runs.association import gated_labels, plot_association, share_kept
from slamcmp.report.html import report_html
from slamcmp.results.judgements.summary import paired_table, summary_table


def test_share_kept_is_that_of_the_masks(gated: Any) -> None:
    frames = gated.frames[gated.frames["label"] == "ekf"]
    time, share = share_kept(frames)
    assert len(share) == 40
    np.testing.assert_allclose(share, np.where(np.arange(40) < 20, 1.0, 0.75))
    # Three frames of half a second each.
    np.testing.assert_allclose(time, 0.5 + 1.5 * np.arange(40))


def test_frames_without_a_correct_observation_are_a_gap() -> None:
    columns = {"k": [0, 1], "t": [0.0, 1.0], "gate_correct": [0, 2], "gate_false_rejections": [0, 1]}
    _, share = share_kept(pd.DataFrame(columns))
    np.testing.assert_array_equal(share, [np.nan, 0.5])


def test_the_figure_shows_those_that_gate_for_themselves(gated: Any) -> None:
    assert gated_labels(gated) == ["ekf", "isam2"]
    figure = plot_association(gated)
    share, nees, error, runs = figure.axes
    # Two curves, and a dotted line for each probability.
    assert len(share.lines) == 4
    assert sorted(line.get_ydata()[0] for line in share.lines[2:]) == [0.99, 0.999]
    own = gated.frames[gated.frames["label"] == "ekf"]
    for axes, column in ((nees, "online_nees"), (error, "online_position_error_m")):
        np.testing.assert_allclose(axes.lines[0].get_ydata(), own.groupby("t")[column].median())
    trials = gated.trials[gated.trials["label"] == "ekf"]
    np.testing.assert_array_equal(runs.lines[0].get_xdata(), trials["online_pose_nees"])
    # 60 of 120 frames lost one of four.
    np.testing.assert_allclose(runs.lines[0].get_ydata(), 1 - 60 / 480)


def test_it_says_why_there_is_nothing_to_draw(gated: Any, one_trial: Any) -> None:
    with pytest.raises(NotDrawable, match="no back end gates for itself"):
        plot_association(one_trial)
    unknown = gated.trials.assign(gate_recall=np.nan)
    with pytest.raises(NotDrawable, match="no truth that marks outliers"):
        plot_association(dataclasses.replace(gated, trials=unknown))


def test_tables_and_comparisons_say_who_chose_observations(gated: Any, one_trial: Any) -> None:
    summary = summary_table(gated).set_index("back end")
    assert summary["own gate"].to_dict() == {"ekf": "0.999", "isam2": "0.99", "batch": "none"}
    assert summary.loc["ekf", "own gate: recall"] == pytest.approx(0.875)
    assert summary.loc["isam2", "own gate: precision"] == 1.0
    paired = paired_table(gated)
    online = paired[paired["trajectory"] == "online"].set_index("back end")
    assert online["own gates"].to_dict() == {"isam2": "0.99 against 0.999", "batch": "none against 0.999"}
    same = gated.trials.assign(own_gate=0.9)
    assert set(paired_table(dataclasses.replace(gated, trials=same))["own gates"]) == {"both 0.9"}
    assert "own gate" not in summary_table(one_trial)
    assert "own gates" not in paired_table(one_trial)


def test_the_report_says_it_first(gated: Any, one_trial: Any) -> None:
    found = {caution.title: caution.text for caution in cautions(gated)}
    text = found["Back ends chose their own observations"]
    assert text.startswith("ekf, isam2: each dropped")
    assert text.endswith("Used every observation: batch.")
    page = report_html(gated)
    # In every row of the trials table.
    assert page.count('<span class="note">own gate 0.999</span>') == 6
    assert page.count('<span class="note">own gate 0.99</span>') == 6
    assert "chose their own" not in " ".join(caution.title for caution in cautions(one_trial))
    assert '<span class="note">own gate' not in report_html(one_trial)
