"""A page of very many runs: what it leaves out is told, and what it judges by is all of them."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

from slamcmp.report import html, live
from slamcmp.report.figures import drawable
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.html import NOT_ON_THE_PAGE, report_html
from slamcmp.results.judgements.ensemble import ensemble_value
from slamcmp.results.judgements.verdict import judge
from slamcmp.results.store import load_results, save_results


@pytest.fixture
def many(swept):
    """The six seeds of the middle noise."""
    trials = swept.trials[swept.trials["source.range_sigma_m"] == 1.0].assign(**{"source.range_sigma_m": 1.0})
    kept = trials["trial"].unique()
    frames = swept.frames[swept.frames["trial"].isin(kept)]
    landmarks = swept.landmarks[swept.landmarks["trial"].isin(kept)]
    return dataclasses.replace(swept, trials=trials, frames=frames, landmarks=landmarks)


def test_curves_take_whole_runs_and_the_typical_one_is_among_them(many, monkeypatch):
    assert drawable.drawn_part(many) is many
    typical = drawable.typical_trial(many)
    whole = many.frames["trial"].value_counts()
    monkeypatch.setattr(drawable, "MOST_ROWS", int(2.5 * whole.max()))
    part = drawable.drawn_part(many)
    shown = part.frames["trial"].value_counts()
    assert len(shown) == 2
    assert typical in shown
    assert (shown == whole[shown.index]).all()
    pd.testing.assert_frame_equal(part.trials, many.trials)
    # One run alone that is over the bound is shown nevertheless.
    monkeypatch.setattr(drawable, "MOST_ROWS", 1)
    assert set(drawable.drawn_part(many).frames["trial"]) == {typical}


def test_each_figure_over_frames_and_the_page_say_what_is_left_out(many, monkeypatch):
    monkeypatch.setattr(drawable, "MOST_ROWS", int(2.5 * many.frames["trial"].value_counts().max()))
    monkeypatch.setattr(html, "MOST_RUNS", 5)
    monkeypatch.setattr(live, "SEEDS_MOST", 4)
    for drawn in each_figure(many, ["consistency", "time", "budget"]):
        title = drawn.figure.get_suptitle()
        assert ("curves over frames: 2 of 6 trials" in title) == (drawn.name != "budget"), title
        assert "over 6 trials" in title
    page = report_html(many)
    rows = len(many.trials)
    assert f"These are the first 5 rows; {rows - 5} more are in trials.parquet" in page
    table = page.partition('id="trials"')[2].partition("</section>")[0]
    assert len(re.findall("<tr>", table)) == 1 + 5
    assert "online ATE [m] (first 4 of 6 trials)" in live.live_data(many, live.live_figures(many)).replace(
        "\\u002f", "/"
    )


def test_what_is_left_out_of_a_sweep_counts_its_other_points_too(swept, many, monkeypatch):
    monkeypatch.setattr(drawable, "MOST_ROWS", len(many.frames))
    part, of = drawable.drawn_part(swept), swept.frames["trial"].nunique()
    points = swept.trials.drop_duplicates("trial").set_index("trial")["source.range_sigma_m"]
    # Half for the middle point, which curves show; then seed by seed, for what is drawn over all points.
    shown = points[part.frames["trial"].unique()].value_counts()
    assert shown.to_dict() == {0.5: 2, 1.0: 3, 2.0: 1}
    assert drawable.part_text(part, swept) == f"curves over frames: 6 of {of} trials"


def test_published_numbers_are_judged_by_every_run(many, monkeypatch):
    monkeypatch.setattr(drawable, "MOST_ROWS", 1)
    metric, label = "ensemble_position_rmse", many.trials["label"].iloc[0]
    section = {"source": "x", "rows": [{"label": label, "values": {metric: 1.0}}], "tolerance": {metric: 0.1}}
    manifest = {**many.manifest, "config": {**many.manifest.get("config", {}), "published": section}}
    shuffled = many.frames.sample(frac=1.0, random_state=0)
    (value,) = judge(dataclasses.replace(many, manifest=manifest, frames=shuffled)).values
    assert value.measured == pytest.approx(ensemble_value(metric, many.frames[many.frames["label"] == label]))
    ok = many.frames[many.frames["label"] == label]["online_position_error_m"]
    assert value.measured == pytest.approx(np.sqrt((ok**2).mean()))


def test_columns_that_the_page_does_not_read_stay_in_the_file(many, tmp_path):
    stored = dataclasses.replace(many, folder=tmp_path)
    save_results(stored)
    whole, lean = load_results(tmp_path), load_results(tmp_path, without=NOT_ON_THE_PAGE)
    assert set(whole.frames.columns) - set(lean.frames.columns) == set(NOT_ON_THE_PAGE) & set(whole.frames)
    pd.testing.assert_frame_equal(lean.frames, whole.frames[lean.frames.columns])
    pd.testing.assert_frame_equal(lean.trials, whole.trials)
    page = report_html(lean)
    assert str(many.trials["digest"].iloc[0])[:12] in page
    # What a figure that wanted one of them would say.
    assert "drawing it failed" not in page
