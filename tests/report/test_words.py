"""Figures name parameters in words, and a sweep over two of them is small multiples."""

from __future__ import annotations

import re
from dataclasses import replace

import matplotlib
import matplotlib.text
import pytest

from slamcmp.report.figures import style
from slamcmp.report.figures.draw import each_figure
from slamcmp.report.figures.sweeps.sweep import plot_sweep
from slamcmp.report.html import report_html
from slamcmp.results.store import Results

RANGE, SCALE = "source.range_sigma_m", "source.noise_scale"


@pytest.fixture(autouse=True)
def _report_style():
    with matplotlib.rc_context(style.RC):
        yield


def over_two(results: Results) -> Results:
    """The same runs as if every second seed had had another noise."""

    def with_scale(table):
        scales = table["seed"].astype(int).mod(2).add(1).astype(float)
        return table.assign(**{SCALE: scales})

    return replace(results, trials=with_scale(results.trials), frames=with_scale(results.frames))


def texts(figure) -> list[str]:
    return [each.get_text() for each in figure.findobj(matplotlib.text.Text) if each.get_text()]


@pytest.mark.parametrize("paths", [1, 2])
def test_no_figure_names_a_raw_path(swept, paths):
    results = swept if paths == 1 else over_two(swept)
    drawn = [each for each in each_figure(results, None) if each.figure is not None]
    assert {"map", "errors", "sweep", "consistency", "budget"} <= {each.name for each in drawn}
    raw = {
        each.name: [text for text in texts(each.figure) if re.search(r"source\.|front_end|\w_\w", text)]
        for each in drawn
    }
    assert {name: found for name, found in raw.items() if found} == {}
    said = " ".join(texts(next(each.figure for each in drawn if each.name == "sweep")))
    assert "range sigma [m]" in said


def test_the_page_says_swept_parameters_in_words_up_to_its_configuration(swept):
    page = report_html(over_two(swept))
    before = page.partition("<summary>Configuration")[0].partition("const packed")[0]
    before = re.sub(r"<code>.*?</code>|data:image[^\"]*", "", before, flags=re.DOTALL)
    assert RANGE not in before
    assert SCALE not in before
    assert "noise scale" in before


def test_two_parameters_are_a_column_for_each_value_of_one(swept):
    figure = plot_sweep(over_two(swept))
    values = sorted(swept.trials[RANGE].unique())
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    # Two scales are fewer than the ranges: they are the columns.
    assert [axes.get_title(loc="left") for axes in panels] == ["noise scale = 1", "noise scale = 2"]
    assert len(values) == 3
    bottom = [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()]
    assert bottom == ["range sigma [m]"] * 2
    # Each panel has the medians of its own half of the runs.
    trials = over_two(swept).trials
    for axes, scale in zip(panels, (1.0, 2.0), strict=True):
        own = trials[(trials[SCALE] == scale) & (trials["label"] == "batch") & (trials["status"] == "ok")]
        medians = sorted(own.groupby(RANGE)["online_ate"].median())
        drawn = [sorted(line.get_ydata()) for line in axes.lines if len(line.get_ydata()) == len(medians)]
        assert any(known == pytest.approx(medians) for known in drawn)


def test_a_matrix_takes_the_place_of_the_lines_on_the_page(swept):
    two = report_html(over_two(swept))
    assert '<table class="matrix">' in two
    assert "against ekf, online" in two
    assert '<table class="matrix">' not in report_html(swept)
