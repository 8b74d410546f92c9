"""The summary and the page: the numbers of the tables, nothing from outside, no markup from names."""

from __future__ import annotations

import base64
import dataclasses
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy.stats import binomtest

from slamcmp.report import summary_table, write_report
from slamcmp.report.cautions import cautions, distance_in_sigmas
from slamcmp.report.html import number_text, report_html
from slamcmp.report.summary import paired_table


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


def test_cautions_name_failed_runs_and_a_healthy_nis_on_a_wrong_trajectory(swept, recorded):
    found = {caution.title: caution.text for caution in cautions(swept)}
    assert "ekf at source.range_sigma_m = 2: 1 diverged" in found["2 of 54 runs are not ok"]
    assert not [title for title in found if "Too few" in title]
    found = {caution.title: caution.text for caution in cautions(recorded)}
    text = found["A healthy NIS hides a wrong trajectory"]
    assert "ekf: NIS/dof 1.0" in text
    assert "isam2" not in text
    assert "the reference batch (final)" in text
    assert "Too few runs for statistics: one run per back end and grid point" in found


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
    assert distance_in_sigmas(frames) == pytest.approx(math.sqrt(4 / 3))
    without_truth = frames.assign(true_x=math.nan, true_y=math.nan, final_x=0.0, final_y=1.0)
    # Offset (0, 1): 4 / 3.
    assert distance_in_sigmas(without_truth) == pytest.approx(math.sqrt(4 / 3))
    assert math.isnan(distance_in_sigmas(without_truth.drop(columns=["final_x", "final_y"])))


def test_page_holds_the_tables_numbers(swept, tmp_path):
    path = write_report(swept, tmp_path / "deep" / "report.html")
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    summary, paired, trials = page.tables
    assert summary[0] == ["what ran", "online (causal)", "final (hindsight)", "whole run"]
    expected = summary_table(swept)
    assert len(summary) == 2 + len(expected)
    online, final = summary[1].index("ATE [m]"), summary[1].index("ATE [m]", summary[1].index("ATE [m]") + 1)
    for shown, (_, row) in zip(summary[2:], expected.iterrows(), strict=True):
        assert shown[0] == row["back end"]
        assert shown[online] == number_text(row["online ATE [m]"])
        final_text = "–" if math.isnan(row["final ATE [m]"]) else number_text(row["final ATE [m]"])
        assert shown[final] == final_text
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
        "front_end_totals": {"raw": 120, "kept": 100},
    }
    text = report_html(dataclasses.replace(one_trial, manifest=manifest))
    assert "abc1234 with uncommitted changes" in text
    assert "raw 120, kept 100" in text
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
