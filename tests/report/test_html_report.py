"""The summary and the page: the numbers of the tables, nothing from outside, no markup from names."""

from __future__ import annotations

import base64
import dataclasses
import math
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from slamcmp.report import summary_table, write_report
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.html import _search_text, report_html
from slamcmp.report.tables import page_table
from slamcmp.results.judgements.certainty import certainty_table, last_frame_nees, worst_run
from slamcmp.results.judgements.summary import paired_table, terminal_table
from slamcmp.results.numbers import number_text


class Page(HTMLParser):
    """Tables as lists of rows of cell texts, and every attribute that may point outside."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.headers: list[dict[str, str | None]] = []
        self.open: list[str] = []
        self.scripts = 0
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.links += [values[name] for name in ("src", "href", "srcset", "action") if values.get(name)]
        if tag == "img":
            self.images.append(values)
        if tag == "script":
            self.scripts += 1
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
            if tag == "th":
                self.headers.append(values)
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data


def test_summary_has_medians_of_finished_runs_and_counts_the_rest(swept):
    table = summary_table(swept)
    assert len(table) == 9
    row = table[(table["back end"] == "ekf") & (table["source.range_sigma_m"] == 2.0)].iloc[0]
    assert (row["runs"], row["ok"], row["failed"]) == (6, 4, "1 diverged, 1 crashed")
    trials = swept.trials
    own = trials[(trials["label"] == "ekf") & (trials["source.range_sigma_m"] == 2.0)]
    assert row["online ATE [m]"] == own[own["status"] == "ok"]["online_ate"].median()
    assert math.isnan(row["final ATE [m]"])
    assert "online ATE, SE(2)-aligned [m]" in table.columns
    # Every error column names its trajectory.
    assert not [name for name in table.columns if name.startswith(("ATE", "heading", "pose"))]


def test_paired_ratios_and_the_sign_test(swept):
    table = paired_table(swept)
    row = table[(table["back end"] == "isam2") & (table["source.range_sigma_m"] == 1.0)].iloc[0]
    here = swept.trials[swept.trials["source.range_sigma_m"] == 1.0].set_index(["seed", "label"])[
        "online_ate"
    ]
    ratios = [here[seed, "isam2"] / here[seed, "ekf"] for seed in range(6)]
    assert row["median ATE ratio"] == pytest.approx(np.median(ratios))
    better = sum(ratio < 1 for ratio in ratios)
    assert (row["pairs"], row["better in"]) == (6, better)
    assert row["sign test p"] == pytest.approx(binomtest(better, 6).pvalue)
    # Two failed runs leave four pairs: too few for a test.
    row = table[(table["back end"] == "isam2") & (table["source.range_sigma_m"] == 2.0)].iloc[0]
    assert row["pairs"] == 4
    assert math.isnan(row["sign test p"])
    # Final is compared with final: the filter has none.
    assert set(table[table["trajectory"] == "final"]["compared with"]) == {"isam2"}


def test_the_reference_is_not_compared_with_itself(recorded):
    table = paired_table(recorded)
    assert list(table["trajectory"]) == ["online"]


def test_certainty_table_by_hand(swept):
    table = certainty_table(swept)
    row = table[
        (table["back end"] == "ekf")
        & (table["source.range_sigma_m"] == 2.0)
        & (table["trajectory"] == "online")
    ].iloc[0]
    # Two of six failed: Wilson's interval is 9.7 to 70.0 %.
    assert (row["runs"], row["failed (95 %)"]) == (6, "33 % (10 to 70 %)")
    # Four finished runs give no interval of a median.
    assert row["95 % of the median"] == ""
    row = table[
        (table["back end"] == "isam2")
        & (table["source.range_sigma_m"] == 2.0)
        & (table["trajectory"] == "final")
    ].iloc[0]
    own = swept.trials[(swept.trials["label"] == "isam2") & (swept.trials["source.range_sigma_m"] == 2.0)]
    ate = own["final_ate"]
    assert row["95 % of the median"] == f"{number_text(ate.min())} to {number_text(ate.max())}"
    assert (row["worst ATE [m]"], row["its seed"]) == (ate.max(), str(own.loc[ate.idxmax(), "seed"]))
    last = swept.frames[(swept.frames["label"] == "isam2") & swept.frames["trial"].isin(own["trial"])]
    expected = last[last["k"] == last["k"].max()]["final_nees"].mean()
    assert row["ANEES, last frame"] == pytest.approx(expected)
    # 18 degrees of freedom: 8.231 and 31.526, over 6.
    assert row["95 % band"] == "1.37 to 5.25"


def test_worst_run_and_last_nees_leave_failed_runs_out(swept):
    own = swept.trials[(swept.trials["label"] == "ekf") & (swept.trials["source.range_sigma_m"] == 2.0)]
    value, seed = worst_run(own.assign(online_ate=[1.0, 5.0, 2.0, 3.0, 99.0, math.nan]), "online_ate")
    assert (value, seed) == (5.0, "1")
    assert last_frame_nees(swept, own).runs == 4
    assert math.isnan(worst_run(own.iloc[4:], "online_ate")[0])


def test_terminal_table_shows_interval_and_worst_run(swept, one_trial):
    table = terminal_table(swept)
    names = list(table.columns)
    where = names.index("online ATE [m]")
    assert names[where + 1 : where + 3] == ["  95 % of median", "  worst run (seed)"]
    row = table[(table["back end"] == "isam2") & (table["source.range_sigma_m"] == 1.0)].iloc[0]
    ate = swept.trials[
        (swept.trials["label"] == "isam2") & (swept.trials["source.range_sigma_m"] == 1.0)
    ].set_index("seed")["online_ate"]
    assert row["  95 % of median"] == f"{number_text(ate.min())}–{number_text(ate.max())}"
    assert row["  worst run (seed)"] == f"{number_text(ate.max())} ({ate.idxmax()})"
    assert row["failed (95 %)"] == "0 % (0–39 %)"
    assert "  worst run (seed)" not in terminal_table(one_trial).columns


def test_page_shows_intervals_the_search_and_the_faults(swept):
    trials = swept.trials.assign(
        departure_test="", departure_frame=math.nan, departure_landmark=math.nan, diagnosis=""
    )
    trials.loc[0, ["departure_test", "departure_frame", "diagnosis"]] = ["NIS", 17.0, "It <i>slipped</i>."]
    search = {
        "metric": "online_ate", "half_width": 0.05, "relative": True, "confidence": 0.95, "max_seeds": 20,
        "batch": 10, "statistic": "median", "reason": "every interval is narrow enough with 20 seeds",
    }  # fmt: skip
    manifest = {**swept.manifest, "until": search, "config": {"figures": ["time"]}}
    text = report_html(dataclasses.replace(swept, trials=trials, manifest=manifest))
    assert "within ±5 %, at most 20 seeds: every interval is narrow enough with 20 seeds." in text
    assert "still holds the median a little less often." in text
    told = _search_text({"until": search | {"coverage": 0.934}})
    assert told.endswith(
        "an interval that ends a search still holds the median a little less often: about 93 %."
    )
    page = Page(text)
    faults = page.tables[3]
    assert len(faults) == 1 + 3
    # Failed runs first.
    assert [row[4] for row in faults[1:]] == ["diverged", "crashed", "ok"]
    assert faults[1][-1] == "Nothing that it computed was kept."
    assert faults[3][-2:] == ["17", "It <i>slipped</i>."]
    own = swept.trials[(swept.trials["label"] == "ekf") & (swept.trials["source.range_sigma_m"] == 0.5)]
    low, high = number_text(own["online_ate"].min()), number_text(own["online_ate"].max())
    assert f'<span class="note">{low} to {high}</span>' in text


def test_columns_with_nothing_in_them_are_left_out_and_only_failures_are_bad():
    table = pd.DataFrame(
        {"source.a_m": [1.0, 2.0], "failed": ["0 of 6", "1 of 6"], "empty": ["", ""], "none": [math.nan] * 2}
    )
    found = page_table(table, ["source.a_m"])
    assert found.headers == ["a [m]", "failed"]
    assert [[each.text for each in row] for row in found.rows] == [["1", "0 of 6"], ["2", "1 of 6"]]
    assert [row[1].status for row in found.rows] == ["", "bad"]
    assert not found.folded
    assert page_table(pd.concat([table] * 10), []).folded


def test_captions_say_what_is_drawn(swept, recorded, one_trial):
    def captions(results):
        return {each.name: each.caption for each in each_figure(results, ["errors", "consistency", "map"])}

    assert "truth minus estimate" in captions(swept)["errors"]
    assert "of one typical trial, trial " in captions(swept)["map"]
    assert "typical" not in captions(one_trial)["map"]
    told = captions(recorded)
    assert "Difference of each pose from that of batch (final)" in told["errors"]
    assert "truth minus" not in told["errors"]
    assert "NEES: squared pose error" not in told["consistency"]


def test_page_holds_the_tables_numbers(swept, tmp_path):
    path = write_report(swept, tmp_path / "deep" / "report.html")
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    summary, certainty, paired, trials = page.tables
    assert summary[0] == ["what ran", "online (causal)", "final (hindsight)", "whole run"]
    expected = summary_table(swept)
    assert len(summary) == 2 + len(expected)
    online, final = summary[1].index("ATE [m]"), summary[1].index("ATE [m]", summary[1].index("ATE [m]") + 1)
    for shown, (_, row) in zip(summary[2:], expected.iterrows(), strict=True):
        assert shown[0] == row["back end"]
        assert shown[online] == number_text(row["online ATE [m]"])
        final_text = "–" if math.isnan(row["final ATE [m]"]) else number_text(row["final ATE [m]"])
        assert shown[final] == final_text
    assert len(certainty) == 1 + len(certainty_table(swept))
    assert len(paired) == 1 + len(paired_table(swept))
    assert len(trials) == 1 + len(swept.trials)
    crashed = next(row for row in trials if "crashed" in row)
    assert "<script>alert(1)</script>" in crashed
    assert "0 %" in crashed


def test_page_needs_nothing_from_outside(swept):
    text = report_html(swept)
    page = Page(text)
    assert page.links
    assert all(link.startswith(("data:image/", "#")) for link in page.links)
    assert "default-src 'none'" in text
    outside = re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|@import|url\(|//[a-z]", outside)
    anchors = {link[1:] for link in page.links if link.startswith("#")}
    assert anchors <= set(re.findall(r'id="([^"]+)"', text))
    assert len(page.images) == 6
    for image in page.images:
        assert len(image["alt"]) > 40
        kind, content = image["src"].split(";base64,")
        start = {"data:image/svg+xml": b"<?xml", "data:image/png": b"\x89PNG"}[kind]
        assert base64.b64decode(content).startswith(start)
    assert all(header.get("scope") in ("col", "row", "colgroup") for header in page.headers)


def test_hostile_names_stay_text(one_trial):
    hostile = '"><img src=x onerror=alert(1)>'
    trials = one_trial.trials.replace({"label": {"ekf": hostile}})
    frames = one_trial.frames.replace({"label": {"ekf": hostile}})
    manifest = {**one_trial.manifest, "name": hostile, "command": hostile, "config": {"x": "</pre><script>"}}
    text = report_html(dataclasses.replace(one_trial, trials=trials, frames=frames, manifest=manifest))
    page = Page(text)
    assert page.scripts == 1
    assert not [image for image in page.images if image["src"] == "x"]
    assert hostile in page.tables[0][2]


def test_page_of_a_poor_manifest_and_no_truth(nothing_known):
    text = report_html(dataclasses.replace(nothing_known, manifest={}))
    assert "no truth" in text
    assert "Not drawn:" in text
    assert "nothing was swept" in text


def test_page_names_the_reference(recorded):
    text = report_html(recorded)
    assert "differences from the reference <strong>batch (final)</strong>" in text
    assert "there is no NEES" in text
    assert "slamcmp run synthetic.yaml" in text
    assert "abc1234" in text


def test_page_draws_only_the_figures_the_experiment_names(one_trial):
    manifest = {**one_trial.manifest, "config": {"figures": ["time"]}}
    page = Page(report_html(dataclasses.replace(one_trial, manifest=manifest)))
    assert [image["alt"].split(".")[0] for image in page.images] == ["Time per frame"]


def test_page_tells_how_to_repeat_it(one_trial):
    manifest = {
        **one_trial.manifest,
        "config": {"figures": ["time"]},
        "commit": {"sha": "abc1234", "dirty": True},
        "front_end_totals": {"raw": 120, "not_finite": 0, "too_far": 120, "kept": 0},
    }
    text = report_html(dataclasses.replace(one_trial, manifest=manifest))
    assert "abc1234 with uncommitted changes" in text
    assert "raw 120, too far 120, kept 0" in text
    assert "numpy 2.3.4, slamcmp 0.1.0" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.123456, "0.123"),
        (12.3456, "12.3"),
        (1234.5, "1234"),
        (0.00456, "0.00456"),
        (2e-5, "2.00e-05"),
        (0.0, "0"),
        (4e-15, "0"),
        (-1.5, "-1.50"),
        (3.2e6, "3.20e+06"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert number_text(value) == text
