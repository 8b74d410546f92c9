"""The page of a grade: complete in one file, escaped, and silent about what is hidden."""

from __future__ import annotations

import base64
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from slamcmp.grading.results.images import data_uri
from slamcmp.grading.results.outcome import Plot, Series
from slamcmp.grading.results.page import grade_page
from slamcmp.report.figures.grades import Curve, outside_text, plot_curves
from tests.grading.outcomes import HOSTILE, SECRETS, STAFF, example, plot


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data


def _read(page: str) -> _Reader:
    reader = _Reader()
    reader.feed(page)
    return reader


def test_a_students_page_holds_nothing_hidden_and_no_total() -> None:
    page = grade_page(example(), audience="student")
    drawn = "".join(
        base64.b64decode(source.partition(",")[2]).decode() for source in re.findall(r"data:[^\"]+", page)
    )
    assert [secret for secret in (*SECRETS, "NEES 9.3") if secret in page + drawn] == []
    assert "29.3" not in page
    assert "22.35 of 60 points" in page


def test_a_students_page_shows_the_total_when_every_test_is_visible() -> None:
    outcome = replace(example(), tests=example().tests[:3])
    assert "<strong>22.35</strong> of 60 points" in grade_page(outcome, audience="student")


def test_the_staffs_page_holds_everything() -> None:
    text = _read(grade_page(example(), audience="staff")).text
    for expected in ("29.35", "HIDDEN-MESSAGE", f"{STAFF} seed 4711", "cannot open a network socket"):
        assert expected in text


def test_the_page_needs_no_other_file_and_runs_nothing() -> None:
    hostile = replace(
        example(), student=HOSTILE, notes=(HOSTILE,), tests=(replace(example().tests[1], name=HOSTILE),)
    )
    page = _read(grade_page(hostile, audience="staff"))
    assert "script" not in page.tags
    assert page.text.count('<script>alert("x")</script>') == 5, "as text: title, student, note, row, article"
    assert all(source.startswith(("data:image/svg+xml;base64,", "#test-")) for source in page.sources)


def test_the_text_says_where_the_curve_left_the_band() -> None:
    curves = [
        Curve("lower", [-1, -1, -1, -1], "band"),
        Curve("upper", [1, 1, 1, 1], "band"),
        Curve("yours", [0, 0.5, -1.5, math.nan], "yours"),
    ]
    assert outside_text("t [s]", [0, 1, 2, 3], curves) == (
        "Your curve first leaves the band at t [s] = 2 (value -1.5, band -1 to 1) "
        "and is outside at 1 of 3 points."
    )
    inside = [*curves[:2], Curve("yours", [0, 0.5, -0.5, 1], "yours")]
    assert outside_text("t [s]", [0, 1, 2, 3], inside) == "Your curve stays inside the band at all 4 points."
    assert outside_text("t [s]", [0, 1, 2, 3], curves[2:]) == ""
    above = [curves[1], Curve("yours", [-9, 0.5, 1.5, 1], "yours")]
    assert outside_text("t [s]", [0, 1, 2, 3], above) == (
        "Your curve first leaves the band at t [s] = 2 (value 1.5, band up to 1) "
        "and is outside at 1 of 4 points."
    )


def test_the_figure_marks_exactly_the_points_outside() -> None:
    drawn = plot("d")
    curves = [Curve(series.name, series.y, series.role) for series in drawn.series]
    figure = plot_curves("d", "t", "e", drawn.x, curves)
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "x"]
    yours, band = np.array(drawn.series[3].y), np.array(drawn.series[1].y)
    assert np.array_equal(crosses[0].get_xdata(), np.array(drawn.x)[np.abs(yours) > band])


def test_a_path_has_its_own_abscissae_and_equal_scales() -> None:
    truth = Curve("truth", (0.0, 3.0), "truth", x=(0.0, 8.0))
    lost = Curve("yours", (0.0, 1e6, 2.0), "yours", x=(0.0, -1e6, 7.0))
    figure = plot_curves("path", "x [m]", "y [m]", (), [truth, lost], equal_scales=True)
    axes = figure.axes[0]
    drawn = {tuple(line.get_xdata()): tuple(line.get_ydata()) for line in axes.lines}
    assert drawn == {(0.0, 8.0): (0.0, 3.0), (0.0, -1e6, 7.0): (0.0, 1e6, 2.0)}
    figure.draw_without_rendering()
    box = axes.get_window_extent()
    across, up = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
    assert across / up == pytest.approx(box.width / box.height, rel=1e-6)
    assert (across, up) == pytest.approx((12.0, 4.5)), "what ran away leaves the truth its room"
    assert outside_text("x [m]", (), [truth, lost]) == ""


def test_curves_from_a_hostile_submission_are_drawn_as_far_as_they_can_be() -> None:
    x = (0.0, 1.0, 2.0)
    curves = (
        Series("yours", (math.nan, math.inf, 1e308, 4.0), "yours"),
        Series("$\\frac{", (1.0,), "reference"),
        Series("", (), "truth"),
    )
    hostile = Plot(title="$\\nonsense", x_label="$", y_label="%$", x=x, series=curves, caption="")
    assert data_uri(hostile, "svg").startswith("data:image/svg+xml;base64,")
